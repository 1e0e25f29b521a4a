"""What a finished recording is worth, in numbers, in words and as a page that opens anywhere."""

from fgpose.diagnosis.finished import FinishedRecording as FinishedRecording
from fgpose.report.quality import Quality as Quality
from fgpose.report.quality import quality as quality
from fgpose.report.report import write_report as write_report
from fgpose.report.results import find_result as find_result
from fgpose.report.results import load_finished as load_finished
from fgpose.report.study_report import StudyRecording as StudyRecording
from fgpose.report.study_report import write_study_report as write_study_report
from fgpose.report.study_results import thumbnail as thumbnail
