"""Recordings of which not every frame is shown, and parts of recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rrd_contents import rows, static_value
from shown_people import FIRST, SECOND, SECOND_FRAMES, SKELETON, Update, n_rows, time_s

from fgpose.association.recording import Association
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import TimeRange, parts_of, thinning
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import Recording, open_people_recording, open_recording

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")

EVERY = 4
N_FRAMES = len(time_s())
JOINTS = {name: (f"/world/{name}/joints", "Points3D:positions") for name in ("smoothed", "person_3", "person_5")}
DETECTIONS = (r"/world/camera/cam_2/image/detections", "Points2D:positions")


def show_results(recording: Recording, rig: CameraRig, first: Trajectory) -> None:
    points2d_px = rig.project(first.positions_m)
    recording.log_observations(Observations(SKELETON, time_s(), points2d_px, camera_names=rig.names))
    recording.log_trajectory("smoothed", first)
    recording.log_residuals(time_s(), {"motion": np.ones(first.status.shape)})
    recording.log_update_times(time_s(), np.arange(float(N_FRAMES)))
    for frame in range(N_FRAMES):
        if recording.wants_image("cam_2", frame):
            recording.log_image("cam_2", frame, float(time_s()[frame]), np.zeros((480, 640, 3), dtype=np.uint8))


def test_one_frame_in_so_many_is_shown_as_it_is(rig: CameraRig, first: Trajectory, tmp_path: Path) -> None:
    for path, every in ((tmp_path / "all.rrd", 1), (tmp_path / "some.rrd", EVERY)):
        with open_recording(path, rig, SKELETON, ("smoothed",), every=every, images_every=2 * every) as recording:
            show_results(recording, rig, first)
    entities = {
        JOINTS["smoothed"]: EVERY,
        DETECTIONS: EVERY,
        ("/plots/residual/left_wrist", "Scalars:scalars"): EVERY,
        ("/plots/update_ms", "Scalars:scalars"): EVERY,
        ("/world/camera/cam_2/image/picture", "EncodedImage:blob"): 2 * EVERY,
    }
    for of_entity, every in entities.items():
        whole = rows(tmp_path / "all.rrd", *of_entity)
        assert rows(tmp_path / "some.rrd", *of_entity) == {n: whole[n] for n in range(0, N_FRAMES, every)}
    assert static_value(tmp_path / "some.rrd", "/__properties", "RecordingInfo:name") == "some, one frame in 4"


def test_a_long_recording_is_logged_in_parts_that_do_not_show(
    rig: CameraRig, first: Trajectory, tmp_path: Path
) -> None:
    n_frames, wrist = parts_of(10**6)[2].start + 1, SKELETON.index("left_wrist")
    of_first = np.arange(n_frames) % N_FRAMES
    status = np.full((n_frames, SKELETON.n_joints), Status.OBSERVED)
    status[990:1011, wrist] = Status.PREDICTED
    times_s = 10.0 + np.arange(n_frames) / 50
    long = Trajectory(SKELETON, times_s, first.positions_m[of_first], status)
    seen = Observations(SKELETON, times_s, rig.project(long.positions_m), camera_names=rig.names)
    with open_recording(tmp_path / "long.rrd", rig, SKELETON, ("smoothed",)) as recording:
        recording.log_observations(seen)
        recording.log_trajectory("smoothed", long)
        recording.log_residuals(times_s, {"motion": np.ones(status.shape)})
    for of_entity in (JOINTS["smoothed"], DETECTIONS, ("/plots/residual/left_wrist", "Scalars:scalars")):
        assert list(rows(tmp_path / "long.rrd", *of_entity)) == list(range(n_frames))
    assert list(rows(tmp_path / "long.rrd", "/status/smoothed/left_wrist", "StateChange:state")) == [990, 1011]


def test_a_result_may_have_the_frames_alone_that_are_shown(rig: CameraRig, first: Trajectory, tmp_path: Path) -> None:
    for path, every in ((tmp_path / "all.rrd", 1), (tmp_path / "some.rrd", 2)):
        with open_recording(path, rig, SKELETON, ("smoothed",), every=EVERY) as recording:
            recording.log_trajectory("smoothed", first.frames(slice(None, None, every)), every)
    whole = rows(tmp_path / "all.rrd", *JOINTS["smoothed"])
    assert list(whole) == list(range(0, N_FRAMES, EVERY))
    assert rows(tmp_path / "some.rrd", *JOINTS["smoothed"]) == whole


def test_a_result_without_the_frames_that_are_shown_is_refused(
    rig: CameraRig, first: Trajectory, tmp_path: Path
) -> None:
    with open_recording(tmp_path / "some.rrd", rig, SKELETON, ("smoothed",), every=EVERY) as recording:
        with pytest.raises(ValueError, match="smoothed has one frame in 3, the recording shows one in 4"):
            recording.log_trajectory("smoothed", first, 3)
        recording.log_trajectory("smoothed", first)


@pytest.mark.parametrize("live", [False, True])
def test_people_of_one_frame_in_so_many(
    live: bool,
    rig: CameraRig,
    association: Association,
    first: Trajectory,
    second: Trajectory,
    updates: list[Update],
    tmp_path: Path,
) -> None:
    """Whoever has left is gone in the next frame that is shown; no event is lost."""
    for path, every in ((tmp_path / "all.rrd", 1), (tmp_path / "some.rrd", EVERY)):
        with open_people_recording(path, rig, SKELETON, every=every) as recording:
            if live:
                for frame, update in enumerate(updates):
                    recording.log_tracked(frame, *update)
            else:
                recording.log_association(association)
                recording.log_person(FIRST, first)
                recording.log_person(SECOND, second, SECOND_FRAMES.start)
    for of_entity in (JOINTS["person_3"], JOINTS["person_5"], DETECTIONS):
        whole, some = (rows(tmp_path / name, *of_entity) for name in ("all.rrd", "some.rrd"))
        for frame in range(0, N_FRAMES, EVERY):
            # What a viewer shows is the newest of what was logged until then.
            of_whole, of_some = ([n for n in each if n <= frame] for each in (whole, some))
            assert bool(of_whole) == bool(of_some)
            if of_whole:
                assert some[max(of_some)][1] == whole[max(of_whole)][1]
    assert n_rows(tmp_path / "some.rrd", "/events") == n_rows(tmp_path / "all.rrd", "/events") == 4


def test_a_part_has_the_frames_of_its_seconds(rig: CameraRig, first: Trajectory, tmp_path: Path) -> None:
    from fgpose.viewer.rerun.rrd_part import rrd_part

    path = tmp_path / "whole.rrd"
    with open_recording(path, rig, SKELETON, ("smoothed",)) as recording:
        show_results(recording, rig, first)
    (tmp_path / "part").mkdir()
    part = rrd_part(path, TimeRange(time_s()[3], time_s()[6]), tmp_path / "part")
    whole = rows(path, *JOINTS["smoothed"])
    assert rows(part, *JOINTS["smoothed"]) == {frame: whole[frame] for frame in range(3, 7)}
    assert [each.name for each in part.parent.iterdir()] == ["whole.rrd"]
    with pytest.raises(
        ValueError, match=r"whole.rrd: no frame is from 20 s on: there are frames from 10 s to 10\.22 s"
    ):
        rrd_part(path, TimeRange(20.0), tmp_path)
    (tmp_path / "bad.rrd").write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"bad\.rrd: "):
        rrd_part(tmp_path / "bad.rrd", TimeRange(), tmp_path)
    with pytest.raises(ValueError, match="there is nothing from 2 s to 1 s"):
        TimeRange(2.0, 1.0)


def test_of_a_long_recording_so_many_frames_are_shown() -> None:
    time_s = np.arange(1000) / 60
    assert [thinning(time_s, fps, 300) for fps in (None, 60.0, 30.0, 7.0, 100.0)] == [4, 1, 2, 9, 1]
    assert [thinning(time_s, None, at_most) for at_most in (999, 1000)] == [2, 1]
    assert thinning(time_s[:1], 30.0, 300) == 1
