"""Who is who in a recording of several people: detections, tracks, events and counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rrd_contents import PIXEL_TOLERANCE, camera, entities, rows, values
from shown_people import (
    CAMERAS,
    FIRST,
    LEFT_WRIST,
    N_FRAMES,
    PLACE_M,
    POSTER_M,
    SECOND,
    SECOND_IS,
    SKELETON,
    body_m,
    class_colours,
    packed,
    state,
)

from fgpose.association.recording import Association, associate
from fgpose.geometry.camera import CameraRig
from fgpose.viewer import open_people_recording
from fgpose.viewer.rerun import palette
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    simulate_crowd,
)

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")


def test_detections_have_the_colours_of_their_people_and_others_are_grey(file: Path, rig: CameraRig) -> None:
    colours = class_colours(file)
    of = {person: packed(palette.person_colour(person)) for person in (FIRST, SECOND)}
    for c, name in enumerate(CAMERAS):
        entity = f"/world/camera/{name}/image/detections"
        points, numbers = (rows(file, entity, f"Points2D:{what}") for what in ("positions", "class_ids"))
        assert sorted(points) == list(range(N_FRAMES))
        for frame, (_, points_px) in points.items():
            expected = [(place, packed(palette.NOBODY)) for place in body_px(rig, POSTER_M, frame, c, LEFT_WRIST)]
            expected += [(place, of[FIRST]) for place in body_px(rig, PLACE_M[FIRST], frame, c)]
            if SECOND_IS[frame] == "seen":
                expected += [(place, of[SECOND]) for place in body_px(rig, PLACE_M[SECOND], frame, c)]
            if c == 1 and frame % 2:  # no image
                expected = []
            shown = [colours[number] for number in numbers[frame][1]]
            in_order = sorted(zip(np.reshape(points_px, (-1, 2)).tolist(), shown, strict=True))
            expected.sort()
            assert [colour for _, colour in in_order] == [colour for _, colour in expected]
            places_px = np.reshape([place for place, _ in in_order], (-1, 2))
            expected_px = np.reshape([place for place, _ in expected], (-1, 2))
            np.testing.assert_allclose(places_px, expected_px, atol=PIXEL_TOLERANCE)


def body_px(rig: CameraRig, place_m: tuple[float, float, float], frame: int, c: int, but: int = -1) -> list[list]:
    """Undistorted pixels of the joints of somebody in a camera, but one."""
    joints = [joint for joint in range(SKELETON.n_joints) if joint != but]
    return rig.project(body_m(place_m))[frame, c, joints].tolist()


def test_points_are_undistorted(rig: CameraRig, association: Association) -> None:
    """Else the test before could not fail: as detected, they are elsewhere."""
    (image, *_) = association.observations.by_camera["cam 1"]
    distance_px = np.linalg.norm(image.points2d_px - rig.cameras[0].undistort(image.points2d_px), axis=-1)
    assert np.nanmax(distance_px) > 1e2 * PIXEL_TOLERANCE


def test_lives_of_the_tracks(file: Path) -> None:
    assert state(file, f"/tracks/person_{FIRST}") == {0: "seen"}
    changes = {frame: now for frame, now in enumerate(SECOND_IS) if now != ("", *SECOND_IS)[frame]}
    assert state(file, f"/tracks/person_{SECOND}") == changes


def test_every_event_can_be_read_with_its_reason(file: Path, association: Association) -> None:
    from rerun.chunk import RrdReader

    (chunk,) = RrdReader(file).stream().filter(content="/events").to_chunks()
    batch = chunk.to_record_batch()
    assert len(batch) == len(association.events)
    for event, row in zip(association.events, batch.to_pylist(), strict=True):
        assert row["TextLog:text"] == [f"person {event.person} {event.what}: {event.reason}"]
        assert row["TextLog:color"] == [packed(palette.person_colour(event.person))]
        assert row["frame"] == round((event.time_s - 10.0) * 50)
        assert row["time"].total_seconds() == pytest.approx(event.time_s, abs=1e-6)  # of a Timedelta


def test_plots_count_people_and_what_is_nobodys(file: Path, association: Association) -> None:
    def plot(entity: str) -> list[float]:
        return np.concatenate(values(file, entity, "Scalars:scalars")).tolist()

    there = [1.0 + (now in ("seen", "predicted")) for now in SECOND_IS]
    assert plot("/plots/people") == there
    # One joint of the poster is the first person's: it belongs to nobody no more.
    assert plot(r"/plots/unused/cam\ 1") == [0.0] * N_FRAMES
    without_first = {person: seen for person, seen in association.people.items() if person != FIRST}
    path = file.with_name("one.rrd")
    with open_people_recording(path, association.rig, SKELETON) as recording:
        recording.log_association(replace(association, people=without_first))
    unused = np.concatenate(values(path, "/plots/unused/cam_2", "Scalars:scalars"))
    np.testing.assert_array_equal(unused, [2, 0] * (N_FRAMES // 2))


def test_a_real_association(tmp_path: Path) -> None:
    """Every detection is shown once, and as many belong to nobody as the association says."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    motion = crowd_motion(2, 100, 50.0, walks, works, seed=1)
    cameras = CameraRig((camera("cam 1", -1.5), camera("cam_2", 1.5)))
    scene = simulate_crowd(motion, cameras, DetectionNoise(), Occlusion(), CrowdErrors(), seed=1)
    found = associate(scene.observations, cameras)
    assert found.n_unused > 0
    path = tmp_path / "crowd.rrd"
    with open_people_recording(path, cameras, scene.observations.skeleton) as recording:
        recording.log_association(found)
    n_unused, n_points = 0.0, 0
    for name in CAMERAS:
        n_unused += np.sum(values(path, f"/plots/unused/{name}", "Scalars:scalars"))
        n_points += sum(map(len, values(path, f"/world/camera/{name}/image/detections", "Points2D:positions")))
    assert n_unused == found.n_unused
    assert n_points == sum(int((image.confidence > 0).sum()) for image in found.observations.images)


def test_some_cameras_of_the_rig(tmp_path: Path, rig: CameraRig, association: Association, file: Path) -> None:
    """As smooth_people leaves out those without images."""
    more = CameraRig((camera("cam_0", 0.0), *rig.cameras))
    with open_people_recording(tmp_path / "more.rrd", more, SKELETON) as recording:
        recording.log_association(association)
    for name in CAMERAS:
        where = f"/world/camera/{name}/image/detections", "Points2D:positions"
        assert rows(tmp_path / "more.rrd", *where) == rows(file, *where)
    assert "/world/camera/cam_0/image/detections" not in entities(tmp_path / "more.rrd")


def test_nobody_at_all(tmp_path: Path, rig: CameraRig, association: Association) -> None:
    path = tmp_path / "nobody.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        recording.log_association(replace(association, people={}, events=()))
    assert set(np.concatenate(values(path, "/plots/people", "Scalars:scalars"))) == {0.0}
    shown = values(path, "/world/camera/cam_2/image/detections", "Points2D:class_ids")
    assert {class_colours(path)[number] for number in np.concatenate(shown)} == {packed(palette.NOBODY)}
