"""The bodies of several people in a recording: where and when they are shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd_contents import METRE_TOLERANCE, PIXEL_TOLERANCE, rows, values
from shown_people import FIRST, N_FRAMES, PLACE_M, SECOND, SECOND_FRAMES, SHOWN, SKELETON, body_m, n_rows, state, time_s

from fgpose.association.recording import Association
from fgpose.geometry.camera import CameraRig
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import open_people_recording

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")


@pytest.mark.parametrize(("entity", "component"), SHOWN)
def test_a_person_is_shown_only_where_they_are_known(file: Path, entity: str, component: str) -> None:
    found = rows(file, entity, component)
    # Frames without a row show the row before: none before the first frame, and an empty one after the last.
    assert sorted(found) == list(range(2, 10))
    assert [frame for frame, (_, shown) in found.items() if not shown] == [4, 9]
    for frame, (seconds, _) in found.items():
        assert seconds == pytest.approx(time_s()[frame], abs=1e-9)  # nanoseconds are whole numbers


def test_positions_and_reprojections_are_those_logged(file: Path, rig: CameraRig, second: Trajectory) -> None:
    joints = rows(file, f"/world/person_{SECOND}/joints", "Points3D:positions")
    reprojected = rows(file, SHOWN[-1][0], "Points2D:positions")
    for n in (0, 1, 3, 6):
        np.testing.assert_allclose(joints[2 + n][1], second.positions_m[n], atol=METRE_TOLERANCE)
        expected_px = rig.cameras[1].project(second.positions_m[n])
        np.testing.assert_allclose(reprojected[2 + n][1], expected_px, atol=PIXEL_TOLERANCE)


def test_status_of_joints_ends_with_the_person(file: Path) -> None:
    assert state(file, f"/status/person_{SECOND}/left_elbow") == {4: "unobservable", 5: "", 8: "predicted", 9: ""}
    assert state(file, f"/status/person_{SECOND}/nose") == {4: "unobservable", 5: ""}


def test_one_line_per_person_of_the_median_error(file: Path) -> None:
    error_px = np.array(values(file, f"/plots/reprojection_px/person_{SECOND}", "Scalars:scalars"))[:, 0]
    # 5 px in both cameras; at first 10 px in one of them: the middle of both.
    np.testing.assert_allclose(error_px, [7.5, 5.0, np.nan, 5.0, 5.0, 5.0, 5.0, np.nan])


@pytest.mark.parametrize(("up", "axis", "sign"), [("+z", 2, 1), ("-y", 1, -1)])
def test_the_number_stands_above_the_head(
    tmp_path: Path, rig: CameraRig, second: Trajectory, up: Any, axis: int, sign: int
) -> None:
    with open_people_recording(tmp_path / "up.rrd", rig, SKELETON, up=up) as recording:
        recording.log_person(SECOND, second)
    ((label_m,), *_) = values(tmp_path / "up.rrd", f"/world/person_{SECOND}/label", "Points3D:positions")
    positions_m = second.positions_m[0]
    assert sign * label_m[axis] > (sign * positions_m[:, axis]).max()
    across = [other for other in range(3) if other != axis]
    np.testing.assert_allclose(label_m[across], positions_m.mean(axis=0)[across], atol=METRE_TOLERANCE)


def test_the_label_says_who_is_only_predicted(tmp_path: Path, rig: CameraRig, second: Trajectory) -> None:
    status = second.status.copy()
    status[3] = Status.PREDICTED
    with open_people_recording(tmp_path / "label.rrd", rig, SKELETON) as recording:
        recording.log_person(SECOND, replace(second, status=status))
    labels = rows(tmp_path / "label.rrd", f"/world/person_{SECOND}/label", "Points3D:labels")
    # Nothing is known of them in frame 2.
    expected = {frame: [f"{SECOND}"] for frame in range(second.n_frames)} | {2: [], 3: [f"{SECOND} predicted"]}
    assert {frame: text for frame, (_, text) in labels.items()} == expected


@pytest.mark.parametrize("association_first", [True, False])
def test_who_is_there_at_the_end_stays_there(
    tmp_path: Path, rig: CameraRig, association: Association, second: Trajectory, association_first: bool
) -> None:
    path = tmp_path / "end.rrd"
    status = np.full((N_FRAMES, SKELETON.n_joints), Status.OBSERVED)
    first = Trajectory(SKELETON, time_s(), body_m(PLACE_M[FIRST]), status)
    with open_people_recording(path, rig, SKELETON) as recording:
        if association_first:
            recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
        recording.log_person(FIRST, first)
        if not association_first:
            recording.log_association(association)
    shown = rows(path, f"/world/person_{FIRST}/joints", "Points3D:positions")
    assert sorted(shown) == list(range(N_FRAMES))
    assert all(positions for _, positions in shown.values())
    assert rows(path, f"/world/person_{SECOND}/joints", "Points3D:positions")[9] == (pytest.approx(10.18), [])


def test_without_a_later_frame_there_is_none(tmp_path: Path, rig: CameraRig, second: Trajectory) -> None:
    entity, component = SHOWN[0]
    with open_people_recording(tmp_path / "a.rrd", rig, SKELETON) as recording:
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    assert max(rows(tmp_path / "a.rrd", entity, component)) == 8
    with open_people_recording(tmp_path / "b.rrd", rig, SKELETON) as recording:
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
        recording.log_image("cam_2", 12, 10.24, np.zeros((480, 640, 3), dtype=np.uint8))
    # The times of the frames between are not known: interpolated.
    assert rows(tmp_path / "b.rrd", entity, component)[9] == (pytest.approx(10.18), [])


def test_a_person_may_be_logged_in_pieces(tmp_path: Path, rig: CameraRig, second: Trajectory) -> None:
    def piece(begin: int, end: int) -> Trajectory:
        arrays = {name: getattr(second, name)[begin:end] for name in ("time_s", "positions_m", "status")}
        return Trajectory(SKELETON, **arrays)

    path = tmp_path / "pieces.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        for begin, end in ((0, 3), (3, 4), (6, 7)):
            recording.log_person(SECOND, piece(begin, end), SECOND_FRAMES.start + begin)
    shown = {frame: bool(positions) for frame, (_, positions) in rows(path, *SHOWN[0]).items()}
    # Nothing is known in frame 4, and nobody is there from frame 6 to 7.
    assert shown == {2: True, 3: True, 4: False, 5: True, 6: False, 8: True}
    assert state(path, f"/status/person_{SECOND}/nose") == {4: "unobservable", 5: ""}
    # Two rows of one frame would break lines in plots.
    assert n_rows(path, SHOWN[0][0]) == len(shown)
