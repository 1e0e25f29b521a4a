"""From joints to what a study is about: segments, joint angles, speeds and heights."""

from fgpose.kinematics.angles import JointAngles as JointAngles
from fgpose.kinematics.angles import angle_names as angle_names
from fgpose.kinematics.angles import joint_angles as joint_angles
