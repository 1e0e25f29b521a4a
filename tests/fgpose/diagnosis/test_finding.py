"""Findings: which ones remain where one explains another, and that all are documented."""

from __future__ import annotations

import re
from dataclasses import replace
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from fgpose.diagnosis.consequences import EXPLAINS, most_important
from fgpose.diagnosis.swapped_sides import swapped_sides
from fgpose.finding import Code, Finding, Severity

PAGE = Path(__file__).parents[3] / "docs" / "help" / "findings.md"


def found(code: Code, severity: Severity = Severity.DOUBTFUL, weight: float = 0.5, camera: str = "") -> Finding:
    return Finding(code, severity, "it is so", "Do this.", weight, camera=camera)


def test_a_cause_takes_the_place_of_what_follows_from_it() -> None:
    cause, consequence = found(Code.IMAGE_SIZE, camera="a"), found(Code.LARGE_ERRORS)
    assert most_important([consequence, cause]) == (cause,)


def test_a_cause_is_as_severe_as_what_it_takes_the_place_of() -> None:
    cause, consequence = found(Code.LATE_CAMERA, camera="a"), found(Code.LARGE_ERRORS, Severity.WRONG)
    (left,) = most_important([consequence, cause])
    assert (left.code, left.severity) == (Code.LATE_CAMERA, Severity.WRONG)
    note = found(Code.FEW_CAMERAS, Severity.NOTE)
    turned = found(Code.IMPOSSIBLE_TURN, Severity.WRONG)
    assert most_important([note, turned]) == (turned, note)


def test_a_doubt_about_one_camera_does_not_explain_what_is_wrong_of_another() -> None:
    moved, disagrees = found(Code.MOVED_CAMERA, camera="a"), found(Code.DISAGREEING_CAMERA, Severity.WRONG, camera="b")
    assert most_important([moved, disagrees]) == (disagrees, moved)
    (own,) = most_important([replace(moved, camera="b"), disagrees])
    assert (own.code, own.severity) == (Code.MOVED_CAMERA, Severity.WRONG)
    surely = replace(moved, severity=Severity.WRONG)
    assert most_important([surely, disagrees]) == (surely,)


def test_sides_that_are_corrected_are_no_severer_than_they_say() -> None:
    exchanges = found(Code.EXCHANGED_SIDES, camera="b")
    disagrees, moved = found(Code.DISAGREEING_CAMERA, Severity.WRONG, camera="b"), found(Code.MOVED_CAMERA, camera="a")
    assert most_important([exchanges, disagrees, moved]) == (exchanges, moved)


def test_sides_that_seem_exchanged_in_a_late_camera_are_explained_by_it() -> None:
    late, exchanges = found(Code.LATE_CAMERA, camera="a"), found(Code.EXCHANGED_SIDES, camera="a")
    assert most_important([late, exchanges]) == (late,)
    throughout, of_another = replace(exchanges, severity=Severity.WRONG), replace(exchanges, camera="b")
    assert most_important([late, throughout]) == (throughout, late)
    assert most_important([late, of_another]) == (late, of_another)


def test_the_severest_and_weightiest_comes_first_and_nothing_twice() -> None:
    note, wrong = found(Code.SHORT_LIFE, Severity.NOTE, 1.0), found(Code.UNIT, Severity.WRONG, 0.1)
    late, later = found(Code.LATE_CAMERA, weight=0.2, camera="a"), found(Code.LATE_CAMERA, weight=0.3, camera="b")
    assert most_important([note, late, later, wrong, late]) == (wrong, later, late, note)


def test_whose_images_are_mirrored_does_not_show_somebody_else() -> None:
    mirrored = found(Code.MIRRORED_IMAGE, Severity.WRONG, camera="a")
    own, others = (found(Code.OTHER_PERSON, Severity.WRONG, camera=name) for name in "ab")
    assert most_important([own, mirrored, others]) == (mirrored, others)
    exchanged = found(Code.EXCHANGED_CAMERAS, Severity.WRONG)
    assert most_important([own, exchanged, others]) == (exchanged,)


