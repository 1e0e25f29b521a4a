"""The Rerun recordings of several people: read back without a viewer, a window or a browser."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rrd_contents import METRE_TOLERANCE, PIXEL_TOLERANCE, camera, entities, rows, static_value, values, view_origins

from fgpose.association.recording import Association, associate
from fgpose.association.track import TrackEvent
from fgpose.frame_matching import NO_IMAGE, MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.skeletons import load_skeleton
from fgpose.people import NOBODY, Detections, PeopleObservations, Seen
from fgpose.synthetic import CrowdErrors, DetectionNoise, Occlusion, crowd_motion, embedded_motion, simulate_crowd
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import PeopleRecording, open_people_recording, palette

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")

N_FRAMES = 12
SKELETON = load_skeleton("coco_17")
LEFT_WRIST = SKELETON.index("left_wrist")
LEFT_ELBOW = SKELETON.index("left_elbow")
CAMERAS = (r"cam\ 1", "cam_2")
# Of the people; the second is there in frames 2 to 8, not detected in 4, and away in 6.
FIRST, SECOND = 3, 5
SECOND_FRAMES = slice(2, 9)
SECOND_IS = ("", "", "seen", "seen", "predicted", "seen", "away", "seen", "seen", "", "", "")
PLACE_M = {FIRST: (-0.5, 0.0, 1.0), SECOND: (0.6, 0.4, 1.0)}
POSTER_M = (0.1, 1.5, 1.2)


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return CameraRig((camera("cam 1", -0.5), camera("cam_2", 0.5)))


def time_s() -> np.ndarray:
    return 10.0 + np.arange(N_FRAMES) / 50


def body_m(place_m: tuple[float, float, float]) -> np.ndarray:
    """(T, J, 3) of somebody who moves a little."""
    rng = np.random.default_rng(0)
    start_m = rng.uniform(-0.3, 0.3, (SKELETON.n_joints, 3)) + np.array(place_m)
    return start_m + np.linspace(0, 0.1, N_FRAMES)[:, None, None]


@pytest.fixture(scope="module")
def association(rig: CameraRig) -> Association:
    """In every image a poster, then the second person if detected, then the first, whose left wrist has been given to
    the poster. The second camera has an image of every other frame only."""
    everywhere_px = {place: rig.project(body_m(place)) for place in (POSTER_M, *PLACE_M.values())}
    images, image_of = [], np.full((N_FRAMES, 2), NO_IMAGE)
    of_first, of_second = (Seen.nothing(N_FRAMES, 2, SKELETON.n_joints) for _ in range(2))
    for c, seen_by in enumerate(rig.cameras):
        for number, frame in enumerate(range(0, N_FRAMES, 1 + c)):
            poster_px, first_px, second_px = (everywhere_px[p][frame, c].copy() for p in everywhere_px)
            poster_px[LEFT_WRIST], first_px[LEFT_WRIST] = first_px[LEFT_WRIST], np.nan
            is_second_there = SECOND_IS[frame] == "seen"
            people_px = np.stack([poster_px, second_px, first_px] if is_second_there else [poster_px, first_px])
            confidence = np.isfinite(people_px).all(axis=-1).astype(float)
            images.append(Detections(seen_by.name, time_s()[frame], seen_by.distort(people_px), confidence))
            image_of[frame, c] = number
            of_first.detection[frame, c] = len(people_px) - 1
            of_first.detection[frame, c, LEFT_WRIST] = 0
            of_second.detection[frame, c] = 1 if is_second_there else NOBODY
    of_first.joint[:] = of_second.joint[:] = np.arange(SKELETON.n_joints)
    second = Seen(SECOND_FRAMES.start, of_second.detection[SECOND_FRAMES], of_second.joint[SECOND_FRAMES])
    events = (
        TrackEvent(10.0, FIRST, "confirmed", "cam 1, cam_2 agree"),
        TrackEvent(10.04, SECOND, "confirmed", "cam 1, cam_2 agree"),
        TrackEvent(10.12, SECOND, "lost", "not detected for 0.02 s"),
        TrackEvent(10.14, SECOND, "found again", "cam 1 agrees"),
    )
    observations = PeopleObservations(SKELETON, rig.names, tuple(images), MatchedFrames(time_s(), image_of))
    return Association(observations, rig, {FIRST: of_first, SECOND: second}, events)


@pytest.fixture(scope="module")
def second(rig: CameraRig) -> Trajectory:
    """Of the second person: nothing is known in the third of their frames, and the left elbow is predicted at last."""
    positions_m = body_m(PLACE_M[SECOND])[SECOND_FRAMES].copy()
    positions_m[2] = np.nan
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    status[2] = Status.UNOBSERVABLE
    status[-1, LEFT_ELBOW] = Status.PREDICTED
    covariance_m2 = np.where(np.isfinite(positions_m[..., None]), 1e-4 * np.eye(3), np.nan)
    detected_px = rig.project(positions_m) + np.array([3.0, 4.0])
    detected_px[0, 0] += np.array([3.0, 4.0])
    residual_px = reprojection_residual_px(detected_px, rig, positions_m)
    return Trajectory(SKELETON, time_s()[SECOND_FRAMES], positions_m, status, covariance_m2, residual_px, rig.names)


@pytest.fixture(scope="module")
def file(
    tmp_path_factory: pytest.TempPathFactory, rig: CameraRig, association: Association, second: Trajectory
) -> Path:
    path = tmp_path_factory.mktemp("people") / "people.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        assert not path.exists()
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    return path


def packed(colour: palette.Colour) -> int:
    """As Rerun stores it: 0xRRGGBBAA."""
    red, green, blue = colour
    return (red << 24) + (green << 16) + (blue << 8) + 255


def classes(path: Path) -> dict[int, dict[str, Any]]:
    """Of annotations, by number: what is shown is the context that was logged last."""
    from rerun.chunk import RrdReader

    (chunk,) = RrdReader(path).stream().filter(content="/").to_chunks()
    contexts = chunk.to_record_batch()["AnnotationContext:context"].to_pylist()
    return {each["class_id"]: each["class_description"] for each in contexts[-1][0]}


def class_colours(path: Path) -> dict[int, int]:
    """Colour of the points of each class."""
    colours = {}
    for number, description in classes(path).items():
        (colours[number],) = {joint["color"] for joint in description["keypoint_annotations"]}
    return colours


def state(path: Path, entity: str) -> dict[int, str]:
    return {frame: found for frame, (_, [found]) in rows(path, entity, "StateChange:state").items()}


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


SHOWN = (
    (f"/world/person_{SECOND}/joints", "Points3D:positions"),
    (f"/world/person_{SECOND}/bones", "LineStrips3D:strips"),
    (f"/world/person_{SECOND}/covariance", "Ellipsoids3D:centers"),
    (f"/world/person_{SECOND}/label", "Points3D:positions"),
    *((f"/world/camera/{name}/image/reprojections/person_{SECOND}", "Points2D:positions") for name in CAMERAS),
)


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
    assert static_value(tmp_path / "up.rrd", f"/world/person_{SECOND}/label", "Points3D:labels") == str(SECOND)


def test_the_same_colour_everywhere(file: Path) -> None:
    colour, pale = (packed(each(palette.person_colour(SECOND))) for each in (lambda same: same, palette.faded))
    name = f"person_{SECOND}"
    of_class = class_colours(file)
    joints = static_value(file, f"/world/{name}/joints", "Points3D:class_ids")
    assert of_class[joints] == colour
    for camera_name in CAMERAS:
        reprojections = f"/world/camera/{camera_name}/image/reprojections/{name}"
        assert of_class[static_value(file, reprojections, "Points2D:class_ids")] == colour
    assert static_value(file, f"/plots/reprojection_px/{name}", "SeriesLines:colors") == colour
    assert static_value(file, f"/tracks/{name}", "StateConfiguration:colors") == colour
    assert static_value(file, f"/world/{name}/label", "Points3D:colors") == colour
    # In the last frame the elbow is predicted, and paler and thinner are its joint and its bones.
    predicted = np.arange(SKELETON.n_joints) == LEFT_ELBOW
    colours, radii = (rows(file, f"/world/{name}/joints", f"Points3D:{what}")[8][1] for what in ("colors", "radii"))
    assert colours == np.where(predicted, pale, colour).tolist()
    assert np.array(radii)[predicted].max() < np.array(radii)[~predicted].min()
    bones = rows(file, f"/world/{name}/bones", "LineStrips3D:colors")[8][1]
    assert bones == [pale if LEFT_ELBOW in bone else colour for bone in (*SKELETON.bones, *SKELETON.lines)]


def test_bones_join_what_was_estimated_and_not_what_was_detected(file: Path) -> None:
    known = classes(file)
    reprojected = static_value(file, SHOWN[-1][0], "Points2D:class_ids")
    assert len(known[reprojected]["keypoint_connections"]) == len((*SKELETON.bones, *SKELETON.lines))
    detected = rows(file, "/world/camera/cam_2/image/detections", "Points2D:class_ids")[2][1]
    assert len(set(detected)) == 3
    assert not any(known[number]["keypoint_connections"] for number in detected)


# Linear RGB as people without the long, middle or short cones see it (Machado, Oliveira and Fernandes, 2009, severity
# 1), and as others do.
VISION = {
    "trichromat": np.eye(3),
    "protanope": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranope": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanope": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


@pytest.mark.parametrize("vision", VISION)
def test_eight_people_and_nobody_can_be_told_apart_by_colour(vision: str) -> None:
    colours = [palette.person_colour(person) for person in range(8)] + [palette.NOBODY, palette.BACKGROUND]
    srgb = np.array(colours) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ VISION[vision].T, 0, 1).astype(np.float32)
    lab = cv2.cvtColor(seen[None], cv2.COLOR_LRGB2Lab)[0]
    # Two patches side by side differ visibly from 2.3 on (Mahy et al., 1994); small points need much more.
    assert min(np.linalg.norm(a - b) for a, b in combinations(lab, 2)) > 15
    assert [palette.person_colour(person + 8) for person in range(8)] == colours[:8]


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


def n_rows(path: Path, entity: str) -> int:
    from rerun.chunk import RrdReader

    batches = [chunk.to_record_batch() for chunk in RrdReader(path).stream().filter(content=entity).to_chunks()]
    return sum(len(batch) for batch in batches if "frame" in batch.schema.names)


def test_layout_shows_whoever_comes(file: Path) -> None:
    origins = view_origins(file)
    assert origins["2D"] == {f"/world/camera/{name}/image" for name in CAMERAS}
    assert origins["3D"] == {"/world"}
    assert origins["TextLog"] == {"/events"}
    assert origins["StateTimeline"] == {"/tracks", "/status"}
    assert origins["TimeSeries"] == {"/plots/reprojection_px", "/plots/people", "/plots/unused"}
    shown = entities(file)
    for where in set().union(*origins.values()):
        assert any(entity == where or entity.startswith(f"{where}/") for entity in shown), where


def test_live_file_is_the_same_although_nobody_watches(
    tmp_path: Path, rig: CameraRig, association: Association, second: Trajectory, file: Path
) -> None:
    path = tmp_path / "live.rrd"
    with open_people_recording(path, rig, SKELETON, live=True, port=0) as recording:
        assert recording.viewer_url is not None
        assert "127.0.0.1" in recording.viewer_url
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    assert recording.viewer_url is None
    for entity, component in (*SHOWN, ("/world/camera/cam_2/image/detections", "Points2D:class_ids")):
        assert rows(path, entity, component) == rows(file, entity, component)


def test_the_file_appears_whole_or_not_at_all(tmp_path: Path, rig: CameraRig, second: Trajectory) -> None:
    path = tmp_path / "out.rrd"
    path.write_bytes(b"old")

    def interrupted_by(error: BaseException) -> None:
        with open_people_recording(path, rig, SKELETON) as recording:
            recording.log_person(SECOND, second)
            raise error

    with pytest.raises(ZeroDivisionError):
        interrupted_by(ZeroDivisionError())
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]
    # Ctrl-C is how a live session ends.
    with pytest.raises(KeyboardInterrupt):
        interrupted_by(KeyboardInterrupt())
    assert len(values(path, *SHOWN[0])) == second.n_frames
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]


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


def test_bad_input_is_refused(tmp_path: Path, rig: CameraRig, association: Association, second: Trajectory) -> None:
    options: dict[str, Any] = {"image_width_px": 0, "jpeg_quality": 101, "image_limit_mb": -1.0, "n_frames": 0}
    for name, value in options.items():
        with pytest.raises(ValueError, match=f"{name} must be .* got {value}"):
            open_people_recording(None, rig, SKELETON, **{name: value})
    with open_people_recording(tmp_path / "a.rrd", rig.subset(["cam_2"]), SKELETON) as recording:
        with pytest.raises(ValueError, match="the calibration has no camera cam 1"):
            recording.log_association(association)
        with pytest.raises(ValueError, match="the calibration has no camera cam 1"):
            recording.log_person(SECOND, second)
        with pytest.raises(ValueError, match="counted from 0, got person -1 from frame 0 on"):
            recording.log_person(-1, second)
        with pytest.raises(ValueError, match="counted from 0, got person 5 from frame -2 on"):
            recording.log_person(SECOND, second, -2)
        nothing = Trajectory(SKELETON, np.zeros(0), np.zeros((0, 17, 3)), np.zeros((0, 17)))
        with pytest.raises(ValueError, match="the trajectory of person 5 has no frame"):
            recording.log_person(SECOND, nothing)
    with pytest.raises(ValueError, match="closed"):
        recording.log_person(SECOND, replace(second, residual_px=None))
    with open_people_recording(tmp_path / "b.rrd", rig, load_skeleton("h36m_17")) as recording:
        with pytest.raises(ValueError, match="the association has the joints of skeleton coco_17"):
            recording.log_association(association)
        with pytest.raises(ValueError, match="person 5 has the joints of skeleton coco_17"):
            recording.log_person(SECOND, second)
    # Nothing of what was refused is shown.
    assert not [each for name in ("a.rrd", "b.rrd") for each in entities(tmp_path / name) if each.startswith("/world")]


def test_recording_to_nowhere_takes_everything(rig: CameraRig, association: Association, second: Trajectory) -> None:
    with open_people_recording(None, rig, SKELETON) as recording:
        assert type(recording) is PeopleRecording
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
        assert not recording.wants_image("cam_2", 0)
        recording.log_image("cam_2", 0, 0.0, np.zeros((480, 640, 3), dtype=np.uint8))
