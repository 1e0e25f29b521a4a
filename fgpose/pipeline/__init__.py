"""From a recording on disk to results on disk and in the viewer. Prints nothing."""

from fgpose.pipeline.results import OutputError as OutputError
from fgpose.pipeline.results import Outputs as Outputs
from fgpose.pipeline.results import Result as Result
from fgpose.pipeline.results import show as show
from fgpose.pipeline.results import write_all as write_all
from fgpose.pipeline.results import write_outputs as write_outputs
from fgpose.pipeline.run import OnUpdate as OnUpdate
from fgpose.pipeline.run import Progress as Progress
from fgpose.pipeline.run import load_source as load_source
from fgpose.pipeline.run import run_refine as run_refine
from fgpose.pipeline.run import run_smooth as run_smooth
from fgpose.pipeline.run import run_track as run_track
from fgpose.pipeline.source import Source as Source
