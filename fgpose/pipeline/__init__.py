"""From a recording on disk to results on disk and in the viewer. Prints nothing."""

from fgpose.pipeline.calibration import show_calibrated as show_calibrated
from fgpose.pipeline.calibration import write_bumped as write_bumped
from fgpose.pipeline.calibration import write_calibration as write_calibration
from fgpose.pipeline.people import OnTracked as OnTracked
from fgpose.pipeline.people import PeopleResult as PeopleResult
from fgpose.pipeline.people import PeopleSource as PeopleSource
from fgpose.pipeline.people import run_smooth_people as run_smooth_people
from fgpose.pipeline.people import run_track_people as run_track_people
from fgpose.pipeline.people_results import show_people as show_people
from fgpose.pipeline.people_results import write_people as write_people
from fgpose.pipeline.results import OutputError as OutputError
from fgpose.pipeline.results import Outputs as Outputs
from fgpose.pipeline.results import Result as Result
from fgpose.pipeline.results import show as show
from fgpose.pipeline.results import write_all as write_all
from fgpose.pipeline.results import write_outputs as write_outputs
from fgpose.pipeline.run import OnUpdate as OnUpdate
from fgpose.pipeline.run import Progress as Progress
from fgpose.pipeline.run import load_people_source as load_people_source
from fgpose.pipeline.run import load_source as load_source
from fgpose.pipeline.run import run_refine as run_refine
from fgpose.pipeline.run import run_smooth as run_smooth
from fgpose.pipeline.run import run_track as run_track
from fgpose.pipeline.seen_walk import SeenWalk as SeenWalk
from fgpose.pipeline.seen_walk import show_walk as show_walk
from fgpose.pipeline.source import Source as Source
