"""Camera calibrations: read from the formats of this field, written as our own npz or as Pose2Sim TOML."""

from fgpose.io.calibration.rig_files import load_rig as load_rig
from fgpose.io.calibration.rig_files import save_rig as save_rig
