"""What is probably wrong with a recording, its rig and its result; why; and what to do about it.

diagnose gives a Diagnosis: each Finding has a Code, of which docs/help/findings.md tells all, and a Severity.
OtherBone says why bone lengths that were given were not used.
"""

from fgpose.diagnosis.diagnose import Diagnosis, diagnose
from fgpose.finding import Code, Finding, Severity
from fgpose.trajectory import OtherBone

__all__ = [
    "Code",
    "Diagnosis",
    "Finding",
    "OtherBone",
    "Severity",
    "diagnose",
]
