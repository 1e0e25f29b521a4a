"""Pictures of skeletons."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import fgpose
from fgpose.cli import main
from fgpose.io.skeletons import builtin_skeletons
from fgpose.viewer.skeleton_picture import skeleton_picture

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("name", builtin_skeletons())
def test_every_skeleton_can_be_drawn(name: str) -> None:
    skeleton = fgpose.load_skeleton(name)
    picture = ElementTree.fromstring(skeleton_picture(skeleton))
    circles = picture.findall(f".//{SVG}circle")
    assert len(picture.findall(f".//{SVG}line")) == len(skeleton.bones) + len(skeleton.lines)
    names = [f"{number} {joint}" for number, joint in enumerate(skeleton.joints)]
    assert [circle.findtext(f"{SVG}title") for circle in circles] == names
    texts = {text.text: text for text in picture.findall(f".//{SVG}text")}
    assert set(texts) == {*names, *map(str, range(skeleton.n_joints))}
    for number, circle in enumerate(circles):
        # Beside its own dot.
        across_px = float(texts[str(number)].attrib["x"]) - float(circle.attrib["cx"])
        assert abs(across_px) < 2 * float(circle.attrib["r"])


def test_left_is_on_the_right_of_somebody_seen_from_the_front(skeleton: fgpose.Skeleton) -> None:
    circles = ElementTree.fromstring(skeleton_picture(skeleton)).findall(f".//{SVG}circle")
    across_px = {joint: float(circle.attrib["cx"]) for joint, circle in zip(skeleton.joints, circles, strict=True)}
    assert across_px["left_wrist"] > across_px["pelvis"] > across_px["right_wrist"]


def test_unknown_joints_are_named() -> None:
    tail = fgpose.Skeleton("cat", ("pelvis", "tail"), ((0, 1),), (0,))
    with pytest.raises(ValueError, match="where to draw tail of skeleton cat is not known"):
        skeleton_picture(tail)


def test_the_command_lists_shows_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["skeletons"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in builtin_skeletons())
    assert main(["skeletons", "COCO", "--picture", str(tmp_path / "coco.svg")]) == 0
    shown = capsys.readouterr().out
    assert "coco_17: 17 joints, root left_hip and right_hip" in shown
    assert " 9  left_wrist      left_elbow" in shown
    assert ElementTree.parse(tmp_path / "coco.svg").getroot().tag == f"{SVG}svg"
    assert main(["skeletons", "mhr_70"]) == 0
    rows = capsys.readouterr().out.splitlines()
    place = rows[2].index("left_eye, right_eye")
    assert {row[place - 1] for row in rows[2:]} == {" "}, "names of any length, and rows that are too long, in columns"
    assert main(["skeletons", "COCO", "--picture", str(tmp_path / "coco.png")]) == 2
    assert "coco.png: a picture of a skeleton is written as .svg" in capsys.readouterr().err
    assert not (tmp_path / "coco.png").exists()
    assert main(["skeletons", "--picture", str(tmp_path / "all.svg")]) == 2
    assert "--picture is of one skeleton: name it" in capsys.readouterr().err
