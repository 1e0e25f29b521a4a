"""Online estimation: accuracy, what it tolerates, and joints that nobody sees."""

from __future__ import annotations

import copy
import itertools
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import config_from_dict
from fgpose.estimation.keys import position_key
from fgpose.estimation.online.window import _SOLVERS
from fgpose.estimation.online.window_graph import WindowGraph
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, DetectionNoise, Scene, simulate, walking
from tests.conftest import MOCAP

COVERED_99 = 11.34  # 99 % quantile of chi-square with 3 degrees of freedom


@pytest.fixture(autouse=True, params=["isam2", pytest.param("window", marks=pytest.mark.slow)])
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of this holds whatever solves the window."""
    monkeypatch.setitem(_SOLVERS, "isam2", _SOLVERS[request.param])


def run(
    observations: fgpose.Observations, rig: fgpose.CameraRig, config: fgpose.Config | None = None
) -> list[fgpose.Estimate]:
    estimator = fgpose.Estimator(rig, observations.skeleton, config)
    return [estimator.update(frame) for frame in observations]


def errors_m(estimates: list[fgpose.Estimate], truth_m: Float[np.ndarray, "frame joint 3"]) -> np.ndarray:
    return np.array([np.linalg.norm(e.positions_m - truth_m[e.frame], axis=-1) for e in estimates])


def hidden(
    observations: fgpose.Observations,
    frames: slice,
    joints: list[int] | slice,
    cameras: list[int] | slice = slice(None),
) -> fgpose.Observations:
    """The same recording, some joints unseen by some cameras for a while."""
    points2d_px = observations.points2d_px.copy()
    points3d_m = None if observations.points3d_m is None else observations.points3d_m.copy()
    for array in (points2d_px, points3d_m):
        if array is not None:
            view = array[frames]
            if isinstance(joints, slice):
                view[:, cameras] = np.nan
            else:
                for joint in joints:
                    view[:, cameras, joint] = np.nan
    return replace(observations, points2d_px=points2d_px, points3d_m=points3d_m)


@pytest.fixture(scope="module")
def mocap_clear(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Six seconds of real motion (motion capture), noisy, nothing occluded."""
    from fgpose_benchmarks.synthetic import motion_from_npz

    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return simulate(truth_m[:300], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0)


