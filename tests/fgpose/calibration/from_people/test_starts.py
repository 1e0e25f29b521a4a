from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filmed_walk import intrinsics_of, true_offset_s, walk_scene, walk_tracks

from fgpose.calibration.from_people.calibrated import Grade
from fgpose.calibration.from_people.starts.starts import GivenStart, Starts, find_starts
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks, no_track
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.io.recordings import load_recording
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig
from fgpose_benchmarks.synthetic.crowd.walkers import walkers
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, film


@pytest.fixture(scope="module")
def found() -> Starts:
    scene = walk_scene()
    return find_starts(walk_tracks(), scene.observations.skeleton, scene.intrinsics)


@pytest.fixture(scope="module")
def bodies() -> Skeleton:
    return walk_scene().observations.skeleton


def errors_s(starts: Starts, tracks: tuple[Track, ...]) -> np.ndarray:
    """In the middle of each track; NaN where not trusted."""
    middle_s = [float(track.time_s.mean()) for track in tracks]
    own = [starts.common_s(track.camera, np.array([m]))[0] - m for track, m in zip(tracks, middle_s, strict=True)]
    names = walk_scene().observations.camera_names
    true = [
        true_offset_s(walk_scene(), names.index(track.camera), m) for track, m in zip(tracks, middle_s, strict=True)
    ]
    return np.array(own) - np.array(true)


def later(track: Track, by_s: float) -> Track:
    return replace(track, time_s=track.time_s + by_s)


def test_videos_that_begin_at_different_moments_are_brought_together(found: Starts) -> None:
    assert found.trusted.all()
    assert found.reference == walk_scene().observations.camera_names[0]
    errors = errors_s(found, walk_tracks())
    assert errors[0] == 0
    # A quarter of an image of the fastest camera (50 Hz); sigmas are about 2 ms.
    assert np.abs(errors).max() < 5e-3
    assert (np.abs(errors[1:]) < 3 * found.sigma_s[1:]).all()
    assert found.sigma_s.max() < 5e-3


def test_own_time_is_the_inverse_of_common_time(found: Starts) -> None:
    times_s = np.array([0.0, 12.5])
    np.testing.assert_allclose(found.own_s("ring_2", found.common_s("ring_2", times_s)), times_s, atol=1e-9)


def test_videos_may_begin_minutes_apart_without_3d(bodies: Skeleton) -> None:
    tracks = tuple(replace(later(track, 300.0 * c), points3d_m=None) for c, track in enumerate(walk_tracks()))
    starts = find_starts(tracks, bodies, walk_scene().intrinsics)
    assert starts.trusted.all()
    middle_s = np.array([track.time_s.mean() for track in tracks])
    at_s = [starts.common_s(track.camera, np.array([m]))[0] for track, m in zip(tracks, middle_s, strict=True)]
    true_s = [m - 300.0 * c + true_offset_s(walk_scene(), c, m - 300.0 * c) for c, m in enumerate(middle_s)]
    # As before.
    assert np.abs(np.array(at_s) - true_s).max() < 5e-3


def test_given_starts_are_taken_as_they_are(bodies: Skeleton) -> None:
    given = {f"ring_{c}": GivenStart(offset_s) for c, offset_s in enumerate((2.0, 3.5, -1.0))}
    starts = find_starts(walk_tracks(), bodies, walk_scene().intrinsics, given)
    np.testing.assert_array_equal(starts.offsets_s, [0.0, 1.5, -3.0])
    assert (starts.sigma_s == 0).all()
    assert starts.trusted.all()


def test_another_cue_is_refined(bodies: Skeleton) -> None:
    true_s = [true_offset_s(walk_scene(), c, 15.0) for c in range(3)]
    given = {f"ring_{c}": GivenStart(true_s[c] + by_s, 0.02) for c, by_s in enumerate((0.0, 0.03, -0.02))}
    starts = find_starts(walk_tracks(), bodies, walk_scene().intrinsics, given)
    assert starts.trusted.all()
    assert np.abs(errors_s(starts, walk_tracks())).max() < 5e-3


def test_a_camera_that_sees_nobody_or_another_time_is_not_trusted(bodies: Skeleton) -> None:
    tracks, intrinsics = walk_tracks(), walk_scene().intrinsics
    nobody = find_starts((no_track("ring_0", bodies), *tracks[1:]), bodies, intrinsics)
    assert nobody.trusted.tolist() == [False, True, True]
    assert nobody.reference == "ring_1"
    assert np.isnan(nobody.offsets_s[0])
    assert nobody.offsets_s[1] == 0
    assert [(f.camera, f.grade) for f in nobody.findings] == [("ring_0", Grade.FAILED)]
    assert nobody.findings[0].reason == "nobody is seen"
    # The first half of one video, and what another one shows a good while later.
    early, late = _part(tracks[0], 0.0, 12.0), _part(tracks[2], 25.0, 40.0)
    apart = find_starts((early, late), bodies, intrinsics_of((early, late)))
    assert not apart.trusted.any()
    assert all(finding.grade is Grade.FAILED for finding in apart.findings)


