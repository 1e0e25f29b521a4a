"""From joints to what a study is about: segments, joint angles, speeds and heights.

joint_angles gives JointAngles of a trajectory, and these their AngleRanges; angle_names says which there are of a
skeleton. joint_speeds gives JointSpeeds.
"""

from fgpose.kinematics.angles import JointAngles, angle_names, joint_angles
from fgpose.kinematics.ranges import AngleRanges
from fgpose.kinematics.speeds import JointSpeeds, joint_speeds

__all__ = [
    "AngleRanges",
    "JointAngles",
    "JointSpeeds",
    "angle_names",
    "joint_angles",
    "joint_speeds",
]
