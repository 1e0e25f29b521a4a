"""From a recording on disk to results on disk and in the viewer. Prints nothing."""

from fgpose.association.recording import Progress as Progress
from fgpose.pipeline.calibration import show_calibrated as show_calibrated
from fgpose.pipeline.calibration import write_board_calibration as write_board_calibration
from fgpose.pipeline.calibration import write_board_lenses as write_board_lenses
from fgpose.pipeline.calibration import write_bumped as write_bumped
from fgpose.pipeline.calibration import write_calibration as write_calibration
from fgpose.pipeline.load import load_source as load_source
from fgpose.pipeline.outputs import Display as Display
from fgpose.pipeline.outputs import OutputError as OutputError
from fgpose.pipeline.outputs import Outputs as Outputs
from fgpose.pipeline.outputs import write_all as write_all
from fgpose.pipeline.outputs import write_outputs as write_outputs
from fgpose.pipeline.result import Result as Result
from fgpose.pipeline.result import show as show
from fgpose.pipeline.run import run_calibrate as run_calibrate
from fgpose.pipeline.run import run_refine as run_refine
from fgpose.pipeline.run import run_smooth as run_smooth
from fgpose.pipeline.seen_walk import SeenWalk as SeenWalk
from fgpose.pipeline.seen_walk import show_walk as show_walk
from fgpose.pipeline.source import AnySource as AnySource
from fgpose.pipeline.source import Source as Source
from fgpose.pipeline.track import run_track as run_track
