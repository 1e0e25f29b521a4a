"""The benchmark of faults: that damages harm, what is said of them, and its report; a tenth of it."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.cli import main
from fgpose.diagnosis.diagnose import diagnose
from fgpose.finding import Code, Severity
from fgpose_benchmarks.faults.benchmark import DAMAGES, find_damages, run
from fgpose_benchmarks.faults.damage import Damage, Damaged
from fgpose_benchmarks.faults.in_time import bumped
from fgpose_benchmarks.faults.outcome import UNDAMAGED, DamageOutcome, outcome_of
from fgpose_benchmarks.faults.real import real_takes
from fgpose_benchmarks.faults.report import write_report
from fgpose_benchmarks.faults.take import CLIPS, Take, takes

# Not named on this clip: one of four lenses that distorts does no harm here (29.0 mm for 28.9); half of a distortion
# does not show in 14 s, which diagnose says.
MISNAMED = {"distortion left out, one camera", "distortion of another lens"}
NAMED = [each for each in DAMAGES if each.name not in MISNAMED]
# Every cause has tests of its own.
FAST = {"turned by 90 degrees, one camera"}
SOME_FAST = [pytest.param(each, id=each.name, marks=[] if each.name in FAST else [pytest.mark.slow]) for each in NAMED]


@cache
def every_take() -> dict[str, Take]:
    return {take.rig_name: take for take in takes(CLIPS[2:3], 14.0)}


def damaged(damage: Damage) -> Damaged:
    return damage.inflict(every_take()["4 cameras"], np.random.default_rng([7, len(damage.name)]))


def test_names_of_damages_differ() -> None:
    assert len({damage.name for damage in DAMAGES}) == len(DAMAGES) >= 35
    with pytest.raises(ValueError, match="there is no damage 'rain'"):
        find_damages(["rain"])


@pytest.mark.parametrize(
    "rig", ["2 cameras", *(pytest.param(name, marks=pytest.mark.slow) for name in ("3 cameras", "4 cameras"))]
)
def test_nothing_is_said_of_what_is_undamaged(rig: str) -> None:
    take = every_take()[rig]
    findings = diagnose(take.observations, take.rig).findings
    assert [each for each in findings if each.severity is not Severity.NOTE] == []


@pytest.mark.parametrize("damage", SOME_FAST)
def test_the_cause_of_a_damage_is_named_first(damage: Damage) -> None:
    given = damaged(damage)
    findings = diagnose(given.observations, given.rig).findings
    assert findings, "nothing is said"
    assert findings[0].code in damage.codes, [each.text for each in findings]
    assert not given.cameras or not findings[0].camera or findings[0].camera in given.cameras


@pytest.mark.slow
def test_views_that_follow_somebody_else_do_not_make_others_look_moved() -> None:
    """On this clip a third camera was said to be moved by 8 degrees; one that was moved by as much still is."""
    take = next(take for take in takes(CLIPS[3:4]) if take.rig_name == "4 cameras")
    (beside,) = find_damages(["somebody beside for a while, two cameras"])
    given = beside.inflict(take, np.random.default_rng(1))
    findings = diagnose(given.observations, given.rig).findings
    assert [(each.code, each.camera) for each in findings] == [(Code.IDENTITY_SWITCH, name) for name in given.cameras]
    given = bumped(8.0)(take, np.random.default_rng(1))
    findings = diagnose(given.observations, given.rig).findings
    assert [(each.code, each.camera) for each in findings] == [(Code.BUMPED_CAMERA, given.cameras[0])]


@pytest.mark.slow
def test_a_damage_is_harmful_and_said_and_following_the_advice_mends_it() -> None:
    (damage,) = find_damages(["inches as metres"])
    outcome = outcome_of(every_take()["2 cameras"], damage)
    assert outcome.harmful
    assert outcome.said
    assert outcome.right
    assert not outcome.silent
    assert outcome.followed_mm == pytest.approx(outcome.undamaged_mm, rel=1e-3)  # the factor is exact


@pytest.mark.slow
def test_following_the_advice_mends_lost_frames() -> None:
    (damage,) = find_damages(["6 frames lost"])
    outcome = outcome_of(every_take()["4 cameras"], damage)
    assert outcome.right
    assert outcome.followed_mm < min(1.1 * outcome.attainable_mm, outcome.error_mm)


def test_the_report_counts(tmp_path: Path) -> None:
    def outcome(damage: str, **values: Any) -> DamageOutcome:
        given: dict[str, Any] = {"said": True, "right": True, "error_mm": 90.0, "found": ("wrong:unit:",)} | values
        given |= {"undamaged_mm": 30.0, "undamaged_inside": 0.98, "inside": 0.95}
        return DamageOutcome(damage, "clip", "4 cameras", followed_mm=33.0, attainable_mm=30.0, **given)

    outcomes = [
        outcome(UNDAMAGED, error_mm=30.0, said=False, right=False),
        outcome("bent"),
        outcome("bent", said=False, right=False),
    ]
    text = write_report(outcomes, tmp_path, "fgpose benchmark faults").read_text(encoding="utf-8")
    assert "Silent 1 of 2 damaged recordings; cause right 50; false alarms 0 of 1 undamaged" in text
    assert "| bent | 2 | 2 | 1 | 50 | 3.00 | 1.10 (1.10) | 0 |" in text
    assert (tmp_path / "outcomes.json").exists()


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    arguments = ["--quick", "--damages", "centimetres as metres", "--output", str(tmp_path)]
    assert main(["benchmark", "faults", *arguments]) == 0
    assert "| centimetres as metres | 3 |" in (tmp_path / "report.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_what_is_undamaged_is_measured_too() -> None:
    (alone,) = run([every_take()["2 cameras"]], (), n_workers=0)
    assert alone.damage == UNDAMAGED
    assert alone.error_mm == alone.undamaged_mm


@pytest.mark.slow
def test_a_real_recording_is_filmed_again_as_it_was() -> None:
    by_rig = {take.rig_name: take for take in real_takes() if take.clip == "balance"}
    take = by_rig["3 cameras"]
    again = take.film(take.rig)
    np.testing.assert_allclose(again.points2d_px, take.observations.points2d_px, atol=1e-6)
    np.testing.assert_array_equal(again.confidence > 0, take.observations.confidence > 0)
    # It lasts 1.7 s and comes from no room that could be turned.
    possible = {damage.name for damage in DAMAGES if damage.can_befall(take)}
    assert "two cameras exchanged" in possible
    assert not possible & {"6 frames lost", "y down"}
    outcome = outcome_of(take, find_damages(["two cameras exchanged"])[0])
    assert outcome.harmful
    assert outcome.right
