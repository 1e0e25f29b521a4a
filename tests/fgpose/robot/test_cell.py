"""Cell files: what they say, and one clear error for each way to damage them."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgpose.live.tracking.observed import Volume
from fgpose.robot import cell as cell_module
from fgpose.robot.cell import Box, Capsule, Limits, load_cell

TIP_M = 0.0, 0.0, 0.4
CELL = """
quantile = 0.95
max_age_s = 0.3

[volume]
low_m = [-2, -2, 0]
high_m = [2, 2, 2.2]

[radius_m]
lower_arm = 0.08

[links.forearm]
capsules = [{ from_m = [0, 0, 0], to_m = [0, 0, 0.4], radius_m = 0.08 }]
spheres = [{ centre_m = [0, 0, 0.4], radius_m = 0.1 }]

[zones.conveyor]
boxes = [{ low_m = [0.5, -1, 0], high_m = [1, 1, 0.9] }]
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_cell(tmp_path: Path) -> None:
    cell = load_cell(write(tmp_path, CELL))
    forearm, conveyor = cell.links
    assert forearm.capsules == (Capsule((0.0, 0.0, 0.0), TIP_M, 0.08), Capsule(TIP_M, TIP_M, 0.1))
    assert (forearm.name, forearm.is_fixed) == ("forearm", False)
    assert conveyor.boxes == (Box((0.5, -1.0, 0.0), (1.0, 1.0, 0.9)),)
    assert (conveyor.name, conveyor.is_fixed) == ("conveyor", True)
    assert (cell.limits.quantile, cell.limits.max_age_s, cell.limits.walking_m_s) == (0.95, 0.3, 1.6)
    assert cell.volume == Volume((-2.0, -2.0, 0.0), (2.0, 2.0, 2.2))
    assert cell.radius_m == {"lower_arm": 0.08}


def test_the_examples_of_the_documentation_are_cells(tmp_path: Path) -> None:
    in_code = (cell_module.__doc__ or "").partition("\n\n")[2]
    page = (Path(__file__).parents[3] / "docs" / "live_distances.md").read_text(encoding="utf-8")
    for example in (in_code, page.partition("```toml\n")[2].partition("```")[0]):
        cell = load_cell(write(tmp_path, example))
        assert [link.name for link in cell.links] == ["forearm", "conveyor"]
        assert cell.limits == Limits()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("quantile = 0.95", "quantil = 0.95", "quantil: unknown key; known: quantile, max_age_s"),
        ("quantile = 0.95", "quantile = 1.0", "quantile: a number from 0.5 to below 1 is needed, got 1"),
        ("quantile = 0.95", "quantile = 'high'", "quantile: a number is needed, got 'high'"),
        ("max_age_s = 0.3", "max_age_s = nan", "max_age_s: a number is needed, got nan"),
        ("max_age_s = 0.3", "max_age_s = 1" + 400 * "0", "max_age_s: a number is needed, got 1000"),
        ("max_age_s = 0.3", "max_age_s = -1", "max_age_s: a positive number is needed, got -1"),
        ("max_age_s = 0.3", "min_observed_share = 1.5", "min_observed_share: at most 1 is needed, got 1.5"),
        ("low_m = [-2, -2, 0]", "low_m = [3, -2, 0]", "volume: low_m must be below high_m"),
        ("high_m = [2, 2, 2.2]", "high_m = [2, 2, 2.2]\nspacing_m = 0.001", "volume: spacing_m must be positive and"),
        ("high_m = [2, 2, 2.2]", "", "volume.high_m is missing"),
        ("lower_arm", "tail", "radius_m.tail: unknown key; known: trunk, neck"),
        ("lower_arm = 0.08", "lower_arm = 0", "radius_m.lower_arm: a positive number is needed, got 0"),
        ("radius_m = 0.08 }", "radius_m = -0.08 }", r"links.forearm.capsules[0].radius_m: a positive number is needed"),
        (
            "to_m = [0, 0, 0.4]",
            "to_m = [0, 0]",
            r"links.forearm.capsules[0].to_m: three numbers are needed, got [0, 0]",
        ),
        ("to_m = [0, 0, 0.4], ", "", r"links.forearm.capsules[0].to_m is missing"),
        ("centre_m", "center_m", r"links.forearm.spheres[0].center_m: unknown key; known: centre_m, radius_m"),
        ("high_m = [1, 1, 0.9]", "high_m = [1, -1, 0.9]", r"zones.conveyor.boxes[0]: low_m must be below high_m"),
        ("boxes = [{", "boxes = [7, {", r"zones.conveyor.boxes[0]: a table is needed, got 7"),
        (
            "boxes = [{ low_m = [0.5, -1, 0], high_m = [1, 1, 0.9] }]",
            "boxes = 3",
            "zones.conveyor.boxes: a list of tables",
        ),
        (
            "boxes = [{ low_m = [0.5, -1, 0], high_m = [1, 1, 0.9] }]",
            "",
            "zones.conveyor: capsules, spheres or boxes are",
        ),
        ("[zones.conveyor]", "[zones.forearm]", "forearm is the name of two links or zones"),
        ("[zones.conveyor]", "[zones.conveyor", "Expected ']' at the end of a table declaration"),
    ],
)
def test_damage_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in CELL
    path = write(tmp_path, CELL.replace(old, new, 1))
    with pytest.raises(ValueError) as raised:  # noqa: PT011  the message is compared below
        load_cell(path)
    assert str(raised.value).startswith(f"{path}: {message}")


def test_a_cell_without_links_is_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cell.toml: neither links nor zones are given"):
        load_cell(write(tmp_path, "quantile = 0.9"))
    with pytest.raises(ValueError, match=r"cell.toml: links: a table is needed, got 3"):
        load_cell(write(tmp_path, "links = 3"))
    with pytest.raises(FileNotFoundError, match=r"cell.toml"):
        load_cell(tmp_path / "none" / "cell.toml")
