"""Observations: what is missing is NaN with confidence 0, and every bad input is one error that says where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

FRAMES, CAMERAS, JOINTS = 6, 3, 17
NAMES = ("front", "left", "right")
# Frame, camera left, joint left_knee: where the tests put what is wrong.
SPOT = (2, 1, 5)
WHERE = "camera left, joint left_knee, frame 2"


@pytest.fixture
def parts(skeleton: Skeleton) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "skeleton": skeleton,
        "time_s": np.arange(FRAMES) / 50,
        "points2d_px": rng.uniform(0, 1000, (FRAMES, CAMERAS, JOINTS, 2)),
        "confidence": rng.uniform(0.1, 1, (FRAMES, CAMERAS, JOINTS)),
        "points3d_m": rng.uniform(-2, 2, (FRAMES, CAMERAS, JOINTS, 3)),
        "covariance3d_m2": np.tile(np.diag([0.02, 0.03, 0.15]) ** 2, (FRAMES, CAMERAS, JOINTS, 1, 1)),
        "camera_names": NAMES,
    }


def test_good_input_is_kept(parts: dict[str, Any]) -> None:
    observations = Observations(**parts)
    for name in ("time_s", "points2d_px", "confidence", "points3d_m", "covariance3d_m2"):
        np.testing.assert_array_equal(getattr(observations, name), parts[name])
    assert (observations.n_frames, observations.n_cameras) == (FRAMES, CAMERAS)
    assert observations.seen.all()


def test_input_is_copied_and_frozen(parts: dict[str, Any]) -> None:
    observations = Observations(**parts)
    before = observations.points2d_px.copy()
    parts["points2d_px"][:] = 0
    np.testing.assert_array_equal(observations.points2d_px, before)
    for name in ("time_s", "points2d_px", "confidence", "points3d_m", "covariance3d_m2"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(observations, name)[0] = 0


def test_a_missing_point_has_no_confidence(parts: dict[str, Any]) -> None:
    parts["points2d_px"][SPOT][0] = np.nan
    observations = Observations(**parts)
    assert observations.confidence[SPOT] == 0
    assert np.isnan(observations.points2d_px[SPOT]).all()
    assert (~observations.seen).sum() == 1


def test_complex_numbers_are_refused(parts: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="complex"):
        Observations(**parts | {"points2d_px": parts["points2d_px"] + 1j})


def test_a_point_without_confidence_is_missing(parts: dict[str, Any]) -> None:
    parts["confidence"][SPOT] = 0
    observations = Observations(**parts)
    assert np.isnan(observations.points2d_px[SPOT]).all()
    np.testing.assert_array_equal(observations.seen, observations.confidence > 0)


def test_the_confidence_of_a_missing_point_is_not_looked_at(parts: dict[str, Any]) -> None:
    parts["points2d_px"][SPOT] = np.nan
    parts["confidence"][SPOT] = np.nan
    assert Observations(**parts).confidence[SPOT] == 0


def test_without_confidence_every_known_point_counts_one(parts: dict[str, Any]) -> None:
    del parts["confidence"]
    parts["points2d_px"][SPOT] = np.nan
    observations = Observations(**parts)
    np.testing.assert_array_equal(observations.confidence, observations.seen.astype(float))


def test_half_a_3d_point_is_missing(parts: dict[str, Any]) -> None:
    parts["points3d_m"][SPOT][2] = np.nan
    points3d_m = Observations(**parts).points3d_m
    assert points3d_m is not None
    assert np.isnan(points3d_m[SPOT]).all()


def test_nothing_seen_at_all_is_expected_trouble(parts: dict[str, Any]) -> None:
    parts["points2d_px"][:] = np.nan
    parts["points3d_m"][:] = np.nan
    assert not Observations(**parts).seen.any()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("points2d_px", np.inf, f"points2d_px is infinite at {WHERE}"),
        ("points2d_px", -1e200, f"points2d_px is infinite at {WHERE}"),
        ("points3d_m", 1e300, f"points3d_m is infinite at {WHERE}"),
        ("points3d_m", -np.inf, f"points3d_m is infinite at {WHERE}"),
        ("confidence", 1.5, rf"confidence 1.5 is outside \[0, 1\] at {WHERE}"),
        ("confidence", -0.1, rf"confidence -0.1 is outside \[0, 1\] at {WHERE}"),
        ("confidence", np.nan, rf"confidence nan is outside \[0, 1\] at {WHERE}: give 0, or no pixels, for"),
        ("confidence", 87.0, rf"confidence 87 is outside \[0, 1\] at {WHERE}: divide by 100\?"),
        ("confidence", np.inf, rf"confidence inf is outside \[0, 1\] at {WHERE}"),
    ],
)
def test_a_bad_number_is_named_by_its_place(parts: dict[str, Any], name: str, value: float, message: str) -> None:
    parts[name][SPOT] = value
    with pytest.raises(ValueError, match=message):
        Observations(**parts)


def empty(*shape: int) -> np.ndarray:
    return np.zeros(shape)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points2d_px": empty(6, 3, 17)}, r"points2d_px must be \(frames, cameras, joints, 2\)"),
        ({"points2d_px": empty(6, 3, 17, 3)}, r"points2d_px must be \(frames, cameras, joints, 2\)"),
        ({"points2d_px": empty(0, 3, 17, 2)}, "at least one frame and one camera, got 0 and 3"),
        ({"points2d_px": empty(6, 0, 17, 2)}, "at least one frame and one camera, got 6 and 0"),
        ({"points2d_px": empty(6, 3, 16, 2)}, "points2d_px has 16 joints, skeleton h36m_17 has 17"),
        ({"confidence": empty(6, 3, 16)}, r"confidence must have the shape \(6, 3, 17\)"),
        ({"points3d_m": empty(6, 3, 17, 2)}, r"points3d_m must be \(6, 3, 17, 3\)"),
        ({"points3d_m": 2000 * np.ones((6, 3, 17, 3))}, "median coordinate of 2000 m: these look like millimetres"),
        ({"time_s": np.arange(5.0)}, r"time_s must be \(6,\) or \(6, 3\), got \(5,\)"),
        ({"time_s": np.array([0, 1, 2, 2, 4, 5.0])}, "time_s must increase: frame 3 is at 2 s, the one before at 2 s"),
        ({"time_s": np.array([0, 1, np.nan, 3, 4, 5])}, "time_s is not finite at frame 2"),
        ({"time_s": np.array([0, 1, 2, 3, 4, np.inf])}, "time_s is not finite at frame 5"),
        ({"camera_names": ("front", "left")}, "3 different camera names are needed, got front, left"),
        ({"camera_names": ("front", "left", "left")}, "3 different camera names are needed"),
    ],
)
def test_a_bad_recording_is_one_clear_error(parts: dict[str, Any], change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Observations(**(parts | change))


def test_cameras_may_have_their_own_clocks(parts: dict[str, Any]) -> None:
    parts["time_s"] = parts["time_s"][:, None] + np.array([0.0, 0.003, 0.006])
    parts["time_s"][1, 2] = np.nan
    observations = Observations(**parts)
    # Means of three numbers, the one with a gap of two; exact up to rounding.
    np.testing.assert_allclose(observations.frame_time_s[:2], [0.003, 0.0215], atol=1e-12)
    parts["time_s"][3] = np.nan
    with pytest.raises(ValueError, match="not finite at frame 3"):
        Observations(**parts)
    parts["time_s"][3] = (0.06, np.inf, 0.06)
    with pytest.raises(ValueError, match="not finite at frame 3"):
        Observations(**parts)


@pytest.mark.parametrize(
    ("wrong_s", "message"),
    [
        (
            (0.0, 0.033, 0.066, 0.05, 0.133, 0.166),
            "camera left must increase: frame 3 is at 0.05 s, its image before at",
        ),
        ((0.0, 0.0, 0.1, 0.1, 0.1, 0.2), "camera left must increase: frame 1 is at 0 s, its image before at 0 s"),
        ((0.0, 0.033, np.nan, 0.02, 0.133, 0.166), "camera left must increase: frame 3"),
        (1e5 + np.arange(6) / 30, r"camera left is 100000"),
        ((0.0, 0.033, 0.066, 3600.0, 0.133, 0.166), "camera left is 3600 s at frame 3, far from those"),
    ],
)
def test_a_wrong_clock_of_a_camera_is_named(parts: dict[str, Any], wrong_s: Sequence[float], message: str) -> None:
    parts["time_s"] = np.tile(np.arange(6)[:, None] / 30, (1, CAMERAS))
    parts["time_s"][:, 1] = wrong_s
    with pytest.raises(ValueError, match=message):
        Observations(**parts)


def test_one_camera_of_a_recording_keeps_its_clock() -> None:
    """Also where a frame lacks its image: at the time of that frame it would be before the one before."""
    late_s = np.array([0.0, 0.0, 0.09])
    time_s = np.arange(6)[:, None] / 30 + late_s
    time_s[3, 2] = np.nan
    nothing_px = np.full((6, 3, 17, 2), np.nan)
    of_frames = Observations(
        load_skeleton("h36m_17"), time_s, nothing_px, np.zeros((6, 3, 17)), camera_names=tuple("abc")
    )
    one = of_frames.subset(("c",))
    assert (np.diff(one.frame_time_s) > 0).all()
    with_image = [0, 1, 2, 4, 5]
    np.testing.assert_allclose(one.frame_time_s[with_image], time_s[with_image, 2], atol=1e-12)


def test_some_frames_are_a_recording_of_their_own(parts: dict[str, Any]) -> None:
    some = Observations(**parts).frames(slice(2, 4))
    assert some.n_frames == 2
    np.testing.assert_array_equal(some.points2d_px, parts["points2d_px"][2:4])
    np.testing.assert_array_equal(some.time_s, parts["time_s"][2:4])
    again = Observations(**parts)[2:4]
    assert len(again) == 2
    np.testing.assert_array_equal(again.points2d_px, some.points2d_px)
    wrong: Any = 2
    with pytest.raises(TypeError, match=r"frames are taken as a slice, as observations\[0:1\]; got 2"):
        again[wrong]
    with pytest.raises(ValueError, match="frames are taken forward in time"):
        again[::-1]


def test_some_cameras_are_a_recording_of_their_own(parts: dict[str, Any]) -> None:
    parts["time_s"] = np.tile(parts["time_s"][:, None], (1, CAMERAS))
    observations = Observations(**parts)
    some = observations.subset(("right", "front"))
    assert some.camera_names == ("right", "front")
    np.testing.assert_array_equal(some.confidence, parts["confidence"][:, [2, 0]])
    assert some.time_s.shape == (FRAMES, 2)
    with pytest.raises(ValueError, match="no camera top; they have front, left, right"):
        observations.subset(["top"])


def test_the_rig_must_have_these_cameras_in_this_order(parts: dict[str, Any], rig: CameraRig) -> None:
    three = rig.subset(rig.names[:3])
    a, b, c = three.names
    parts["camera_names"] = (a, b, c)
    observations = Observations(**parts)
    observations.check_cameras(three.names)
    with pytest.raises(ValueError, match=f"the calibration lacks camera {c} of the keypoints; it has {a}, {b}"):
        observations.check_cameras(rig.subset((a, b)).names)
    with pytest.raises(ValueError, match=f"camera {rig.names[3]} of the calibration has no keypoints"):
        observations.check_cameras(rig.names)
    with pytest.raises(ValueError, match="come in a different order"):
        observations.check_cameras(rig.subset((b, a, c)).names)


def test_unnamed_cameras_go_by_their_order(parts: dict[str, Any], rig: CameraRig) -> None:
    del parts["camera_names"]
    observations = Observations(**parts)
    assert observations.camera_names == ("cam_0", "cam_1", "cam_2")
    observations.check_cameras(rig.subset(rig.names[:3]).names)
    with pytest.raises(ValueError, match="the calibration lacks camera cam_0"):
        observations.check_cameras(rig.names)


def test_cameras_that_the_rig_calls_by_the_default_names_go_by_name(parts: dict[str, Any], rig: CameraRig) -> None:
    del parts["camera_names"]
    observations = Observations(**parts)
    names = ("cam_1", "cam_0", "cam_2")
    named = CameraRig(tuple(replace(camera, name=name) for name, camera in zip(names, rig.cameras, strict=False)))
    with pytest.raises(ValueError, match="come in a different order"):
        observations.check_cameras(named.names)
    reordered = observations.with_cameras(named.names)
    np.testing.assert_array_equal(reordered.points2d_px[:, 0], observations.points2d_px[:, 1])


def test_a_missing_3d_point_has_no_covariance(parts: dict[str, Any]) -> None:
    parts["points3d_m"][SPOT] = np.nan
    covariance_m2 = Observations(**parts).covariance3d_m2
    assert covariance_m2 is not None
    assert np.isnan(covariance_m2[SPOT]).all()
    assert np.isnan(covariance_m2).all(axis=(-1, -2)).sum() == 1


@pytest.mark.parametrize(
    "wrong", [np.zeros((3, 3)), np.diag([0.1, 0.1, -0.1]), np.full((3, 3), np.nan), 1e300 * np.eye(3)]
)
def test_a_covariance_that_is_none_is_refused(parts: dict[str, Any], wrong: np.ndarray) -> None:
    parts["covariance3d_m2"][SPOT] = wrong
    with pytest.raises(ValueError, match=f"covariance3d_m2 is not positive definite at {WHERE}"):
        Observations(**parts)


def test_a_covariance_goes_with_its_points(parts: dict[str, Any]) -> None:
    assert replace(Observations(**parts), points3d_m=None).covariance3d_m2 is None
    parts["covariance3d_m2"] = np.eye(3)
    with pytest.raises(ValueError, match=r"covariance3d_m2 must be \(6, 3, 17, 3, 3\)"):
        Observations(**parts)


def test_some_frames_by_time(parts: dict[str, Any]) -> None:
    own_clocks = np.arange(FRAMES)[:, None] / 50 + np.array([-0.001, 0.0, 0.001])
    for time_s in (parts["time_s"], own_clocks):
        observations = Observations(**(parts | {"time_s": time_s}))
        cropped = observations.crop(1 / 50, 3 / 50)
        assert cropped.n_frames == 3
        np.testing.assert_array_equal(cropped.confidence, observations.confidence[1:4])
    with pytest.raises(ValueError, match="no frame is from 2 s to 5 s"):
        observations.crop(2.0, 5.0)
