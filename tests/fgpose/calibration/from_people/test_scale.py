from __future__ import annotations

import numpy as np
import pytest
from adjusted_rigs import walker

from fgpose.calibration.from_people.calibrated import Grade
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.scale import (
    MeasuredDistance,
    ScaleCue,
    adult_cue,
    body_sigma,
    distance_cue,
    fuse,
    network_cue,
    stature_cues,
)
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(4)


def test_two_cues_are_fused_by_their_information() -> None:
    scale = fuse([ScaleCue("a", 1.00, 0.01), ScaleCue("b", 1.02, 0.02)])
    assert scale.factor == pytest.approx(1.02**0.2)  # a has four times the information of b
    assert scale.sigma == pytest.approx(0.01 / np.sqrt(1.25))
    assert not scale.findings
    assert scale.source == "a, b"


def test_a_cue_that_hardly_counts_is_not_named() -> None:
    assert fuse([ScaleCue("a", 1.0, 0.005), ScaleCue("network", 0.95, 0.06)]).source == "a"


def test_a_wrong_stature_is_found_out() -> None:
    scale = fuse([ScaleCue("distance", 1.0, 0.005), ScaleCue("stature 1.60 m", 0.9, 0.01, "check the stature")])
    (finding,) = scale.findings
    assert (finding.grade, finding.remedy) == (Grade.COARSE, "check the stature")
    assert "stature 1.60 m makes everything 10% smaller than distance" in finding.reason
    assert scale.sigma > 0.02  # not what the two claim


def test_three_cues_tell_which_is_wrong() -> None:
    cues = [ScaleCue("distance a", 1.2, 0.005), ScaleCue("distance b", 1.0, 0.005), ScaleCue("stature", 1.0, 0.01)]
    (finding,) = fuse(cues).findings
    assert finding.reason.startswith("distance a makes everything")


def test_cues_that_differ_by_chance_are_no_finding() -> None:
    assert not fuse([ScaleCue("a", 1.0, 0.01), ScaleCue("b", 1.035, 0.01)]).findings


def test_a_network_checks_and_does_not_count() -> None:
    stature, network = ScaleCue("stature 1.20 m", 0.7, 0.02, "check the stature"), ScaleCue("network", 1.0, 0.06)
    alone, checked = fuse([stature]), fuse([stature], network)
    assert checked.factor == alone.factor  # children are small
    assert checked.sigma > 3 * alone.sigma
    assert "network" in checked.findings[0].reason
    near = fuse([stature], ScaleCue("network", 0.75, 0.06))
    assert (near.sigma, near.findings) == (alone.sigma, ())


def test_a_scale_needs_a_cue() -> None:
    with pytest.raises(ValueError, match="no cue"):
        fuse([])


def test_a_measured_distance() -> None:
    true_m = float(np.linalg.norm(RIG.cameras[0].position_m - RIG.cameras[2].position_m))
    cue = distance_cue(MeasuredDistance("ring_0", "ring_2", 2 * true_m), RIG)
    assert (cue.factor, cue.sigma) == (pytest.approx(2.0), pytest.approx(0.005))
    # 30 mm of each camera along the line between them are as good as the rig knows this distance.
    covariance = np.einsum("cd,ij->cidj", np.eye(4), np.eye(3)) * 0.03**2
    cue = distance_cue(MeasuredDistance("ring_0", "ring_2", true_m, 0.01), RIG, covariance)
    assert cue.sigma == pytest.approx(np.sqrt(0.01**2 + 2 * 0.03**2) / true_m)


