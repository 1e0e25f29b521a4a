"""From joints to what a study is about: segments, joint angles, speeds and heights.

joint_angles gives JointAngles of a trajectory; angle_names says which there are of a skeleton.
"""

from fgpose.kinematics.angles import JointAngles, angle_names, joint_angles

__all__ = [
    "JointAngles",
    "angle_names",
    "joint_angles",
]
