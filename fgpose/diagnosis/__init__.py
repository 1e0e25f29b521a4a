"""What is probably wrong with a recording, its rig and its result; why; and what to do about it.

diagnose gives a Diagnosis: each Finding has a Code, of which docs/help/findings.md tells all, and a Severity.
"""

from fgpose.diagnosis.diagnose import Diagnosis, diagnose
from fgpose.finding import Code, Finding, Severity

__all__ = [
    "Code",
    "Diagnosis",
    "Finding",
    "Severity",
    "diagnose",
]