def test_kinds_do_not_explain_each_other_away() -> None:
    # CycleError names those that do.
    assert set(TopologicalSorter(EXPLAINS).static_order()) >= EXPLAINS.keys()


def test_who_and_what_it_is_about() -> None:
    assert Finding(Code.GAP, Severity.NOTE, "r", "m", joint="nose", person=2).subject == "person 2: nose"
    assert found(Code.GAP, camera="cam1").subject == "cam1"
    assert found(Code.GAP).text == "it is so. Do this. [gap]"


def test_numbers_that_no_file_can_hold_are_left_out() -> None:
    each = Finding(Code.UNIT, Severity.WRONG, "r", "m", numbers={"a": float("nan"), "b": 2})
    assert dict(each.numbers) == {"b": 2.0}


@pytest.mark.parametrize("code", Code)
def test_every_code_is_explained_to_users(code: Code) -> None:
    assert f"\n| `{code}` | " in PAGE.read_text(encoding="utf-8")


def test_no_code_is_explained_that_does_not_exist() -> None:
    explained = re.findall(r"^\| `([a-z]+-?[a-z-]*)` \| .{20,}\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(explained) == sorted(Code)


def test_a_note_takes_the_place_of_notes_only() -> None:
    note, doubtful = found(Code.NOBODY, Severity.NOTE), found(Code.GAP)
    assert most_important([note, doubtful]) == (doubtful, note)
    assert most_important([note, found(Code.GAP, Severity.NOTE)]) == (note,)


def test_what_is_said_of_all_cameras_is_not_said_of_one() -> None:
    together, one = found(Code.EXCHANGED_SIDES), found(Code.EXCHANGED_SIDES, camera="a")
    assert most_important([one, together]) == (together,)
    note = found(Code.EXCHANGED_SIDES, Severity.NOTE)
    assert most_important([one, note]) == (one, note)


@pytest.mark.parametrize(
    ("shares", "cameras", "words"),
    [
        ({"a": 0.3, "b": 0.37, "c": 0.31}, [""], "all cameras exchange left and right in 30 to 37 % of the frames"),
        ({"a": 0.3, "b": 0.37}, [""], "cameras a, b exchange left and right in 30 to 37 % of the frames"),
        ({"a": 0.3}, ["a"], "camera a exchanges left and right in 30 % of the frames"),
    ],
)
def test_sides_that_most_cameras_exchange_are_one_finding(
    shares: dict[str, float], cameras: list[str], words: str
) -> None:
    severities = dict.fromkeys(shares, Severity.DOUBTFUL)
    told = swapped_sides(shares, 3, of="the frames", severities=severities)
    assert ([each.camera for each in told], told[0].reason) == (cameras, words)
    # Whole poses are corrected where two others tell how.
    assert ("are corrected" in told[0].remedy) == (len(shares) == 1)


def test_a_camera_that_disagrees_is_not_said_to_hallucinate_too() -> None:
    disagrees, hallucinates = (found(code, camera="a") for code in (Code.DISAGREEING_CAMERA, Code.HALLUCINATING_CAMERA))
    other = found(Code.HALLUCINATING_CAMERA, weight=0.1, camera="b")
    assert most_important([hallucinates, disagrees, other]) == (disagrees, other)
    wholly = found(Code.HALLUCINATING_CAMERA, Severity.WRONG, camera="a")
    assert most_important([disagrees, wholly]) == (wholly,)


def test_a_few_exchanged_sides_do_not_explain_noise_of_all() -> None:
    noise, few = found(Code.LARGE_ERRORS, Severity.NOTE), found(Code.EXCHANGED_SIDES, Severity.NOTE, 0.01, camera="a")
    assert most_important([few, noise]) == (noise, few)
    assert most_important([found(Code.EXCHANGED_SIDES, camera="a"), noise])[1:] == ()