def test_without_noise_the_truth_is_recovered(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m = walking(40, 50.0, skeleton)
    scene = simulate(truth_m, skeleton, rig, 50.0, NO_NOISE, NO_OCCLUSION, seed=0)
    config = config_from_dict({"visibility": {"sigma_m": 0.002}})
    errors = errors_m(run(scene.observations, rig, config), truth_m)
    # What is left is smoothing of exact points with 2 mm of assumed noise.
    assert np.max(errors[5:]) < 2e-3


@pytest.mark.slow
def test_smoothing_beats_each_frame_alone(mocap_scene: Scene, rig: fgpose.CameraRig) -> None:
    observations = mocap_scene.observations.frames(slice(0, 75))
    estimates = run(observations, rig)
    alone = fgpose.refine(observations, rig)
    online_m = np.median(errors_m(estimates[10:], mocap_scene.truth_m))
    lagged = [estimate.smoothed for estimate in estimates if estimate.smoothed is not None]
    lagged_m = np.median(errors_m(lagged, mocap_scene.truth_m))
    alone_m = np.nanmedian(np.linalg.norm(alone.positions_m - mocap_scene.truth_m[:75], axis=-1))
    assert lagged_m < online_m < alone_m


@pytest.mark.slow
def test_an_infinite_lag_agrees_with_the_batch(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """The last frame of the full history is what the batch gives for it, up to what differs by design: bone lengths
    are a running estimate online, the process noise is that of a lag ago, and linearisation points are kept until a
    joint moves by 3 cm."""
    config = config_from_dict(
        {"online": {"lag_s": float("inf")}, "symmetry": {"form": "none"}, "motion": {"adaptive": False}}
    )
    observations = mocap_clear.observations.frames(slice(0, 60))
    online = run(observations, rig, config)[-1]
    batch = fgpose.smooth(observations, rig, config)
    difference_m = np.linalg.norm(online.positions_m - batch.positions_m[-1], axis=-1)
    # 3 mm: a fifth of the error of either (16 mm), left by linearisation points up to 3 cm away.
    assert np.median(difference_m) < 3e-3


@pytest.mark.parametrize(("lag_s", "n_frames"), [(0.001, 1), pytest.param(0.1, 5, marks=pytest.mark.slow), (0.5, 25)])
def test_the_lagged_estimate_is_one_lag_old(
    lag_s: float, n_frames: int, mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    """At 50 Hz; at least one frame."""
    observations = mocap_clear.observations.frames(slice(0, n_frames + 5))
    estimates = run(observations, rig, fgpose.Config(online={"lag_s": lag_s}))
    assert all(estimate.smoothed is None for estimate in estimates[:n_frames])
    for estimate in estimates[n_frames:]:
        assert estimate.smoothed is not None
        assert estimate.frame - estimate.smoothed.frame == n_frames


@pytest.mark.parametrize("jitter_s", [0.0, 0.001])
def test_each_frame_is_smoothed_once_however_even_its_times(
    jitter_s: float, mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    """An update lets none or two frames leave where times are uneven."""
    observations = mocap_clear.observations.frames(slice(0, 40))
    time_s = observations.time_s + jitter_s * np.random.default_rng(0).standard_normal(40)
    estimates = run(replace(observations, time_s=time_s), rig, fgpose.Config(online={"lag_s": 0.2}))
    numbers = [each.frame for estimate in estimates for each in estimate.newly_smoothed]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 29
    assert len({len(estimate.newly_smoothed) for estimate in estimates[11:]}) == (1 if jitter_s == 0 else 3)
    for estimate in estimates:
        if estimate.newly_smoothed:
            assert estimate.smoothed is estimate.newly_smoothed[-1]


def nees(estimates: list[fgpose.Estimate], truth_m: np.ndarray) -> Float[np.ndarray, "frame joint"]:
    """Squared error in standard deviations: 3 on average where the covariance is right."""
    squared = []
    for estimate in estimates:
        assert estimate.covariance_m2 is not None
        error = estimate.positions_m - truth_m[estimate.frame]
        squared.append(np.einsum("ji,jik,jk->j", error, np.linalg.inv(estimate.covariance_m2), error))
    return np.array(squared)


@pytest.mark.slow
def test_covariance_covers_the_error(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    config = fgpose.Config(online={"smoothed_covariance": True})
    estimates = run(mocap_clear.observations.frames(slice(0, 150)), rig, config)[20:]
    smoothed = [estimate.smoothed for estimate in estimates if estimate.smoothed is not None]
    for squared in (nees(estimates, mocap_clear.truth_m), nees(smoothed, mocap_clear.truth_m)):
        # Errors of detections are correlated over 0.15 s: one independent error of each joint in 0.3 s. Chi-square with
        # 3 degrees of freedom has the variance 6. In so short a time the roughness of motion is known to a fifth, which
        # is a tenth of the variance, and the spread to a twentieth, another tenth. Sigmas that are wrong by a quarter
        # leave the band of three deviations.
        n_independent = squared.size / (0.3 * 50.0)
        assert np.mean(squared) == pytest.approx(3.0, abs=3 * np.sqrt(6 / n_independent + 2 * 0.1**2))
        assert np.mean(squared < COVERED_99) > 0.95


@pytest.mark.parametrize("solver", ["isam2"], indirect=True)
@pytest.mark.parametrize("lag_s", [pytest.param(0.001, marks=pytest.mark.slow), 0.1])
def test_the_lagged_covariance_is_the_marginal_of_the_window(
    lag_s: float, mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    """What GTSAM's Bayes tree gives for the same variables, before it is widened."""
    observations = mocap_clear.observations.frames(slice(0, 20))
    estimator = fgpose.Estimator(rig, observations.skeleton, fgpose.Config(online={"lag_s": lag_s}))
    estimates = [estimator.update(frame) for frame in observations]
    assert estimates[-1].smoothed is not None
    keys = [position_key(joint, estimates[-1].smoothed.frame) for joint in range(17)]
    assert isinstance(estimator._body._window._solver, WindowGraph)
    smoother = estimator._body._window._solver._smoother
    # Rounding of an inverse whose condition number is about 1e6.
    np.testing.assert_allclose(smoother.oldest_covariances(keys), smoother.covariances(keys), rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_a_frame_is_known_better_one_lag_later(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """A wrist that is unseen for 0.2 s is seen again within the lag: what is known of it then is a multiple."""
    wrist = mocap_clear.observations.skeleton.index("left_wrist")
    observations = hidden(mocap_clear.observations.frames(slice(0, 80)), slice(40, 50), [wrist])
    estimates = run(observations, rig, fgpose.Config(online={"smoothed_covariance": True}))
    smoothed = {estimate.smoothed.frame: estimate.smoothed for estimate in estimates if estimate.smoothed is not None}
    variance_m2 = {}
    for name, estimate in (("newest", estimates[47]), ("smoothed", smoothed[47])):
        assert estimate.covariance_m2 is not None
        variance_m2[name] = np.trace(estimate.covariance_m2[wrist])
    assert variance_m2["smoothed"] < variance_m2["newest"] / 4


@pytest.mark.slow
def test_unseen_limbs_stay_attached_and_snap_back(
    mocap_clear: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """A hand, an arm and a leg, two seconds unseen: at most 1.2 bone lengths from the parent, covered, and back within
    three frames."""
    unseen = ("right_wrist", "left_elbow", "left_wrist", "right_knee", "right_ankle")
    joints = [skeleton.index(name) for name in unseen]
    start, stop = 120, 220
    observations = hidden(mocap_clear.observations.frames(slice(0, stop + 6)), slice(start, stop), joints)
    estimates = run(observations, rig)
    truth_m = mocap_clear.truth_m
    errors = errors_m(estimates, truth_m)
    for joint in joints:
        parent = next(a for a, b in skeleton.bones if b == joint)
        length_m = np.linalg.norm(truth_m[0, joint] - truth_m[0, parent])
        apart_m = [np.linalg.norm(e.positions_m[joint] - e.positions_m[parent]) for e in estimates[start:stop]]
        assert np.max(apart_m) <= 1.2 * length_m
        covered = []
        for estimate in estimates[start:stop]:
            assert estimate.status[joint] == fgpose.Status.PREDICTED
            assert estimate.covariance_m2 is not None
            error = estimate.positions_m[joint] - truth_m[estimate.frame, joint]
            covered.append(error @ np.linalg.solve(estimate.covariance_m2[joint], error) < COVERED_99)
        assert np.mean(covered) >= 0.9
        # Back means: within three times its usual error, from the third frame on.
        usual_m = np.median(errors[50:start, joint])
        assert np.all(errors[stop + 2 : stop + 6, joint] < 3 * usual_m)


@pytest.mark.slow
def test_unseen_for_too_long_is_given_up_and_found_again(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    config = config_from_dict({"motion": {"max_unseen_s": 0.4}})
    estimates = run(hidden(mocap_clear.observations.frames(slice(0, 55)), slice(10, 40), slice(None)), rig, config)
    assert (estimates[20].status == fgpose.Status.PREDICTED).all()
    assert (estimates[35].status == fgpose.Status.UNOBSERVABLE).all()
    assert np.isnan(estimates[35].positions_m).all()
    assert (estimates[40].status == fgpose.Status.OBSERVED).all()
    assert np.median(errors_m(estimates[42:], mocap_clear.truth_m)) < 0.04


def test_a_joint_that_runs_away_enters_anew(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """Frames within microseconds may leave it with any velocity: it must not carry the graph beyond the numbers."""
    observations = hidden(mocap_clear.observations.frames(slice(0, 16)), slice(10, 11), [7])
    estimator = fgpose.Estimator(rig, observations.skeleton)
    for frame in observations.frames(slice(0, 10)):
        estimator.update(frame)
    newest = estimator._body._window[-1]
    velocities_mps = newest.velocities_mps.copy()
    velocities_mps[7] = 1e5
    estimator._body._window[-1] = replace(newest, velocities_mps=velocities_mps)
    estimates = [estimator.update(frame) for frame in observations.frames(slice(10, 16))]
    assert estimates[0].status[7] == fgpose.Status.UNOBSERVABLE
    assert np.isnan(estimates[0].positions_m[7]).all()
    assert np.median(errors_m(estimates, mocap_clear.truth_m)[1:, 7]) < 0.04
    assert estimator.repairs == 0


@pytest.mark.slow
def test_what_is_done_between_updates_is_done_as_well(mocap_scene: Scene, rig: fgpose.CameraRig) -> None:
    observations = mocap_scene.observations.frames(slice(0, 75))
    estimator = fgpose.Estimator(rig, observations.skeleton)
    tidied = []
    for frame in observations:
        estimator.tidy()
        tidied.append(estimator.update(frame))
        estimator.tidy()
        estimator.tidy()
    at_once = run(observations, rig)
    errors = [errors_m(each, mocap_scene.truth_m).mean() for each in (tidied, at_once)]
    # Frames are revised one update sooner, which tells little.
    assert errors[0] == pytest.approx(errors[1], rel=0.01)
    assert not np.array_equal(tidied[-1].positions_m, at_once[-1].positions_m)


@pytest.mark.slow
def test_any_subset_of_cameras(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """A camera that is lost for good, then another: frames name the cameras they have."""
    estimator = fgpose.Estimator(rig, mocap_clear.observations.skeleton)
    kept = [rig.names, rig.names[:3], (rig.names[2], rig.names[0])]
    estimates = []
    for number, frame in enumerate(mocap_clear.observations.frames(slice(0, 45))):
        estimates.append(estimator.update(frame.subset(list(kept[number // 15]))))
    assert np.median(errors_m(estimates[30:], mocap_clear.truth_m)) < 0.05
    assert estimates[-1].residual_px is not None
    assert np.isnan(estimates[-1].residual_px[1]).all()
    assert (estimates[-1].status == fgpose.Status.OBSERVED).all()


@pytest.mark.slow
def test_a_gap_in_time(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    estimator = fgpose.Estimator(rig, mocap_clear.observations.skeleton)
    numbers = [*range(20), *range(70, 90)]
    estimates = [estimator.update(mocap_clear.observations.frames(slice(n, n + 1))) for n in numbers]
    errors = [
        np.linalg.norm(e.positions_m - mocap_clear.truth_m[n], axis=-1) for e, n in zip(estimates, numbers, strict=True)
    ]
    assert np.median(errors[22:]) < 0.04


@pytest.mark.slow
def test_a_burst_of_frames(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """Frames that were held up and come within a microsecond of each other."""
    clear = mocap_clear.observations.frames(slice(0, 40))
    time_s = np.array(clear.time_s)
    time_s[20:25] = time_s[24] + 1e-6 * np.arange(-4, 1)
    estimator = fgpose.Estimator(rig, clear.skeleton)
    estimates = [estimator.update(frame) for frame in replace(clear, time_s=time_s)]
    assert np.median(errors_m(estimates, mocap_clear.truth_m)) < 0.04


@pytest.mark.parametrize("step", [0, -1])
def test_a_repeated_or_older_frame_is_refused_and_changes_nothing(
    step: int, mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    frames = list(mocap_clear.observations.frames(slice(0, 12)))
    estimator, other = (fgpose.Estimator(rig, mocap_clear.observations.skeleton) for _ in range(2))
    for frame in frames[:11]:
        estimator.update(frame)
        other.update(frame)
    with pytest.raises(ValueError, match="time must increase"):
        estimator.update(frames[10 + step])
    np.testing.assert_array_equal(estimator.update(frames[11]).positions_m, other.update(frames[11]).positions_m)


def test_nobody_in_sight_from_the_start(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    estimates = run(hidden(mocap_clear.observations.frames(slice(0, 20)), slice(0, 10), slice(None)), rig)
    assert np.isnan(estimates[9].positions_m).all()
    assert (estimates[9].status == fgpose.Status.UNOBSERVABLE).all()
    assert (estimates[10].status == fgpose.Status.OBSERVED).all()


# Each frame by itself: no motion and nothing of the frames before.
EACH_FRAME_ALONE = {
    "motion": {"model": "none"},
    "symmetry": {"form": "none"},
    "visibility": {"model": "none"},
    "online": {"relinearize_m": 1e-4},
    "solver": {"step_tolerance_m": 1e-6},
}


@pytest.mark.parametrize(
    "changes",
    [
        {"symmetry": {"form": "frame"}},
        {"projection": {"weighting": "uniform"}},
        pytest.param({"projection": {"weighting": "confidence"}}, marks=pytest.mark.slow),
        {"projection": {"kernel": "none"}},
        {"depth": {"use": "always"}},
    ],
    ids=str,
)
def test_each_frame_alone_is_what_the_batch_makes_of_it(
    changes: dict[str, dict], mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    """With every setting, and not what another setting gives."""
    observations, alone = mocap_clear.observations.frames(slice(0, 12)), config_from_dict(EACH_FRAME_ALONE)
    sections = {**EACH_FRAME_ALONE, **changes}
    changed = config_from_dict({name: {**EACH_FRAME_ALONE.get(name, {}), **sections[name]} for name in sections})
    online_m = np.array([estimate.positions_m for estimate in run(observations, rig, changed)])

    def median_m(config: fgpose.Config) -> float:
        batch_m = fgpose.smooth(observations, rig, config).positions_m
        return float(np.median(np.linalg.norm(online_m - batch_m, axis=-1)))

    # The changes move the joints by 0.9 to 3 mm; one update an image leaves a fifth of the optimum's 3 mm at most.
    assert median_m(changed) < min(0.7e-3, 0.6 * median_m(alone))


@pytest.mark.slow
def test_how_an_unseen_joint_moves_is_up_to_the_model(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """A fist at punching speed, 0.12 s unseen: carried on, held, or not there."""
    wrist = mocap_clear.observations.skeleton.index("left_wrist")
    observations = hidden(mocap_clear.observations.frames(slice(0, 36)), slice(30, 36), [wrist])
    last = {}
    for model in ("constant_velocity", "random_walk", "none"):
        last[model] = run(observations, rig, config_from_dict({"motion": {"model": model}}))[-1]
    error_m = {model: errors_m([estimate], mocap_clear.truth_m)[0, wrist] for model, estimate in last.items()}
    assert error_m["constant_velocity"] < error_m["random_walk"] / 2
    assert last["none"].status[wrist] == fgpose.Status.UNOBSERVABLE
    assert np.isnan(error_m["none"])


def test_bad_frames_are_refused(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    observations = mocap_clear.observations
    estimator = fgpose.Estimator(rig, observations.skeleton)
    with pytest.raises(ValueError, match="one frame at a time"):
        estimator.update(observations.frames(slice(0, 2)))
    with pytest.raises(ValueError, match="skeleton"):
        fgpose.Estimator(rig, load_skeleton("coco_17")).update(observations.frames(slice(0, 1)))
    stranger = replace(observations.frames(slice(0, 1)), camera_names=("a", "b", "c", "d"))
    with pytest.raises(ValueError, match="lacks camera a, b, c, d"):
        estimator.update(stranger)


def test_images_that_are_far_apart_by_the_rig_are_warned_of(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    with pytest.warns(UserWarning, match=r"takes images 0\.2 s later .*on_common_clock"):
        fgpose.Estimator(rig.with_time_offsets(np.array([0.0, 0.1, -0.1, 0.0])), skeleton)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fgpose.Estimator(rig.with_time_offsets(np.array([1.0, 1.05, 1.0, 1.0])), skeleton)


@pytest.mark.slow
def test_learned_time_offsets_leave_the_given_rig_alone(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m, offsets_s = walking(150, 50.0, skeleton), np.array([0.0, 0.03, -0.02, 0.01])
    late = simulate(truth_m, skeleton, rig, 50.0, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=offsets_s)
    estimator = fgpose.Estimator(rig, skeleton, fgpose.Config(online={"estimate_time_offsets": True}))
    for frame in late.observations:
        estimator.update(frame)
    assert estimator.rig is rig
    np.testing.assert_array_equal(rig.time_offsets_s, 0.0)
    # A third of a frame: what three seconds of a walk with correlated errors of 5 px allow.
    np.testing.assert_allclose(estimator.rig_with_offsets.time_offsets_s, offsets_s, atol=0.007)


def test_it_says_why_it_cannot_be_saved(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    with pytest.raises(TypeError, match=r'cannot be saved.*online\.solver = "window"'):
        copy.deepcopy(fgpose.Estimator(rig, skeleton))


@pytest.mark.parametrize("with_3d", [True, False])
def test_one_camera(with_3d: bool, mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """One ray does not determine a joint: with per-view 3D the result is a prediction, without it is nothing."""
    names = list(rig.names[:1])
    observations = mocap_clear.observations.frames(slice(0, 40)).subset(names)
    if not with_3d:
        observations = replace(observations, points3d_m=None)
    last = run(observations, rig.subset(names))[-1]
    expected = fgpose.Status.PREDICTED if with_3d else fgpose.Status.UNOBSERVABLE
    assert (last.status == expected).all()
    assert np.isfinite(last.positions_m).all() == with_3d
    if with_3d:
        assert np.median(errors_m([last], mocap_clear.truth_m)) < 0.4  # one view's depth is off by 0.15 m (SD) or more


@pytest.mark.slow
def test_two_cameras(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    names = list(rig.names[:2])
    estimates = run(mocap_clear.observations.frames(slice(0, 60)).subset(names), rig.subset(names))
    assert np.median(errors_m(estimates[10:], mocap_clear.truth_m)) < 0.04


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.1, 1.0])
def test_unseen_for_longer_than_the_lag(lag_s: float, mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """The whole body, on both sides of the time after which it is given up."""
    config = config_from_dict({"online": {"lag_s": lag_s}, "motion": {"max_unseen_s": 0.5}})
    observations = hidden(mocap_clear.observations.frames(slice(0, 100)), slice(30, 85), slice(None))
    estimates = run(observations, rig, config)
    assert (estimates[50].status == fgpose.Status.PREDICTED).all()
    assert (estimates[80].status == fgpose.Status.UNOBSERVABLE).all()
    assert np.median(errors_m(estimates[88:], mocap_clear.truth_m)) < 0.04


@pytest.mark.slow
def test_a_kernel_limits_the_pull_of_a_wrong_detection(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """One view of a wrist is 150 px off for six frames: how far it pulls, against the wrist without that view."""
    wrist, wrong = mocap_clear.observations.skeleton.index("left_wrist"), slice(6, 12)
    clear = replace(mocap_clear.observations.frames(slice(0, 12)), points3d_m=None, covariance3d_m2=None)
    points2d_px = clear.points2d_px.copy()
    points2d_px[wrong, 0, wrist, 0] += 150.0
    pulled_m = []
    for kernel in ("none", "huber", "cauchy", "geman_mcclure", "tukey"):
        projection = {"kernel": kernel, "weighting": "uniform"}
        config = config_from_dict(
            {"projection": projection, "visibility": {"model": "none"}, "online": {"covariance": False}}
        )
        with_it = run(replace(clear, points2d_px=points2d_px), rig, config)[-1]
        without = run(hidden(clear, wrong, [wrist], [0]), rig, config)[-1]
        pulled_m.append(np.linalg.norm(with_it.positions_m[wrist] - without.positions_m[wrist]))
    # Least squares: a quarter of 60 cm in the end. The influence of the others is as 1, 1 / r, 1 / r^3, and nothing.
    assert pulled_m[0] > 0.05
    for weaker_m, stronger_m in itertools.pairwise(pulled_m):
        assert stronger_m < weaker_m / 3
    assert pulled_m[-1] < 1e-3


@pytest.mark.slow
def test_a_new_estimator_settles_within_a_second(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """What to do instead of saving one: feed the last second to a new one."""
    old = run(mocap_clear.observations.frames(slice(0, 150)), rig)[-1]
    new = run(mocap_clear.observations.frames(slice(100, 150)), rig)[-1]
    # 6 mm: a third of the error of either; what differs is how well the bone lengths are known.
    assert np.median(np.linalg.norm(new.positions_m - old.positions_m, axis=-1)) < 6e-3


@pytest.mark.slow
def test_somebody_whose_bones_are_known_is_right_sooner(mocap_scene: Scene, rig: fgpose.CameraRig) -> None:
    """Two occluded cameras; the lengths are those that an estimator before has learned."""
    rig = rig.subset(rig.names[:2])
    two = mocap_scene.observations.subset(rig.names)
    before = run(two, rig)[-1].bone_lengths
    assert before is not None
    estimators = [fgpose.Estimator(rig, two.skeleton) for _ in range(2)]
    estimators[1].know(before)
    vague, known = ([each.update(frame) for frame in two.frames(slice(0, 25))] for each in estimators)
    errors = [np.nanmean(errors_m(each, mocap_scene.truth_m)) for each in (vague, known)]
    assert errors[1] < 0.9 * errors[0]
    assert known[0].bone_lengths is not None
    np.testing.assert_array_equal(known[0].bone_lengths.lengths_m, before.lengths_m)
    with pytest.raises(ValueError, match="10 bone lengths are needed"):
        estimators[1].know(fgpose.BoneLengths(np.ones(3), np.ones(3)))


def test_a_person_behind_a_camera_that_sees_something(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """A prediction behind the cameras is never better than what they triangulate, however long the gap before it."""
    truth_m = walking(10, 50.0, skeleton)
    projected = fgpose.Observations(skeleton, np.r_[0:5, 300:305] / 50, rig.project(truth_m), camera_names=rig.names)
    estimator = fgpose.Estimator(rig, skeleton, config_from_dict({"motion": {"max_unseen_s": 10.0, "fade_s": 5.0}}))
    fast = truth_m + np.arange(10)[:, None, None] * [0.2, 0.0, 0.0]  # 10 m/s for five frames, then gone for 6 s
    moving = replace(projected, points2d_px=np.concatenate([rig.project(fast[:5]), rig.project(truth_m[5:])]))
    estimates = [estimator.update(frame) for frame in moving]
    assert np.max(np.linalg.norm(estimates[5].positions_m - truth_m[5], axis=-1)) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("joints", [("left_elbow", "left_wrist"), ("left_hip", "right_hip", "pelvis", "head")], ids=str)
def test_joints_at_one_pixel_in_every_view(joints: tuple[str, ...], mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    """A bone without a length has no direction either; from the start, later, and in the frame where it begins."""
    observations = mocap_clear.observations.frames(slice(0, 60))
    numbers = [observations.skeleton.index(joint) for joint in joints]
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    for frames in (slice(0, 5), slice(30, 45)):
        for number in numbers:
            points2d_px[frames, :, number] = points2d_px[frames, :, numbers[0]]
            confidence[frames, :, number] = confidence[frames, :, numbers[0]]
    at_one = replace(observations, points2d_px=points2d_px, confidence=confidence, points3d_m=None)
    estimator = fgpose.Estimator(rig, observations.skeleton)
    estimates = [estimator.update(frame) for frame in at_one]
    assert estimator.repairs == 0
    assert all(np.isfinite(estimate.positions_m).all() for estimate in estimates)
    others = np.delete(errors_m(estimates, mocap_clear.truth_m), numbers, axis=1)
    assert np.median(others[10:]) < 0.03, "the rest of the body: 17 mm, and what pulls at it"
    assert np.median(errors_m(estimates[52:], mocap_clear.truth_m)) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("jump_s", "max_unseen_s"),
    [(jump_s, max_s) for max_s in (3.0, 1e7) for jump_s in (1.0, 10.0, 3600.0, 1e6)],
)
def test_a_clock_that_jumps_forward(
    jump_s: float, max_unseen_s: float, mocap_clear: Scene, rig: fgpose.CameraRig
) -> None:
    clear = mocap_clear.observations.frames(slice(0, 50))
    time_s = np.array(clear.time_s)
    time_s[25:] += jump_s
    config = config_from_dict({"motion": {"max_unseen_s": max_unseen_s}})
    estimator = fgpose.Estimator(rig, clear.skeleton, config, times_are_checked=True)
    estimates = [estimator.update(frame) for frame in replace(clear, time_s=time_s)]
    assert estimator.repairs == 0
    # As after the start: 17 mm, and a little more where nothing before helps.
    assert np.median(errors_m(estimates[25:], mocap_clear.truth_m)) < 0.025


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the images of a camera follow each other by")
def test_frames_within_microseconds_for_long(mocap_clear: Scene, rig: fgpose.CameraRig) -> None:
    clear = mocap_clear.observations.frames(slice(0, 50))
    estimator = fgpose.Estimator(rig, clear.skeleton)
    still = replace(clear, points2d_px=np.repeat(clear.points2d_px[:1], 50, axis=0), points3d_m=None)
    for frame in replace(still, time_s=1.7e9 + 1e-6 * np.arange(50)):
        estimate = estimator.update(frame)
        assert estimate.covariance_m2 is not None
        assert (np.linalg.eigvalsh(estimate.covariance_m2) > 0).all()
        assert np.max(errors_m([replace(estimate, frame=0)], mocap_clear.truth_m)) < 0.1
    assert estimator.repairs == 0


_LIVE = """
import sys
import numpy as np
import fgpose
from fgpose.io.skeletons import load_skeleton

skeleton, K = load_skeleton("h36m_17"), np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
views = [("a", [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0, -4, 1]), ("b", [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], [4, 0, 1])]
rig = fgpose.CameraRig(tuple(
    fgpose.Camera.from_world_to_camera(name, (1000, 1000), K, np.array(R, float), -np.array(R, float) @ position_m)
    for name, R, position_m in views
))
points_m = 0.4 * np.random.default_rng(0).normal(size=(17, 3)) + [0, 0, 1]
estimator = fgpose.Estimator(rig, skeleton, fgpose.Config(online={"lag_s": 0.1, "smoothed_covariance": True}))
before = set(sys.modules)
for frame in range(30):
    estimate = estimator.update_arrays(frame / 50, rig.project(points_m))
print(estimate.smoothed is not None and estimate.smoothed.covariance_m2 is not None)
print(*sorted({name.partition(".")[0] for name in set(sys.modules) - before}))
"""


@pytest.mark.slow
def test_no_update_stops_to_import_what_only_the_batch_needs() -> None:
    """To import scipy.linalg takes 0.2 s: bone lengths and lagged covariances need it or its BLAS."""
    live = subprocess.run([sys.executable, "-c", _LIVE], capture_output=True, text=True, check=True)
    assert live.stdout.split() == ["True"]