def _part(track: Track, from_s: float, to_s: float) -> Track:
    kept = (track.time_s >= from_s) & (track.time_s < to_s)
    assert track.points3d_m is not None
    return Track(
        track.camera, track.time_s[kept], track.points2d_px[kept], track.confidence[kept], track.points3d_m[kept]
    )


def test_somebody_who_stands_still_is_told_so() -> None:
    motion = walkers((4.0, 4.0), 12.0, 0, "stands")
    scene = film(motion, ring_rig(2, 4.5, 1.9), 0, SimulatedNetwork(), SimulatedClocks((25.0,), 3.0))
    skeleton = scene.observations.skeleton
    starts = find_starts(main_tracks(find_tracks(scene.observations), skeleton), skeleton, scene.intrinsics)
    assert not starts.trusted.any()
    assert "hardly moves" in starts.findings[0].reason
    assert "walk" in starts.findings[0].remedy


def test_two_videos_of_one_camera_are_found_out(bodies: Skeleton) -> None:
    tracks = walk_tracks()
    copy = replace(later(_part(tracks[0], 3.0, 40.0), -3.0), camera="ring_1")
    names = ("ring_0", "ring_1", "ring_2")
    own = walk_scene().intrinsics.cameras
    rig = CameraRig(
        tuple(replace(camera, name=name) for camera, name in zip((own[0], own[0], own[2]), names, strict=True))
    )
    starts = find_starts((tracks[0], copy, tracks[2]), bodies, rig)
    assert starts.trusted.tolist() == [True, False, True]
    assert "same image as ring_0" in starts.findings[0].reason


def test_a_clock_that_runs_at_another_rate_is_noticed(bodies: Skeleton) -> None:
    # A file that says 30 for 29.7 Hz.
    tracks = walk_tracks()
    fast = replace(tracks[1], time_s=0.99 * tracks[1].time_s)
    starts = find_starts((tracks[0], fast, tracks[2]), bodies, walk_scene().intrinsics)
    about = [finding for finding in starts.findings if finding.camera == "ring_1"]
    assert about, "either no moment fits, or its rate is said to be wrong"
    assert any("rate" in finding.reason + finding.remedy for finding in about)


def test_a_second_of_video_is_too_short(bodies: Skeleton) -> None:
    short = tuple(_part(track, 10.0, 11.0) for track in walk_tracks()[:2])
    starts = find_starts(short, bodies, intrinsics_of(short))
    assert not starts.trusted.any()
    assert "too short" in starts.findings[0].reason


def test_bad_input_is_refused(bodies: Skeleton) -> None:
    tracks, intrinsics = walk_tracks(), walk_scene().intrinsics
    with pytest.raises(ValueError, match="only ring_0; at least two"):
        find_starts(tracks[:1], bodies, intrinsics.subset(["ring_0"]))
    with pytest.raises(ValueError, match="the tracks are of the cameras ring_1"):
        find_starts(tracks[1:], bodies, intrinsics)
    with pytest.raises(ValueError, match="start is given for left"):
        find_starts(tracks, bodies, intrinsics, {"left": GivenStart(0.0)})
    nobody = tuple(no_track(name, bodies) for name in intrinsics.names)
    with pytest.raises(ValueError, match="no camera sees anybody"):
        find_starts(nobody, bodies, intrinsics)
    with pytest.raises(ValueError, match="only ring_2 sees anybody"):
        find_starts((*nobody[:2], tracks[2]), bodies, intrinsics)


@pytest.mark.slow
def test_synchronised_cameras_of_a_real_recording() -> None:
    # 1.7 s of a man on one leg: they are synchronised to 0.2 images.
    rig, observations = load_recording("balance_blazepose")
    tracks = main_tracks(find_tracks(PeopleObservations.of_one(observations)), observations.skeleton)
    given = {name: GivenStart(0.0, 0.05) for name in rig.names}
    starts = find_starts(tracks, observations.skeleton, rig, given)
    # Images are 17 ms apart.
    assert np.nanmax(np.abs(starts.offsets_s)) < 0.025


def test_a_clock_that_jumps_is_blamed_and_does_not_spoil_the_others(bodies: Skeleton) -> None:
    # The clock of the first camera is put forward by 0.15 s in the middle of the recording.
    tracks = walk_tracks()
    jumps = replace(tracks[0], time_s=tracks[0].time_s + np.where(tracks[0].time_s > 15.0, 0.15, 0.0))
    starts = find_starts((jumps, *tracks[1:]), bodies, walk_scene().intrinsics)
    assert {finding.camera for finding in starts.findings} == {"ring_0"}
    assert starts.trusted[1:].all()
    in_both_s = starts.own_s("ring_1", starts.common_s("ring_2", np.array([15.0])))[0]
    true_s = 15.0 + true_offset_s(walk_scene(), 2, 15.0) - true_offset_s(walk_scene(), 1, 15.0)
    # Half an image of the fastest camera.
    assert in_both_s == pytest.approx(true_s, abs=0.01)