@pytest.mark.parametrize(
    ("first", "second", "metres", "message"),
    [("a", "b", -1.0, "positive"), ("a", "b", float("nan"), "positive"), ("a", "a", 1.0, "twice")],
)
def test_distances_that_are_none(first: str, second: str, metres: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MeasuredDistance(first, second, metres)


def test_a_distance_names_cameras_of_the_rig() -> None:
    with pytest.raises(ValueError, match="no camera cam9"):
        distance_cue(MeasuredDistance("ring_0", "cam9", 1.0), RIG)


def test_the_stature_by_head_or_segments() -> None:
    truth_m, skeleton = walker(5.0, 0)
    anatomy = Anatomy(skeleton)
    stature_m = anatomy.segments_m(truth_m) / 0.491
    heads = np.full(10, 0.985 * stature_m)
    (by_segments,) = stature_cues(stature_m, truth_m, np.empty(0), anatomy)
    (by_head,) = stature_cues(stature_m, truth_m, heads / 1.05, anatomy)
    assert (by_segments.factor, by_head.factor) == (pytest.approx(1.0), pytest.approx(1.05))
    assert by_head.sigma < by_segments.sigma


def test_the_head_of_somebody_who_stoops_contradicts_the_segments() -> None:
    truth_m, skeleton = walker(5.0, 0)
    anatomy = Anatomy(skeleton)
    stature_m = anatomy.segments_m(truth_m) / 0.491
    cues = stature_cues(stature_m, truth_m, np.full(10, 0.8 * stature_m), anatomy)
    (finding,) = fuse(cues).findings
    assert "the proportions of the body" in finding.reason


@pytest.mark.parametrize("stature_m", [0.2, 178.0, float("nan")])
def test_a_stature_that_is_none(stature_m: float) -> None:
    truth_m, skeleton = walker(5.0, 0)
    with pytest.raises(ValueError, match="stature is"):
        stature_cues(stature_m, truth_m, np.empty(0), Anatomy(skeleton))


def test_the_metric_3d_of_a_network() -> None:
    truth_m, skeleton = walker(5.0, 0)
    anatomy = Anatomy(skeleton)
    # One view of four has its hands wrong; another sees nothing.
    points3d_m = np.repeat(0.93 * truth_m[:, None], 4, axis=1)
    points3d_m[:, 1, [skeleton.index("left_wrist"), skeleton.index("right_wrist")]] *= 1.2
    points3d_m[:, 2] = np.nan
    cue = network_cue(points3d_m, truth_m, anatomy)
    assert cue is not None
    assert cue.factor == pytest.approx(0.93)
    assert cue.sigma >= 0.045  # how much adults differ
    assert network_cue(np.full_like(points3d_m, np.nan), truth_m, anatomy) is None


def test_without_any_cue_the_walker_is_an_adult() -> None:
    truth_m, skeleton = walker(5.0, 0)
    assert adult_cue(0.1 * truth_m, Anatomy(skeleton)).factor == pytest.approx(10, rel=0.2)


@pytest.mark.parametrize("name", builtin_skeletons())
def test_every_skeleton_has_legs_and_something_on_top(name: str) -> None:
    skeleton = load_skeleton(name)
    anatomy = Anatomy(skeleton)
    standing_m = standing(name)
    assert anatomy.top_m(standing_m)[0, 2] > 1.3
    assert np.allclose(anatomy.left(standing_m), [0.0, 1.0, 0.0])
    assert anatomy.feet_m(standing_m).shape[:2] == (1, 2)
    assert anatomy.foot_height[0] == pytest.approx(
        0.010 if "left_heel" in skeleton.joints else 0.051
    )  # ankle in a shoe
    assert (anatomy.head is None) == (name == "smpl_24")
    assert anatomy.stature_m(standing_m) == pytest.approx(1.7, rel=0.03)


def standing(name: str) -> np.ndarray:
    """(1, J, 3) of somebody of 1.70 m who stands and looks along x, with Drillis and Contini's proportions."""
    heights = {
        "hip": 0.530, "knee": 0.285, "ankle": 0.039, "shoulder": 0.818, "head": 1.0, "head_top": 1.0, "nose": 0.90,
        "ear": 0.9255, "eye": 0.93, "neck": 0.85, "neck_base": 0.85, "thorax": 0.82, "heel": 0.01, "toe": 0.01,
        "foot": 0.02, "foot_index": 0.01, "pelvis": 0.53,
    }  # fmt: skip
    joints_m = []
    for joint in load_skeleton(name).joints:
        part = joint.removeprefix("left_").removeprefix("right_")
        height = heights.get(part, heights.get(part.split("_")[-1], 0.6))
        side = 1.0 if joint.startswith("left_") else -1.0 if joint.startswith("right_") else 0.0
        joints_m.append([0.1 if "toe" in part or part in ("nose", "foot_index") else 0.0, 0.1 * side, 1.7 * height])
    return np.array([joints_m])


def test_a_skeleton_without_legs_has_no_anatomy() -> None:
    from fgpose.skeleton import Skeleton

    with pytest.raises(ValueError, match="no joint 'left_hip'"):
        Anatomy(Skeleton("hand", ("wrist", "thumb"), ((0, 1),), (0,)))


def test_halves_that_have_the_body_larger_do_not_know_its_size() -> None:
    lengths = np.random.default_rng(0).uniform(0.2, 0.5, (1, 14)).repeat(20, axis=0)
    lengths[:5] = np.nan
    assert body_sigma(lengths, [lengths[:10], lengths[10:]]) == pytest.approx(0.0, abs=1e-12)
    halves = [1.1 * lengths[:10], 0.95 * lengths[10:]]
    assert body_sigma(lengths, halves) == pytest.approx(np.hypot(np.log(1.1), np.log(0.95)))
