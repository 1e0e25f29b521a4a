"""Which variables each kind of factor joins, and how strongly; that both solvers see the same is tested with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

from fgpose.config import Config, MotionConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.factors.bone_length import bone_lengths
from fgpose.estimation.factors.fading import Fading, maybe_unseen, with_references
from fgpose.estimation.factors.kinds import KINDS, Factors, factors_of, graph_factors
from fgpose.estimation.factors.motion import _FINEST_STEP_M, Motions
from fgpose.estimation.factors.prior import LengthPriors, Priors
from fgpose.estimation.factors.projection import Projections, detection_information
from fgpose.estimation.factors.symmetry import Symmetries
from fgpose.estimation.keys import length_key, position_key, velocity_key
from fgpose.estimation.process_noise import initial_density
from fgpose.estimation.segment import Predecessor, Segment
from fgpose.skeleton import MAX_JOINTS, BoneLengths, Skeleton

NAN = np.nan
FRAME = 7
STEP_S = 0.02


def of_kind(kind: Callable[[Segment], Iterable[Factors]], segment: Segment) -> list[gtsam.NonlinearFactor]:
    return [factor for factors in kind(segment) for factor in factors.graph_factors(segment.keys)]


def joint_and_frame(key: int) -> tuple[int, int]:
    frame, joint = divmod(gtsam.symbolIndex(key), MAX_JOINTS)
    return joint, frame


def names(factors: Iterable[gtsam.NonlinearFactor]) -> Counter[str]:
    return Counter(type(factor).__name__ for factor in factors)


def keys(factor: gtsam.NonlinearFactor) -> tuple[int, ...]:
    return tuple(factor.keys())


@pytest.fixture
def newest(walking_scene, rig, skeleton) -> Segment:
    """The newest frame online: everyone was there in the frame before, and every length is known."""
    evidence = gather(walking_scene.observations.frames(slice(0, 1)), rig, Config())
    everyone = np.ones((1, skeleton.n_joints), dtype=bool)
    return Segment(
        rig,
        skeleton,
        Config(),
        evidence,
        everyone,
        np.full(skeleton.n_lengths, 0.3),
        np.ones((1, skeleton.n_joints)),
        BoneLengths(np.full(skeleton.n_lengths, 0.3), np.full(skeleton.n_lengths, 0.01)),
        lengths_known=True,
        before=Predecessor(float(evidence.time_s[0]) - STEP_S, everyone[0]),
        first_frame=FRAME,
    )


def with_config(segment: Segment, **sections: Any) -> Segment:
    return replace(segment, config=replace(segment.config, **sections))


def with_evidence(segment: Segment, **arrays: Any) -> Segment:
    return replace(segment, evidence=replace(segment.evidence, **arrays))


def unseen(segment: Segment, *joints: str) -> Segment:
    points_px = segment.evidence.undistorted_px.copy()
    points_px[:, :, [segment.skeleton.index(joint) for joint in joints]] = NAN
    return with_evidence(segment, undistorted_px=points_px)


def absent(segment: Segment, *joints: str) -> Segment:
    active = segment.active.copy()
    active[0, [segment.skeleton.index(joint) for joint in joints]] = False
    return replace(segment, active=active)


def test_keys_sort_by_kind_then_frame_then_joint():
    ordered = [length_key(0), length_key(16), velocity_key(0, 0), velocity_key(255, 900)]
    ordered += [position_key(0, 0), position_key(1, 0), position_key(255, 0), position_key(0, 1), position_key(3, 70)]
    assert sorted(ordered) == ordered
    assert len(set(ordered)) == len(ordered)


def test_one_projection_factor_per_detection_of_an_active_joint(newest):
    points_px = newest.evidence.undistorted_px.copy()
    points_px[0, 1, 3:6] = NAN
    points_px[0, 2, 4, 0] = NAN
    points_px[0, :, 9] = NAN
    factors = of_kind(Projections.of, absent(with_evidence(newest, undistorted_px=points_px), "left_wrist", "head"))
    expected = Counter({position_key(joint, FRAME): 4 for joint in range(17) if joint not in (3, 4, 5, 9, 10, 13)})
    expected |= Counter({position_key(3, FRAME): 3, position_key(4, FRAME): 2, position_key(5, FRAME): 3})
    assert Counter(key for factor in factors for key in keys(factor)) == expected
    assert names(factors) == {"TriangulationFactorCal3_S2": expected.total()}


def test_the_weight_of_a_detection_is_its_information(walking_scene, rig, newest):
    weights = np.ones((1, 4, 17))
    weights[0, 0], weights[0, 1], weights[0, 2] = 0.25, 0.04, 0.01
    config = ProjectionConfig(kernel="none")
    values = gtsam.Values()
    values.insert(position_key(0, FRAME), walking_scene.truth_m[0, 0])
    evidence = {"weights": weights, "sigma_px": np.full(weights.shape, 6.0)}
    segment = with_config(with_evidence(newest, **evidence), projection=config)
    factors = of_kind(Projections.of, segment)[::17]
    points_px = newest.evidence.undistorted_px[0]
    squared_px2 = np.sum((rig.project(walking_scene.truth_m[0])[:, 0] - points_px[:, 0]) ** 2, axis=-1)
    sigmas_px = np.sqrt(squared_px2 / np.array([2 * factor.error(values) for factor in factors]))
    # 6 px / sqrt(weight)
    np.testing.assert_allclose(sigmas_px, [12.0, 30.0, 60.0, 6.0], rtol=1e-3)


def test_the_information_of_detections_is_that_of_their_factors(walking_scene, rig, newest):
    points_m = walking_scene.truth_m[:1].copy()
    points_m[0, 5] = NAN
    evidence = newest.evidence
    found = detection_information(
        rig, evidence.undistorted_px, evidence.detection_sigma_px, points_m, ProjectionConfig()
    )
    for joint in range(17):
        if joint == 5:
            assert np.isnan(found[0, joint]).all()
            continue
        values = gtsam.Values()
        values.insert(position_key(joint, FRAME), points_m[0, joint])
        own = [f for f in of_kind(Projections.of, newest) if keys(f) == (position_key(joint, FRAME),)]
        jacobians = [factor.linearize(values).jacobian()[0] for factor in own]
        expected = sum((A.T @ A for A in jacobians), np.zeros((3, 3)))
        np.testing.assert_allclose(found[0, joint], expected, rtol=1e-9, atol=1e-9 * np.trace(expected))


def test_symmetry_factors_need_all_four_joints(skeleton, newest):
    newest = with_config(newest, symmetry=SymmetryConfig(form="frame"))
    factors = of_kind(Symmetries.of, newest)
    assert names(factors) == {"CustomFactor": 4}
    joints = ["left_shoulder", "left_elbow", "right_shoulder", "right_elbow"]
    assert keys(factors[0]) == tuple(position_key(skeleton.index(joint), FRAME) for joint in joints)
    # the elbow belongs to the upper and the lower arm, the ankle to the lower leg alone
    for missing, left_over in (("right_elbow", 2), ("left_ankle", 3), ("spine", 4)):
        assert len(of_kind(Symmetries.of, absent(newest, missing))) == left_over


@pytest.mark.parametrize(
    ("model", "kind", "symbols"),
    [
        ("constant_velocity", "WnoaMotionFactorPoint3", "xvxv"),
        ("random_walk", "BetweenFactorPoint3", "xx"),
    ],
)
def test_motion_factors_join_a_joint_to_itself_one_frame_earlier(newest, model, kind, symbols):
    before = np.zeros(17, dtype=bool)
    before[[2, 5]] = True
    newest = replace(newest, before=Predecessor(0.0, before))
    factors = of_kind(Motions.of, with_config(newest, motion=MotionConfig(model=model)))
    assert names(factors) == {kind: 2}
    for factor, joint in zip(factors, (2, 5), strict=True):
        assert "".join(chr(gtsam.symbolChr(key)) for key in keys(factor)) == symbols
        assert {joint_and_frame(key) for key in keys(factor)} == {(joint, FRAME - 1), (joint, FRAME)}


@pytest.mark.parametrize("model", ["constant_velocity", "random_walk"])
def test_the_motion_of_a_burst_of_frames_keeps_within_double_precision(newest, model):
    config = MotionConfig(model=model, adaptive=False, acceleration_density=20.0)
    density = np.full((1, 17), initial_density(config))

    def information(step_s: float) -> float:
        time_s = newest.evidence.time_s[0]
        segment = replace(newest, before=Predecessor(time_s - step_s, newest.active[0]), process_density=density)
        factor = of_kind(Motions.of, with_config(segment, motion=config))[0]
        values = gtsam.Values()
        for frame in (FRAME - 1, FRAME):
            values.insert(position_key(0, frame), np.zeros(3))
            values.insert(velocity_key(0, frame), np.zeros(3))
        A, _ = factor.linearize(values).jacobian()
        return float(np.abs(A.T @ A).max())

    assert information(1e-12) <= 1.01 / _FINEST_STEP_M**2
    # A kilohertz is taken as it is: 12 / (q h^3) with 20 m^2/s^3, or 1 / (q h) with 1 m^2/s.
    assert information(1e-3) == pytest.approx(6e8 if model == "constant_velocity" else 1e3, rel=1e-6)


def test_a_first_frame_and_no_motion_model_have_no_motion_factors(newest):
    assert not of_kind(Motions.of, with_config(newest, motion=MotionConfig(model="none")))
    assert not of_kind(Motions.of, replace(newest, before=None))
    assert len(of_kind(Motions.of, newest)) == 17


def fading(segment: Segment) -> list[tuple[str, ...]]:
    """The joints of each fading factor by name, the one that holds first."""
    pairs = []
    for factor in of_kind(Fading.of, segment):
        assert all(chr(gtsam.symbolChr(key)) == "v" for key in keys(factor))
        assert all(joint_and_frame(key)[1] == FRAME for key in keys(factor))
        pairs.append(tuple(segment.skeleton.joints[joint_and_frame(key)[0]] for key in keys(factor)))
    return pairs


def test_no_velocity_fades_while_everyone_is_seen(newest):
    assert fading(unseen(newest)) == []


def test_nothing_fades_in_a_first_frame(newest):
    assert fading(unseen(replace(newest, before=None), "left_wrist")) == []


def test_an_unseen_joint_moves_with_a_seen_neighbour(newest):
    assert fading(unseen(newest, "left_wrist")) == [("left_elbow", "left_wrist")]
    # both neighbours are seen: the one nearer to the root
    assert fading(unseen(newest, "left_elbow")) == [("left_shoulder", "left_elbow")]
    # the nearer one is not seen, the farther one is
    trunk = unseen(newest, "left_shoulder", "thorax", "spine", "neck_base", "right_shoulder")
    assert ("left_elbow", "left_shoulder") in fading(trunk)


def test_fading_has_the_information_expected_by_the_visibility(skeleton: Skeleton, newest):
    wrist = skeleton.index("left_wrist")
    visibility = np.ones((1, 4, 17))
    visibility[0, :, wrist] = [0.2, 0.5, 0.5, 0.0]  # nobody sees it with a probability of 0.2

    def information(segment: Segment) -> np.ndarray:
        (factor,) = of_kind(Fading.of, segment)
        assert isinstance(factor, gtsam.NoiseModelFactor)
        noise = factor.noiseModel()
        assert isinstance(noise, gtsam.noiseModel.Gaussian)
        return noise.information()

    expected = 0.2 * information(unseen(newest, "left_wrist"))
    np.testing.assert_allclose(information(with_evidence(newest, visibility=visibility)), expected, rtol=1e-9)


def test_no_fading_leads_out_of_joints_with_their_references(skeleton: Skeleton, newest):
    def closed(*joints: str) -> set[str]:
        chosen = np.isin(skeleton.joints, joints)
        found = with_references(chosen, maybe_unseen(segment.evidence)[0], skeleton)
        return {joint for joint, is_in in zip(skeleton.joints, found, strict=True) if is_in}

    segment = unseen(newest, "left_elbow", "left_wrist")
    assert closed("right_knee") == {"right_knee"}
    assert closed("left_wrist") == {"left_wrist", "left_elbow", "left_shoulder"}
    assert closed("left_shoulder") == {"left_shoulder"}  # the elbow fades to it, not it to the elbow


def test_a_limb_that_nobody_sees_hangs_on_the_body_joint_by_joint(newest):
    expected = [("left_shoulder", "left_elbow"), ("left_elbow", "left_wrist")]
    assert fading(unseen(newest, "left_elbow", "left_wrist")) == expected


def test_a_person_that_nobody_sees_comes_to_rest(skeleton: Skeleton, newest):
    pairs = fading(unseen(newest, *skeleton.joints))
    assert len(pairs) == 17
    # the root fades to standing still, everyone else to the next joint towards the root: no circle
    assert ("pelvis",) in pairs
    holder_of = {pair[-1]: pair[0] for pair in pairs if len(pair) == 2}
    assert len(holder_of) == 16
    for joint in holder_of:
        steps = [joint]
        while steps[-1] in holder_of:
            steps.append(holder_of[steps[-1]])
            assert len(steps) <= 17
        assert steps[-1] == "pelvis"


def test_a_joint_whose_neighbours_have_no_variables_comes_to_rest(newest):
    assert fading(unseen(absent(newest, "left_elbow"), "left_wrist")) == [("left_wrist",)]


@pytest.mark.parametrize("model", ["random_walk", "none"])
def test_without_velocities_nothing_fades(skeleton, newest, model):
    assert fading(with_config(unseen(newest, *skeleton.joints), motion=MotionConfig(model=model))) == []


def test_priors_hold_position_and_velocity_of_the_joints_that_enter(newest):
    before = np.ones(17, dtype=bool)
    before[[3, 8]] = False
    positions_m = np.arange(51.0).reshape(1, 17, 3)
    newest = replace(newest, before=Predecessor(0.0, before), initial_m=positions_m)
    factors = of_kind(Priors.of, newest)
    assert [keys(factor)[0] for factor in factors] == [
        f(j, FRAME) for j in (3, 8) for f in (position_key, velocity_key)
    ]
    values = gtsam.Values()
    for joint in (3, 8):
        values.insert(position_key(joint, FRAME), positions_m[0, joint])
        values.insert(velocity_key(joint, FRAME), np.zeros(3))
    assert sum(factor.error(values) for factor in factors) == 0.0
    without_velocity = with_config(newest, motion=MotionConfig(model="random_walk"))
    assert names(of_kind(Priors.of, without_velocity)) == {"PriorFactorPoint3": 2}


def test_bones_whose_length_is_not_known_have_no_factor(skeleton, newest):
    lengths_m = newest.lengths_m.copy()
    lengths_m[skeleton.length_of_bone[0]] = NAN
    newest = replace(newest, lengths_m=lengths_m)
    factors = of_kind(bone_lengths, newest)
    # both hips share the length that is missing
    assert names(factors) == {"RangeFactor3": len(skeleton.bones) - 2}
    assert len(of_kind(bone_lengths, absent(newest, "left_wrist"))) == len(factors) - 1
    assert not of_kind(LengthPriors.of, newest)
    estimated = replace(newest, lengths_known=False)
    assert names(of_kind(bone_lengths, estimated)) == {"CustomFactor": len(skeleton.bones) - 2}
    (prior,) = of_kind(LengthPriors.of, estimated)
    assert len(keys(prior)) == skeleton.n_lengths - 1
    assert length_key(skeleton.length_of_bone[0]) not in keys(prior)


def test_a_bone_whose_joints_start_at_one_point_has_no_range_factor(skeleton, newest):
    """GTSAM's has no Jacobian there."""
    start_m = newest.evidence.guess_m.copy()
    start_m[0, skeleton.index("left_wrist")] = start_m[0, skeleton.index("left_elbow")]
    assert len(of_kind(bone_lengths, replace(newest, initial_m=start_m))) == len(skeleton.bones) - 1


def test_all_kinds_are_in_the_graph(newest):
    segment = unseen(newest, "left_wrist")
    assert len(list(graph_factors(segment))) == sum(len(of_kind(kind, segment)) for kind in KINDS)
    assert names(graph_factors(segment)).keys() == {
        "TriangulationFactorCal3_S2",
        "RangeFactor3",
        "WnoaMotionFactorPoint3",
        "BetweenFactorPoint3",
    }
    assert all(isinstance(factors, Factors) for factors in factors_of(segment))
