"""Several people shown update by update: the same as a whole recording, and nothing of it is kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd_contents import entities, rows, values
from shown_people import (
    FIRST,
    SECOND,
    SECOND_FRAMES,
    SECOND_IS,
    SHOWN,
    SKELETON,
    Update,
    class_colours,
    n_rows,
    packed,
    state,
    time_s,
)

from fgpose.association.recording import Association
from fgpose.association.track import TrackEvent
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Status, Trajectory
from fgpose.viewer import Recording, open_people_recording
from fgpose.viewer.rerun import palette

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")


@pytest.fixture(scope="module")
def live_file(tmp_path_factory: pytest.TempPathFactory, rig: CameraRig, updates: list[Update]) -> Path:
    path = tmp_path_factory.mktemp("live") / "live.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        for frame, update in enumerate(updates):
            recording.log_tracked(frame, *update)
    return path


@pytest.fixture(scope="module")
def whole_file(
    tmp_path_factory: pytest.TempPathFactory,
    file: Path,
    rig: CameraRig,
    association: Association,
    first: Trajectory,
    second: Trajectory,
) -> Path:
    path = tmp_path_factory.mktemp("whole") / "whole.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        recording.log_association(association)
        recording.log_person(FIRST, first)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    return path


def shown_in(path: Path) -> dict[str, dict[int, list[dict[str, Any]]]]:
    """Of every entity, by frame: all rows of all components."""
    from rerun.chunk import RrdReader

    found: dict[str, dict[int, list[dict[str, Any]]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if "frame" in batch.schema.names:
            for row in batch.to_pylist():
                what = {name: value for name, value in row.items() if ":" in name or name == "time"}
                found.setdefault(str(chunk.entity_path), {}).setdefault(row["frame"], []).append(what)
    return found


def test_it_is_what_a_whole_recording_shows(live_file: Path, whole_file: Path) -> None:
    live, whole = shown_in(live_file), shown_in(whole_file)
    assert set(live) == set(whole)
    # What is known afterwards only: who is lost will be found again. See the next tests.
    for entity in set(whole) - {"/plots/people", f"/tracks/person_{SECOND}"}:
        # The image of one camera alone, in every other frame, leaves the other camera as it was.
        is_of_cam_2 = entity in ("/world/camera/cam_2/image/detections", "/plots/unused/cam_2")
        frames = [frame for frame in whole[entity] if not (is_of_cam_2 and frame % 2)]
        assert sorted(live[entity]) == sorted(frames), entity
        for frame in frames:
            # As text: NaN is not equal to itself.
            assert repr(live[entity][frame]) == repr(whole[entity][frame]), (entity, frame)


def test_lives_go_on_while_they_are_predicted(live_file: Path) -> None:
    expected = ["predicted" if now == "away" else now for now in SECOND_IS]
    changes = {frame: now for frame, now in enumerate(expected) if now != ["", *expected][frame]}
    assert state(live_file, f"/tracks/person_{SECOND}") == changes
    n_people = np.concatenate(values(live_file, "/plots/people", "Scalars:scalars")).tolist()
    assert n_people == [1.0 + (now != "") for now in expected]


def test_a_camera_without_an_image_among_others_is_empty(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    more = CameraRig((replace(rig.cameras[0], name="cam_0"), *rig.cameras))
    images, _, _ = updates[0]
    with open_people_recording(tmp_path / "more.rrd", more, SKELETON) as recording:
        for frame, given in enumerate((images, [replace(images[0], camera="cam_0")], images)):
            recording.log_tracked(frame, given, [])
    shown = rows(tmp_path / "more.rrd", "/world/camera/cam_0/image/detections", "Points2D:positions")
    assert {frame: bool(points_px) for frame, (_, points_px) in shown.items()} == {0: False, 1: True, 2: False}
    unused = rows(tmp_path / "more.rrd", "/plots/unused/cam_0", "Scalars:scalars")
    assert [count for _, (count,) in unused.values()] == [0.0, 2.0, 0.0]


@pytest.mark.parametrize(("entity", "component"), SHOWN)
def test_who_leaves_disappears(live_file: Path, entity: str, component: str) -> None:
    found = {frame: bool(shown) for frame, (_, shown) in rows(live_file, entity, component).items()}
    # Nothing is known of them in frame 4, and they have left in frame 9. Later frames show the row before.
    assert found == {2: True, 3: True, 4: False, 5: True, 6: True, 7: True, 8: True, 9: False}
    assert n_rows(live_file, entity) == len(found)


def test_who_is_recognised_has_their_former_number(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    path, former, taken = tmp_path / "recognised.rrd", 11, 2
    reason = f"as {former}: away for 7.0 s, log odds of place and bones 9.0"
    with open_people_recording(path, rig, SKELETON) as recording:
        for frame, (images, (somebody, *_), _) in enumerate(updates[:6]):
            person, events = (taken, []) if frame < 4 else (former, [])
            if frame == 4:
                events = [TrackEvent(images[0].time_s, taken, "recognised", reason)]
            recording.log_tracked(frame, images, [replace(somebody, person=person)], events)
    for person, frames in ((taken, {0: True, 1: True, 2: True, 3: True, 4: False}), (former, {4: True, 5: True})):
        for entity in (f"/world/person_{person}/joints", f"/world/person_{person}/label"):
            shown = rows(path, entity, "Points3D:positions")
            assert {frame: bool(positions_m) for frame, (_, positions_m) in shown.items()} == frames
    assert state(path, f"/tracks/person_{taken}") == {0: "seen", 4: ""}
    assert state(path, f"/tracks/person_{former}") == {4: "seen"}
    colours, numbers = class_colours(path), rows(path, r"/world/camera/cam\ 1/image/detections", "Points2D:class_ids")
    for frame, person in ((3, taken), (4, former)):
        expected = {packed(palette.person_colour(person)), packed(palette.NOBODY)}
        assert {colours[number] for number in numbers[frame][1]} == expected
    ((_, (text,)),) = rows(path, "/events", "TextLog:text").values()
    assert text == f"person {taken} recognised: {reason}"
    assert np.concatenate(values(path, "/plots/people", "Scalars:scalars")).tolist() == [1.0] * 6


def test_in_frames_that_are_left_out_nobody_is_there(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    path = tmp_path / "gap.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        for frame in (0, 1, 4):
            recording.log_tracked(frame, *updates[frame])
        recording.log_tracked(5, [], [])
    shown = rows(path, f"/world/person_{FIRST}/joints", "Points3D:positions")
    found = {frame: bool(positions_m) for frame, (_, positions_m) in shown.items()}
    assert found == {0: True, 1: True, 2: False, 4: True}
    assert shown[2][0] == pytest.approx(time_s()[2], abs=1e-9)  # nanoseconds are whole numbers


def test_pictures_may_come_before_their_update(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    path = tmp_path / "pictures.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        for frame, update in enumerate(updates[:5]):
            recording.log_image("cam_2", frame, float(time_s()[frame]), np.zeros((480, 640, 3), dtype=np.uint8))
            recording.log_tracked(frame, *update)
    assert sorted(rows(path, "/world/camera/cam_2/image/picture", "EncodedImage:blob")) == list(range(5))
    joints = f"/world/person_{FIRST}/joints"
    assert [bool(each) for _, each in rows(path, joints, "Points3D:positions").values()] == [True] * 5
    assert n_rows(path, joints) == 5


def test_the_ninth_has_the_colour_of_the_first(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    """However many have been there: numbers of annotations end at 65,535."""
    path, many = tmp_path / "many.rrd", 8 * 5000
    images, (somebody, *_), _ = updates[0]
    with open_people_recording(path, rig, SKELETON) as recording:
        recording.log_tracked(0, images, [replace(somebody, person=many)])
    ((_, numbers),) = rows(path, r"/world/camera/cam\ 1/image/detections", "Points2D:class_ids").values()
    colours = {class_colours(path)[number] for number in numbers}
    assert colours == {packed(palette.person_colour(0)), packed(palette.NOBODY)}


def crossing(updates: list[Update]) -> Iterator[Update]:
    """Without end: every 10 updates somebody leaves and somebody new comes."""
    images, (_, somebody), _ = updates[2]
    number = 0
    while True:
        now = [replace(image, time_s=10.0 + number / 50) for image in images]
        person = number // 10
        event = TrackEvent(now[0].time_s, person, "confirmed", "cam 1, cam_2 agree")
        yield now, [replace(somebody, person=person)], [event] if number % 10 == 0 else []
        number += 1


def n_kept(value: object, known: set[int]) -> int:
    """How many values our own objects hold."""
    if id(value) in known:
        return 0
    if isinstance(value, np.ndarray):
        return value.size
    if isinstance(value, dict):
        parts = [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set | frozenset):
        parts = list(value)
    elif type(value).__module__.startswith("fgpose") and hasattr(value, "__dict__"):
        parts = list(vars(value).values())
    else:
        return 1
    known.add(id(value))
    return sum(n_kept(part, known) for part in parts)


@pytest.mark.slow
def test_nothing_is_kept_of_what_was_shown(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    kept = []
    blank = np.zeros((480, 640, 3), dtype=np.uint8)
    options: dict[str, Any] = {"endless": True, "image_limit_mb": 0.1}
    with open_people_recording(tmp_path / "long.rrd", rig, SKELETON, **options) as recording:
        for frame, (images, people, events) in zip(range(1000), crossing(updates), strict=False):
            recording.log_tracked(frame, images, people, events)
            recording.log_image("cam_2", frame, images[0].time_s, blank)
            if frame % 100 == 99:
                kept.append(n_kept(recording, set()))
    assert len(kept) == 10
    assert set(kept) == {kept[0]}
    # The status of their joints, at least: it is counted.
    assert kept[0] > SKELETON.n_joints


def test_bad_updates_are_refused(tmp_path: Path, rig: CameraRig, updates: list[Update]) -> None:
    images, people, _ = updates[2]
    with open_people_recording(tmp_path / "bad.rrd", rig, SKELETON) as recording:
        with pytest.raises(ValueError, match="of frame 0 or later, got frame -1"):
            recording.log_tracked(-1, images, people)
        with pytest.raises(ValueError, match="the calibration has no camera cam_9"):
            recording.log_tracked(0, [replace(images[0], camera="cam_9")], people)
        with pytest.raises(ValueError, match=r"camera cam 1, image at 10.04 s: .* several images in frame 0"):
            recording.log_tracked(0, [images[0], replace(images[0], time_s=10.06)], people)
        few = Detections("cam 1", 10.0, np.zeros((1, 3, 2)), np.ones((1, 3)))
        with pytest.raises(ValueError, match=r"camera cam 1, image at 10 s: 3 joints, .* coco_17, which has 17"):
            recording.log_tracked(0, [few], people)
        other = Estimate(load_skeleton("h36m_17"), 0, 10.0, np.zeros((17, 3)), np.full(17, Status.OBSERVED))
        with pytest.raises(ValueError, match="person 3 has the joints of skeleton h36m_17"):
            recording.log_tracked(0, images, [replace(people[0], estimate=other)])
        unknown = replace(other, skeleton=SKELETON, residual_px=np.zeros((5, 17)))
        with pytest.raises(ValueError, match=r"residual_px must be \(1, 2, 17\), got \(1, 5, 17\)"):
            recording.log_tracked(0, images, [people[1], replace(people[0], estimate=unknown)])
    assert not entities(tmp_path / "bad.rrd")
    with open_people_recording(tmp_path / "twice.rrd", rig, SKELETON) as recording:
        recording.log_tracked(4, images, people)
        for frame in (4, 3):
            with pytest.raises(ValueError, match=f"of frame 5 or later, got frame {frame}"):
                recording.log_tracked(frame, images, people)
    with pytest.raises(ValueError, match="closed"):
        recording.log_tracked(5, images, people)


def test_a_recording_to_nowhere_takes_updates(rig: CameraRig, updates: list[Update]) -> None:
    with open_people_recording(None, rig, SKELETON) as recording:
        assert type(recording) is Recording
        recording.log_tracked(0, *updates[0])
