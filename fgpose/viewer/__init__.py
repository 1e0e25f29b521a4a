"""The Rerun viewer: a recording and its results in one window, live, in a .rrd file, or both.

Rerun is an optional dependency; it is imported only when a recording is opened.
"""

from fgpose.viewer.opening import has_rerun as has_rerun
from fgpose.viewer.opening import open_calibration_recording as open_calibration_recording
from fgpose.viewer.opening import open_people_recording as open_people_recording
from fgpose.viewer.opening import open_recording as open_recording
from fgpose.viewer.opening import open_system_recording as open_system_recording
from fgpose.viewer.recording import CalibrationRecording as CalibrationRecording
from fgpose.viewer.recording import CalibrationScene as CalibrationScene
from fgpose.viewer.recording import Recording as Recording
