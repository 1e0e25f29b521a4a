from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import gtsam
import numpy as np
import pytest

from fgpose.config import MotionConfig, PriorConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation import frame_factors
from fgpose.estimation.frame_factors import FrameTime
from fgpose.estimation.keys import joint_and_frame, length_key, position_key, velocity_key
from fgpose.estimation.process_noise import initial_density
from fgpose.skeleton import Skeleton

NAN = np.nan
FRAME = 7


def kinds(factors: Iterable[gtsam.NonlinearFactor]) -> Counter[str]:
    return Counter(type(factor).__name__ for factor in factors)


def keys(factor: gtsam.NonlinearFactor) -> tuple[int, ...]:
    return tuple(factor.keys())


@pytest.fixture
def everyone(skeleton: Skeleton) -> np.ndarray:
    return np.ones(skeleton.n_joints, dtype=bool)


def without(everyone: np.ndarray, skeleton: Skeleton, *names: str) -> np.ndarray:
    mask = everyone.copy()
    mask[[skeleton.index(name) for name in names]] = False
    return mask


@pytest.mark.parametrize("make", [position_key, velocity_key])
def test_keys_know_their_joint_and_frame(make):
    for joint, frame in ((0, 0), (16, 0), (0, 1), (255, 3), (132, 1_000_000)):
        assert joint_and_frame(make(joint, frame)) == (joint, frame)


def test_keys_sort_by_kind_then_frame_then_joint():
    ordered = [length_key(0), length_key(16), velocity_key(0, 0), velocity_key(255, 900)]
    ordered += [position_key(0, 0), position_key(1, 0), position_key(255, 0), position_key(0, 1), position_key(3, 70)]
    assert sorted(ordered) == ordered
    assert len(set(ordered)) == len(ordered)


def test_one_projection_factor_per_detection_of_an_active_joint(walking_scene, rig, skeleton, everyone):
    points_px = walking_scene.observations.points2d_px[0].copy()
    points_px[1, 3:6] = NAN
    points_px[2, 4, 0] = NAN
    points_px[:, 9] = NAN
    active = without(everyone, skeleton, "left_wrist", "head")
    factors = list(
        frame_factors.projection_factors(rig, FRAME, points_px, np.ones((4, 17)), active, ProjectionConfig())
    )
    expected = Counter({position_key(joint, FRAME): 4 for joint in range(17) if joint not in (3, 4, 5, 9, 10, 13)})
    expected |= Counter({position_key(3, FRAME): 3, position_key(4, FRAME): 2, position_key(5, FRAME): 3})
    assert Counter(key for factor in factors for key in keys(factor)) == expected
    assert kinds(factors) == {"TriangulationFactorCal3_S2": expected.total()}


def test_the_weight_of_a_detection_is_its_information(walking_scene, rig, everyone):
    points_px = walking_scene.observations.points2d_px[0]
    weights = np.ones((4, 17))
    weights[0], weights[1], weights[2] = 0.25, 0.04, 0.0
    config = ProjectionConfig(sigma_px=6.0, kernel="none", min_weight=0.01)
    values = gtsam.Values()
    values.insert(position_key(0, FRAME), walking_scene.truth_m[0, 0])
    factors = list(frame_factors.projection_factors(rig, FRAME, points_px, weights, everyone, config))[::17]
    squared_px2 = np.sum((rig.project(walking_scene.truth_m[0])[:, 0] - points_px[:, 0]) ** 2, axis=-1)
    sigmas_px = np.sqrt(squared_px2 / np.array([2 * factor.error(values) for factor in factors]))
    # 6 px / sqrt(weight); not more than 6 px / sqrt(0.01)
    np.testing.assert_allclose(sigmas_px, [12.0, 30.0, 60.0, 6.0], rtol=1e-3)


def test_symmetry_factors_need_all_four_joints(skeleton, everyone):
    config = SymmetryConfig(form="frame")
    factors = list(frame_factors.symmetry_factors(skeleton, FRAME, everyone, config))
    assert kinds(factors) == {"CustomFactor": 4}
    names = ["left_shoulder", "left_elbow", "right_shoulder", "right_elbow"]
    assert keys(factors[0]) == tuple(position_key(skeleton.index(name), FRAME) for name in names)
    # the elbow belongs to the upper and the lower arm, the ankle to the lower leg alone
    for missing, left_over in (("right_elbow", 2), ("left_ankle", 3), ("spine", 4)):
        active = without(everyone, skeleton, missing)
        assert len(list(frame_factors.symmetry_factors(skeleton, FRAME, active, config))) == left_over


@pytest.mark.parametrize(
    ("model", "kind", "symbols"),
    [
        ("constant_velocity", "WnoaMotionFactorPoint3", "xvxv"),
        ("random_walk", "BetweenFactorPoint3", "xx"),
    ],
)
def test_motion_factors_join_a_joint_to_itself_one_frame_earlier(model, kind, symbols):
    config = MotionConfig(model=model)
    factors = list(frame_factors.motion_factors(FrameTime(4, 1.0), FrameTime(7, 1.1), [2, 5], np.ones(17), config))
    assert kinds(factors) == {kind: 2}
    for factor, joint in zip(factors, (2, 5), strict=True):
        assert "".join(chr(gtsam.symbolChr(key)) for key in keys(factor)) == symbols
        assert {joint_and_frame(key) for key in keys(factor)} == {(joint, 4), (joint, 7)}


