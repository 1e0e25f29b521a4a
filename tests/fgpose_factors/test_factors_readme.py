from __future__ import annotations

import re
from pathlib import Path

import fgpose_factors

README = (Path(fgpose_factors.__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_snippet_runs_and_prints_what_it_says(capsys):
    (snippet,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    exec(compile(snippet, "factors/README.md", "exec"), {})
    (promised,) = re.findall(r"# (.*)", snippet)
    assert capsys.readouterr().out.strip() == promised


def test_every_factor_has_an_entry():
    functions = [name for name in fgpose_factors.__all__ if name.endswith("_factor") and name != "custom_factor"]
    assert len(functions) == 8
    for name in functions:
        assert f"### `{name}`" in README
    for name in set(fgpose_factors.__all__) - set(functions):
        assert f"`{name}" in README, name
