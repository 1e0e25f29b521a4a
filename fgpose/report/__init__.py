"""What a finished recording is worth, in numbers, in words and as a page that opens anywhere."""

from fgpose.report.finished import FinishedRecording as FinishedRecording
from fgpose.report.quality import Quality as Quality
from fgpose.report.quality import quality as quality
from fgpose.report.report import write_report as write_report
from fgpose.report.suspicion import Suspicion as Suspicion
