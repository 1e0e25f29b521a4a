"""The clock of one camera is set while images come one after the other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest

import fgpose
from fgpose.estimation.online.clock_offsets import OffsetEvidence
from fgpose.estimation.online.clock_steps import ClockSteps
from fgpose.people_observations import Detections
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

Estimates = list[fgpose.Estimate]
Image = tuple[int, float, float]
"""Number of its camera, when it was taken, and when it comes."""
AT_S, BY_S = 4.0, 0.3
ELLIPSOID = 7.815  # of 95 %, three degrees of freedom
STEP_FRAME = 40
STEPS_S = [BY_S, *(pytest.param(by_s, marks=pytest.mark.slow) for by_s in (-BY_S, 2.0))]


def images_of(
    rates_hz: Sequence[float], late_s: Sequence[float], jitter_s: float = 0.0, lost_share: float = 0.0
) -> list[Image]:
    """Of eight seconds, those of a camera in their order."""
    rng, images = np.random.default_rng(0), list[Image]()
    for c, (rate_hz, by_s) in enumerate(zip(rates_hz, late_s, strict=True)):
        taken_s = np.arange(0.01 * c, 8.0, 1 / rate_hz)
        taken_s = taken_s[rng.random(len(taken_s)) >= lost_share]
        come_s = np.maximum.accumulate(taken_s + by_s + jitter_s * np.abs(rng.standard_normal(len(taken_s))))
        images += zip([c] * len(taken_s), taken_s.tolist(), come_s.tolist(), strict=True)
    return images


def left_out(images: list[Image], clock_s: Callable[[int, float], float] = lambda c, taken_s: taken_s) -> np.ndarray:
    """How many images of each camera, by the clocks that their stamps are of."""
    n_cameras = 1 + max(c for c, *_ in images)
    steps, n_left_out = ClockSteps([f"cam{c}" for c in range(n_cameras)]), np.zeros(n_cameras, dtype=int)
    for c, taken_s, _ in sorted(images, key=lambda image: image[2]):
        steps = steps.plus(np.where(np.arange(n_cameras) == c, clock_s(c, taken_s), np.nan))
        steps.warn()
        n_left_out[c] += steps.left_out[c]
    return n_left_out


def taken_slowly(images: list[Image], busy_s: float) -> list[Image]:
    """In the order in which a computer takes them that needs so long for each: then the newest two of each camera."""
    arriving, now_s, taken, waiting = sorted(images, key=lambda image: image[2]), 0.0, list[Image](), list[Image]()
    while arriving or waiting:
        if not waiting:
            now_s = max(now_s, arriving[0][2])
            came = [image for image in arriving if image[2] <= now_s]
            arriving = arriving[len(came) :]
            newest = [[image for image in came if image[0] == c][-2:] for c in {image[0] for image in came}]
            waiting = sorted(itertools.chain(*newest), key=lambda image: image[1])
        taken.append(waiting.pop(0))
        now_s += busy_s
    return taken


def set_clocks(cameras: set[int], by_s: float, until_s: float = np.inf) -> Callable[[int, float], float]:
    return lambda c, taken_s: taken_s + by_s * (c in cameras and AT_S <= taken_s < until_s)


def test_the_first_image_after_others_have_gone_on_is_of_no_clock_that_was_set() -> None:
    """A computer that is too slow takes the newest of each camera: together, or one after the other, with gaps. What
    is ahead of the others has been so for no time yet, however far they went on with its last image."""
    steps = ClockSteps([f"cam{c}" for c in range(4)])
    together_s = [np.full(4, frame / 30) for frame in range(20)]
    together_s.append(together_s[-1] + [0.05, 0.11, 0.11, 0.11])
    next_s = together_s[-1].max() + 0.15  # by 0.1 s more ahead than it was, three usual steps
    for taken_s in (*together_s, *(np.where(np.arange(4) == c, next_s, np.nan) for c in range(4))):
        steps = steps.plus(taken_s)
        assert not steps.lasts.any()
    assert not steps.left_out.any()


@pytest.mark.parametrize("by_s", [0.1, 0.3, 2.0, -0.15, -0.3])
def test_images_of_a_clock_that_was_set_are_left_out(by_s: float) -> None:
    with pytest.warns(UserWarning, match=f"camera cam1: its clock was set .* by about {abs(by_s):.2g} s") as told:
        n_left_out = left_out(images_of([30] * 4, [0.0] * 4), set_clocks({1}, by_s))
    assert len(told) == 1
    assert n_left_out.tolist() == [0, 120, 0, 0]


@pytest.mark.parametrize("camera", range(4))
def test_also_where_cameras_have_other_rates_and_delays(camera: int) -> None:
    rates_hz = [30, 15, 60, 20]
    with pytest.warns(UserWarning, match=f"cam{camera}: its clock was set ahead"):
        n_left_out = left_out(images_of(rates_hz, [0.03, 0.05, 0.02, 0.1], 0.02), set_clocks({camera}, BY_S))
    expected = np.zeros(4)
    expected[camera] = 4 * rates_hz[camera]
    np.testing.assert_allclose(n_left_out, expected, atol=1)


def test_a_clock_that_is_right_again_is_used() -> None:
    with pytest.warns(UserWarning, match="cam1"):
        n_left_out = left_out(images_of([30] * 4, [0.0] * 4), set_clocks({1}, BY_S, until_s=6.0))
    np.testing.assert_allclose(n_left_out, [0, 60, 0, 0], atol=1)


def test_of_two_cameras_nobody_can_tell() -> None:
    with pytest.warns(UserWarning, match="of two cameras nobody can tell whose clock is right"):
        n_left_out = left_out(images_of([30] * 2, [0.0] * 2), set_clocks({1}, BY_S))
    assert n_left_out.tolist() == [0, 120]


def test_what_most_clocks_do_is_right() -> None:
    with pytest.warns(UserWarning, match="cam3: its clock was set back by about 0.3 s") as told:
        n_left_out = left_out(images_of([30] * 4, [0.0] * 4), set_clocks({0, 1, 2}, BY_S))
    assert len(told) == 1
    # The first two, until the third has come.
    np.testing.assert_allclose(n_left_out, [1, 1, 0, 120], atol=1)


@pytest.mark.parametrize("by_s", [BY_S, -BY_S, 5.0])
def test_the_clock_of_all_may_be_set(by_s: float) -> None:
    """Nothing is warned of: warnings are errors."""
    assert left_out(images_of([30] * 4, [0.0] * 4), set_clocks({0, 1, 2, 3}, by_s)).max() <= 1


@pytest.mark.parametrize(
    ("rates_hz", "late_s", "jitter_s", "lost_share"),
    [
        ([30, 30, 30, 30], [0.3, 0.0, 0.0, 0.0], 0.0, 0.0),
        ([30, 30, 30, 30], [0.3, 0.0, 0.3, 0.3], 0.0, 0.0),
        ([30, 15, 60, 20], [0.03, 0.05, 0.02, 0.1], 0.05, 0.0),
        ([60, 5], [0.0, 0.1], 0.02, 0.0),
        ([30, 30, 30, 30], [0.0, 0.02, 0.05, 0.1], 0.03, 0.3),
    ],
    ids=["one late", "all but one late", "other rates", "two", "a third lost"],
)
def test_nothing_is_left_out_while_clocks_go_on(
    rates_hz: Sequence[float], late_s: Sequence[float], jitter_s: float, lost_share: float
) -> None:
    """But for some of those that come after a camera and its others have lost three and more at once."""
    images = images_of(rates_hz, late_s, jitter_s, lost_share)
    assert left_out(images).sum() <= 0.02 * lost_share * len(images)


@pytest.mark.parametrize("busy_s", [0.01, 0.05, 0.1])
def test_images_that_wait_are_of_no_clock_that_was_set(busy_s: float) -> None:
    """A computer that is too slow gives those of one camera before those of others that were taken at the same time. By
    when they have arrived it is told, and a clock that was set too."""
    images = images_of([30] * 5, [0.01, 0.05, 0.02, 0.1, 0.2], 0.01)
    set_s, told = set_clocks({1}, BY_S), [set[int](), set[int]()]
    for clock_s, found in zip((lambda c, taken_s: taken_s, set_s), told, strict=True):
        steps = ClockSteps([f"cam{c}" for c in range(5)])
        for c, taken_s, come_s in taken_slowly(images, busy_s):
            is_own = np.arange(5) == c
            steps = steps.plus(np.where(is_own, clock_s(c, taken_s), np.nan), np.where(is_own, come_s, np.nan))
            found |= set(np.flatnonzero(steps.lasts).tolist())
    assert told == [set(), {1}]


def test_most_clocks_may_be_set_by_different_times() -> None:
    """Of two that were set, neither is set by what lies between."""
    steps = ClockSteps(["a", "b", "c"])
    together_s = np.repeat(np.arange(0.0, 1.0, 0.1)[:, None], 3, axis=1)
    for taken_s in (*together_s, [2.0, np.nan, np.nan], [np.nan, 3.0, np.nan]):
        steps = steps.plus(np.array(taken_s))
    np.testing.assert_allclose(steps.by_s, [-1.0, 0.0, -2.1], atol=1e-9)


@pytest.mark.parametrize("late", [{1}, {0, 2, 3}], ids=["one", "all others"])
@pytest.mark.parametrize("until_s", [6.0, np.inf])
def test_images_may_come_late(late: set[int], until_s: float) -> None:
    """From some time on; then those that have waited come at once."""
    images = [
        (c, taken_s, min(come_s + 0.3, until_s) if c in late and AT_S <= taken_s < until_s else come_s)
        for c, taken_s, come_s in images_of([30] * 4, [0.0] * 4)
    ]
    assert not left_out(images).any()


def test_cameras_may_be_away() -> None:
    """One, all but one, and all: of these the first of their new images is not believed before others have come."""
    for away, most in (({1}, 0), ({0, 2, 3}, 0), ({0, 1, 2, 3}, 1)):
        images = [image for image in images_of([30] * 4, [0.0] * 4) if not (image[0] in away and 4 <= image[1] < 5)]
        assert left_out(images).max() <= most


@pytest.mark.parametrize("pause_s", [0.2, 0.4, 1.0])
def test_who_is_late_is_so_after_all_have_paused(pause_s: float) -> None:
    """Its last images before the pause come while there are none of the others, as if it were not late."""
    images = [image for image in images_of([30] * 4, [0.0, 0.12, 0.0, 0.0]) if not 4 <= image[1] < 4 + pause_s]
    assert left_out(images).max() <= 1


@pytest.fixture(scope="module")
def scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Four seconds of somebody who works."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_10.npz")
    truth_m, fps = truth_m[:200:2], fps / 2
    return simulate(truth_m, skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0)


def stamped(scene: Scene, by_s: float) -> np.ndarray:
    """When the images were taken, as their cameras say: the clock of the second is set."""
    seen = scene.observations
    time_s = np.repeat(seen.frame_time_s[:, None], scene.rig.n_cameras, axis=1)
    time_s[STEP_FRAME:, 1] += by_s
    return time_s


def check_claims(estimates: Estimates, scene: Scene) -> None:
    """After the step."""
    after = estimates[STEP_FRAME - len(scene.truth_m) :]
    np.testing.assert_allclose([each.time_s for each in after], scene.observations.frame_time_s[STEP_FRAME:])
    error_m = np.stack([each.positions_m for each in after]) - scene.truth_m[STEP_FRAME:]
    covariance_m2 = np.stack([each.covariance_m2 for each in after if each.covariance_m2 is not None])
    # 20 mm on average with three cameras; with that of the wrong time it was 60 mm and more.
    assert np.linalg.norm(error_m, axis=-1).mean() < 0.03
    squared = np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(covariance_m2), error_m)
    assert np.mean(squared < ELLIPSOID) > 0.9


def one_by_one(scene: Scene, by_s: float, take: Callable[[Detections], Estimates]) -> Estimates:
    """The estimate after all images of each moment; the clock of the second camera is set."""
    seen, estimates, newest = scene.observations, Estimates(), Estimates()
    for points2d_px, confidence, time_s in zip(
        seen.points2d_px, seen.confidence, stamped(scene, by_s).tolist(), strict=True
    ):
        for image in zip(scene.rig.names, time_s, points2d_px[:, None], confidence[:, None], strict=True):
            newest = take(Detections(*image))
        estimates += newest
    return estimates


@pytest.mark.parametrize("by_s", STEPS_S)
def test_an_estimator_is_not_driven_by_one_clock(scene: Scene, by_s: float) -> None:
    """It told the pose of a moment that the other cameras had not seen yet, from one view of another moment."""
    estimator = fgpose.Estimator(scene.rig, scene.observations.skeleton, fgpose.Config(online={"solver": "window"}))

    def take(image: Detections) -> Estimates:
        return [estimator.update_camera(image.camera, image.time_s, image.points2d_px[0], image.confidence[0])]

    with pytest.warns(UserWarning, match=f"camera {scene.rig.names[1]}: its clock was set") as told:
        estimates = one_by_one(scene, by_s, take)
    assert len(told) == 1
    check_claims(estimates, scene)


@pytest.mark.parametrize("by_s", STEPS_S)
def test_nor_is_a_tracker_and_it_says_so(scene: Scene, by_s: float) -> None:
    online, name = {"solver": "window", "estimate_time_offsets": True}, scene.rig.names[1]
    config = fgpose.Config(online=online, tracking={"max_processes": 1})
    tracker = fgpose.Tracker(scene.rig, scene.observations.skeleton, config)
    with pytest.warns(UserWarning, match=f"camera {name}: its clock was set") as told:
        estimates = one_by_one(scene, by_s, lambda image: [each.estimate for each in tracker.update([image])])
    assert len(told) == 1
    check_claims(estimates, scene)
    assert set(tracker.set_clocks) == {name}
    assert {image.camera for image in tracker.used}.isdisjoint({name})
    change_s, sigma_s = tracker.offsets.relative()
    # As well as the order of images tells it, and the prior; those of the others are known as well as before.
    assert abs(change_s[1] + by_s) < 2 * sigma_s[1] < 0.4
    assert (sigma_s[2:] < 0.02).all()


def test_nothing_is_left_of_what_was_told_of_one_offset() -> None:
    """Of the others it is as where that one has no prior."""
    information = np.random.default_rng(0).standard_normal((6, 4))
    information = information.T @ information
    told = OffsetEvidence(information, information @ np.array([0.0, 0.01, -0.02, 0.03]), np.ones((2, 4)))
    without = told.without(1)
    assert not without.information[1].any()
    assert without.moment[1] == pytest.approx(0.0)
    np.testing.assert_array_equal(without.squares, [[1, 0, 1, 1]] * 2)
    kept, prior = [0, 2, 3], 1e4 * np.eye(4)
    expected = np.linalg.inv(information + np.diag([1e4, 0.0, 1e4, 1e4]))[np.ix_(kept, kept)]
    np.testing.assert_allclose(np.linalg.inv(without.information + prior)[np.ix_(kept, kept)], expected, rtol=1e-9)
    offsets_s = np.linalg.solve(without.information[np.ix_(kept, kept)], without.moment[kept])
    np.testing.assert_allclose(offsets_s, [0.0, -0.02, 0.03], atol=1e-9)
