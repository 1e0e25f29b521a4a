"""What is said of a result at its end."""

from __future__ import annotations

import pytest

from fgpose.cli.console import new_console
from fgpose.cli.delivery import print_findings
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.finding import Code, Finding, Severity


@pytest.mark.parametrize(
    ("findings", "said"),
    [
        ({}, "Nothing suspicious: clocks."),
        ({Code.READ_WITH_REPAIRS: Severity.NOTE}, "Nothing suspicious: clocks."),
        ({Code.HALLUCINATING_CAMERA: Severity.NOTE}, "Nothing else suspicious: clocks."),
        ({Code.CALIBRATION: Severity.DOUBTFUL, Code.SEVERAL_PEOPLE: Severity.NOTE}, "Looked at: clocks."),
    ],
)
def test_what_stands_above_is_not_denied(
    findings: dict[Code, Severity], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tuple(Finding(code, severity, "it is so", "Look.", 0.5) for code, severity in findings.items())
    print_findings(new_console(), Diagnosis(found, ("clocks",), {}))
    assert capsys.readouterr().out.splitlines()[-1] == said
