"""Many recordings: found by patterns, estimated on all cores or on a cluster, and put together in one data set."""

from fgpose.study.plan import Plan as Plan
from fgpose.study.process import RecordingOutcome as RecordingOutcome
from fgpose.study.process import process as process
from fgpose.study.run import StudyResult as StudyResult
from fgpose.study.run import run_study as run_study
from fgpose.study.study import StudyDescription as StudyDescription
from fgpose.study.study import load_study as load_study
from fgpose.study.trial import Trial as Trial
