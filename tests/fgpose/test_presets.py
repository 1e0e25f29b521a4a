"""The files in configs/. Run as a program, this writes configs/default.toml anew after a default has changed."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import textwrap
import tomllib
from pathlib import Path

import pytest

from fgpose import parameters
from fgpose.config import Config, config_to_toml, load_config

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PRESETS = ("workcell", "mocap_lab", "paper")
_HEADER = """\
# Every parameter of fgpose with its default. Copy what you want to change; what a file leaves out keeps its default.
# Lengths in metres, times in seconds, image errors in pixels. An unknown key is an error.
"""


def test_default_file_is_the_defaults_of_the_code() -> None:
    assert load_config(CONFIGS / "default.toml") == Config()


def test_default_file_names_every_key() -> None:
    table = tomllib.loads((CONFIGS / "default.toml").read_text(encoding="utf-8"))
    assert table == tomllib.loads(config_to_toml(Config()))


def test_default_file_says_what_the_code_says() -> None:
    text = (CONFIGS / "default.toml").read_text(encoding="utf-8")
    assert text == _default_toml(), "run `python tests/fgpose/test_presets.py` to write configs/default.toml anew"


@pytest.mark.parametrize("name", PRESETS)
def test_preset_names_only_what_differs(name: str) -> None:
    table = tomllib.loads((CONFIGS / f"{name}.toml").read_text(encoding="utf-8"))
    load_config(CONFIGS / f"{name}.toml")
    defaults = dataclasses.asdict(Config())
    same = [
        f"{section}.{key}"
        for section in table
        for key in table[section]
        if table[section][key] == defaults[section][key]
    ]
    assert table
    assert same == []


def test_every_preset_is_tested() -> None:
    assert {path.stem for path in CONFIGS.glob("*.toml")} == {"default", *PRESETS}


def test_paper_preset_has_neither_time_nor_robustness() -> None:
    config = load_config(CONFIGS / "paper.toml")
    assert config.motion.model == "none"
    assert config.symmetry.form == "frame"
    assert config.projection.weighting == "uniform"
    assert config.projection.kernel == "none"
    # Eq. 5 adds squared pixels and, by default, squared millimetres: the sigmas of the smoother say the same.
    assert config.projection.sigma_px * config.refinement.px_per_mm == pytest.approx(1000 * config.symmetry.sigma_m)


def _default_toml() -> str:
    """The defaults as TOML, with the docstrings of the code as comments."""
    sections = [_section(section.name, getattr(Config(), section.name)) for section in dataclasses.fields(Config)]
    return "\n".join([_HEADER, *sections])


def _section(name: str, section: object) -> str:
    explanations = _field_docstrings(type(section))
    lines = [*_comment(inspect.getdoc(type(section)) or ""), f"[{name}]"]
    values = tomllib.loads(config_to_toml(Config()))[name]
    for key, value in values.items():
        lines += [*_comment(explanations[key]), f"{key} = {_toml_value(value)}"]
    return "\n".join(lines) + "\n"


def _toml_value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(" ".join(text.split()), width=118)]


def _field_docstrings(cls: type) -> dict[str, str]:
    """The string below each field, which Python itself does not keep."""
    tree = ast.parse(inspect.getsource(parameters))
    (body,) = (node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == cls.__name__)
    explanations = {}
    for statement, following in itertools.pairwise(body):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            assert isinstance(following, ast.Expr), f"{cls.__name__}.{statement.target.id} has no docstring"
            assert isinstance(following.value, ast.Constant)
            explanations[statement.target.id] = str(following.value.value)
    return explanations


if __name__ == "__main__":
    (CONFIGS / "default.toml").write_text(_default_toml(), encoding="utf-8")