@pytest.mark.parametrize("model", ["constant_velocity", "random_walk"])
def test_the_motion_of_a_burst_of_frames_keeps_within_double_precision(model):
    config = MotionConfig(model=model, adaptive=False, acceleration_density=20.0)
    density = np.array([initial_density(config)])

    def information(step_s: float) -> float:
        (factor,) = frame_factors.motion_factors(FrameTime(0, 1.0), FrameTime(1, 1.0 + step_s), [0], density, config)
        values = gtsam.Values()
        for frame in (0, 1):
            values.insert(position_key(0, frame), np.zeros(3))
            values.insert(velocity_key(0, frame), np.zeros(3))
        A, _ = factor.linearize(values).jacobian()
        return float(np.abs(A.T @ A).max())

    assert information(1e-12) <= 1.01 / frame_factors._FINEST_STEP_M**2
    # A kilohertz is taken as it is: 12 / (q h^3) with 20 m^2/s^3, or 1 / (q h) with 1 m^2/s.
    assert information(1e-3) == pytest.approx(6e8 if model == "constant_velocity" else 1e3, rel=1e-6)


def test_no_motion_model_no_motion_factors():
    config = MotionConfig(model="none")
    assert not list(frame_factors.motion_factors(FrameTime(0, 0.0), FrameTime(1, 0.1), [1, 2], np.ones(3), config))


def fading(
    skeleton: Skeleton, active: np.ndarray, seen: np.ndarray, config: MotionConfig | None = None
) -> list[tuple[str, ...]]:
    """The joints of each fading factor by name, the one that holds first."""
    factors = frame_factors.fading_factors(
        skeleton, FRAME, 0.02, active, seen, np.ones(skeleton.n_joints), config or MotionConfig()
    )
    names = []
    for factor in factors:
        assert all(chr(gtsam.symbolChr(key)) == "v" for key in keys(factor))
        assert all(joint_and_frame(key)[1] == FRAME for key in keys(factor))
        names.append(tuple(skeleton.joints[joint_and_frame(key)[0]] for key in keys(factor)))
    return names


def test_no_velocity_fades_while_everyone_is_seen(skeleton, everyone):
    assert fading(skeleton, everyone, everyone) == []


def test_an_unseen_joint_moves_with_a_seen_neighbour(skeleton, everyone):
    assert fading(skeleton, everyone, without(everyone, skeleton, "left_wrist")) == [("left_elbow", "left_wrist")]
    # both neighbours are seen: the one nearer to the root
    assert fading(skeleton, everyone, without(everyone, skeleton, "left_elbow")) == [("left_shoulder", "left_elbow")]
    # the nearer one is not seen, the farther one is
    unseen = without(everyone, skeleton, "left_shoulder", "thorax", "spine", "neck_base", "right_shoulder")
    assert ("left_elbow", "left_shoulder") in fading(skeleton, everyone, unseen)


def test_a_limb_that_nobody_sees_hangs_on_the_body_joint_by_joint(skeleton, everyone):
    unseen = without(everyone, skeleton, "left_elbow", "left_wrist")
    assert fading(skeleton, everyone, unseen) == [("left_shoulder", "left_elbow"), ("left_elbow", "left_wrist")]


def test_a_person_that_nobody_sees_comes_to_rest(skeleton, everyone):
    pairs = fading(skeleton, everyone, ~everyone)
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


def test_a_joint_whose_neighbours_have_no_variables_comes_to_rest(skeleton, everyone):
    active = without(everyone, skeleton, "left_elbow")
    assert fading(skeleton, active, without(active, skeleton, "left_wrist")) == [("left_wrist",)]


@pytest.mark.parametrize("model", ["random_walk", "none"])
def test_without_velocities_nothing_fades(skeleton, everyone, model):
    assert fading(skeleton, everyone, ~everyone, MotionConfig(model=model)) == []


def test_priors_hold_position_and_velocity_of_the_joints_that_enter():
    positions_m = np.arange(51.0).reshape(17, 3)
    factors = list(frame_factors.prior_factors(FRAME, [3, 8], positions_m, PriorConfig(), with_velocity=True))
    expected = [f(joint, FRAME) for joint in (3, 8) for f in (position_key, velocity_key)]
    assert [keys(factor)[0] for factor in factors] == expected
    values = gtsam.Values()
    for joint in (3, 8):
        values.insert(position_key(joint, FRAME), positions_m[joint])
        values.insert(velocity_key(joint, FRAME), np.zeros(3))
    assert sum(factor.error(values) for factor in factors) == 0.0
    without_velocity = frame_factors.prior_factors(FRAME, [3, 8], positions_m, PriorConfig(), with_velocity=False)
    assert kinds(without_velocity) == {"PriorFactorPoint3": 2}


def test_bones_whose_length_is_not_known_have_no_factor(skeleton, everyone):
    lengths_m = np.full(skeleton.n_lengths, 0.3)
    lengths_m[skeleton.length_of_bone[0]] = NAN
    sigmas_m = np.full(skeleton.n_lengths, 0.01)
    priors = list(frame_factors.length_prior_factors(lengths_m, 0.3))
    assert len(priors) == skeleton.n_lengths - 1
    assert length_key(skeleton.length_of_bone[0]) not in {keys(factor)[0] for factor in priors}
    positions_m = np.random.default_rng(0).normal(size=(skeleton.n_joints, 3))

    def factors(active: np.ndarray) -> list[gtsam.NonlinearFactor]:
        return list(frame_factors.known_length_factors(skeleton, FRAME, active, positions_m, lengths_m, sigmas_m))

    # both hips share the length that is missing
    assert kinds(factors(everyone)) == {"RangeFactor3": len(skeleton.bones) - 2}
    n_factors = len(factors(everyone))
    assert len(factors(without(everyone, skeleton, "left_wrist"))) == n_factors - 1
    # a bone whose joints are at one point has no direction
    positions_m[skeleton.index("left_wrist")] = positions_m[skeleton.index("left_elbow")]
    assert len(factors(everyone)) == n_factors - 1
