"""Names that there are not, and which may be meant."""

from __future__ import annotations

import pytest

import fgpose
from fgpose.shown.unknown_names import check_names, did_you_mean
from fgpose_benchmarks.synthetic import ring_rig


@pytest.mark.parametrize(
    ("name", "names", "meant"),
    [
        ("left_wirst", ("left_elbow", "left_wrist"), "left_wrist"),
        ("Left Wrist", ("left_elbow", "left_wrist"), "left_wrist"),
        ("cam_1", ("cam01", "cam02"), "cam01"),
        ("frnt", ("front", "rear"), "front"),
    ],
)
def test_what_is_near_is_meant(name: str, names: tuple[str, ...], meant: str) -> None:
    assert did_you_mean(name, names) == f" (did you mean {meant}?)"


@pytest.mark.parametrize(("name", "names"), [("cam05", ("cam01", "cam06")), ("7", ("17", "27")), ("x", ("y", "z"))])
def test_another_number_or_nothing_alike_is_not(name: str, names: tuple[str, ...]) -> None:
    assert not did_you_mean(name, names)


def test_all_unknown_names_are_said_once() -> None:
    check_names(["a"], ("a", "b"), "there is no", "there are")
    with pytest.raises(ValueError, match=r"^there is no frnt \(did you mean front\?\), top; there are front, rear$"):
        check_names(["frnt", "rear", "top", "frnt"], ("front", "rear"), "there is no", "there are")


def test_of_cameras_and_angles() -> None:
    rig = ring_rig(3)
    first = rig.names[0]
    with pytest.raises(ValueError, match=rf"no camera {first.upper()} \(did you mean {first}\?\); it has {first}, "):
        rig.subset([first.upper()])
    skeleton = fgpose.load_skeleton("coco_17")
    with pytest.raises(ValueError, match=r"coco_17 has no joint 'left_wirst' \(did you mean left_wrist\?\)"):
        skeleton.index("left_wirst")
