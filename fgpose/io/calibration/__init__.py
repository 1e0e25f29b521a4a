"""Camera calibrations: read from the formats of this field, and written in them; intrinsics alone."""

from fgpose.io.calibration.calibrated_view import Unit as Unit
from fgpose.io.calibration.calibration_origin import CalibrationOrigin as CalibrationOrigin
from fgpose.io.calibration.intrinsics import load_intrinsics as load_intrinsics
from fgpose.io.calibration.rig_files import RigFormat as RigFormat
from fgpose.io.calibration.rig_files import check_format as check_format
from fgpose.io.calibration.rig_files import load_calibration_origin as load_calibration_origin
from fgpose.io.calibration.rig_files import load_quarter_turns as load_quarter_turns
from fgpose.io.calibration.rig_files import load_rig as load_rig
from fgpose.io.calibration.rig_files import save_rig as save_rig
from fgpose.io.calibration.toml_formats import write_lenses as write_lenses
