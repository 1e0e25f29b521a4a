from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filmed_walk import bodies_px, track_of

from fgpose.calibration.from_people.starts.starts import Starts
from fgpose.calibration.from_people.starts.together import together
from fgpose.calibration.from_people.walk import Track
from fgpose.sampling import between_images, smaller_around
from fgpose.skeleton import Skeleton


def starts_at(*offsets_s: float, reference: int = 0) -> Starts:
    names = tuple("abcdef"[: len(offsets_s)])
    zero = np.zeros(len(names))
    return Starts(names, names[reference], np.array(offsets_s), zero, zero, np.isfinite(offsets_s))


def seen_px(skeleton: Skeleton, time_s: np.ndarray) -> np.ndarray:
    """A body whose joints move straight on: interpolation is exact."""
    return bodies_px(skeleton, 1)[0] + np.stack([80 * time_s, 20 * time_s], axis=-1)[:, None]


def filmed(skeleton: Skeleton, camera: str, fps: float, begins_s: float, lasts_s: float) -> Track:
    own_s = np.arange(0.0, lasts_s, 1 / fps)
    points_px = seen_px(skeleton, own_s + begins_s)
    return Track(camera, own_s, points_px, np.full(points_px.shape[:2], 0.8), np.repeat(points_px, 2, axis=2)[..., :3])


def test_images_of_synchronised_cameras_are_taken_as_they_are(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(0)
    tracks = [
        track_of(bodies_px(skeleton, 60, seed=n) + rng.normal(0, 3, (60, skeleton.n_joints, 2)), 25.0, name)
        for n, name in enumerate("abc")
    ]
    walk = together(tracks, starts_at(0.0, 0.0, 0.0), skeleton)
    np.testing.assert_array_equal(walk.time_s, tracks[0].time_s)
    np.testing.assert_array_equal(walk.points2d_px, np.stack([track.points2d_px for track in tracks], axis=1))
    assert walk.points3d_m is None
    faster = [replace(track, time_s=track.time_s / 2.4) for track in tracks]
    # 60 Hz: every second image.
    np.testing.assert_array_equal(
        together(faster, starts_at(0.0, 0.0, 0.0), skeleton).points2d_px, walk.points2d_px[::2]
    )


def test_detections_are_brought_to_the_clock_of_the_reference(skeleton: Skeleton) -> None:
    tracks = [
        filmed(skeleton, "a", 25.0, 0.0, 6.0),
        filmed(skeleton, "b", 30.0, 2.013, 6.0),
        filmed(skeleton, "c", 50.0, 1.0, 2.0),
    ]
    walk = together(tracks, starts_at(0.0, 2.013, 1.0), skeleton)
    # From when b begins until a ends, by the clock of a.
    assert walk.time_s[0] == pytest.approx(1.0)
    assert walk.time_s[-1] == pytest.approx(5.96)
    expected_px = np.repeat(seen_px(skeleton, walk.time_s)[:, None], 3, axis=1)
    known = np.isfinite(walk.points2d_px).all(axis=-1)
    np.testing.assert_allclose(walk.points2d_px[known], expected_px[known], atol=1e-6)
    assert (np.sum(known.any(axis=-1), axis=1) >= 2).all()
    assert np.array_equal(known, walk.confidence > 0)
    assert walk.points3d_m is not None
    np.testing.assert_allclose(walk.points3d_m[known][:, 0], expected_px[known][:, 0], atol=1e-6)


def test_cameras_that_are_not_trusted_are_left_out(skeleton: Skeleton) -> None:
    tracks = [filmed(skeleton, name, 25.0, 0.0, 4.0) for name in "abc"]
    walk = together(tracks, starts_at(np.nan, 0.0, 0.02, reference=1), skeleton)
    assert walk.camera_names == ("b", "c")
    with pytest.raises(ValueError, match="fewer than two cameras can be brought together"):
        together(tracks, starts_at(0.0, np.nan, np.nan), skeleton)


def test_who_is_never_seen_by_two_at_once_makes_no_walk(skeleton: Skeleton) -> None:
    tracks = [filmed(skeleton, "a", 25.0, 0.0, 4.0), filmed(skeleton, "b", 25.0, 10.0, 4.0)]
    with pytest.raises(ValueError, match="see the same person at the same time"):
        together(tracks, starts_at(0.0, 10.0), skeleton)


def test_of_a_long_recording_the_parts_with_motion_are_kept(skeleton: Skeleton) -> None:
    points_px = bodies_px(skeleton, 1)[0] + np.zeros((500, 1, 2))
    points_px[200:300, :, 0] += 4.0 * np.arange(100)[:, None]
    points_px[300:, :, 0] += 400.0
    tracks = [track_of(points_px, 25.0, name) for name in "ab"]
    walk = together(tracks, starts_at(0.0, 0.0), skeleton, max_frames=100)
    np.testing.assert_allclose(walk.time_s, np.arange(200, 300) / 25.0)


def test_nothing_is_interpolated_across_a_gap() -> None:
    time_s = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    values = np.array([[0.0], [1.0], [np.nan], [4.0], [5.0]])
    at_s = np.array([-0.01, 0.05, 0.1, 0.15, 0.3, 0.4, 0.42, 0.5, 0.6])
    found = between_images(time_s, values, at_s)[:, 0]
    np.testing.assert_allclose(found, [np.nan, 0.5, 1.0, np.nan, np.nan, 4.0, 4.2, 5.0, np.nan], atol=1e-9)
    confidence = np.array([0.5, 0.9, 0.0, 0.8, 0.7])
    found = smaller_around(time_s, confidence, at_s)
    np.testing.assert_allclose(found, [0.0, 0.5, 0.9, 0.0, 0.0, 0.8, 0.7, 0.7, 0.0])
