"""People in a recording: the static part, and the rows from arrays. A live frame is one frame of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import rerun as rr
from jaxtyping import Float, Int, UInt16

from fgpose.association.recording import Association
from fgpose.association.track import Tracked, TrackEvent, TrackState
from fgpose.correspondences import NO_IMAGE, NOBODY
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.people_observations import Detections
from fgpose.sampling import nearest
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.palette import person_colour
from fgpose.viewer.rerun.rows import Rows, change_rows, log_rows, point_rows, scalar_rows
from fgpose.viewer.rerun.scene import (
    TEXT_LOOK,
    annotation_class,
    body_rows,
    log_body_styles,
    log_cameras,
    log_line,
    over_joints_m,
)
from fgpose_factors.robust_statistics import known_medians

# Smaller than those of one person: people are smaller in the images, and may hide each other.
_DETECTION_RADIUS = rr.Radius.ui_points(2.5)


@dataclass(frozen=True, eq=False)
class OwnedDetections:
    """Everybody whom one camera detected, image by image."""

    frame: Int[np.ndarray, " detection"]
    """In which frame of the recording the detection is; increasing."""
    points2d_px: Float[np.ndarray, "detection joint 2"]
    """Pixels of the original image; NaN: not detected."""
    owner: Int[np.ndarray, "detection joint"]
    """Whose joint it is, or NOBODY."""

    @staticmethod
    def of(association: Association, camera: int) -> OwnedDetections:
        """Of one camera of the association, in all of its frames."""
        image_of = association.frames.image[:, camera]
        images = association.observations.by_camera[association.rig.names[camera]]
        shown = [(t, images[image_of[t]]) for t in np.flatnonzero(image_of != NO_IMAGE).tolist()]
        n_joints = association.observations.skeleton.n_joints
        points2d_px = np.concatenate([np.zeros((0, n_joints, 2)), *(image.points2d_px for _, image in shown)])
        frame = np.repeat([t for t, _ in shown], [image.n_people for _, image in shown]).astype(int)
        owner = np.full(points2d_px.shape[:2], NOBODY)
        for person, seen in association.people.items():
            number = seen.detection[:, camera]
            t, j = np.nonzero(number != NOBODY)
            first = np.searchsorted(frame, seen.first_frame + t)
            owner[first + number[t, j], seen.joint[t, camera, j]] = person
        return OwnedDetections(frame, points2d_px, owner)

    @staticmethod
    def nothing(n_joints: int) -> OwnedDetections:
        """Of a camera that detected nobody."""
        return OwnedDetections(np.zeros(0, dtype=int), np.zeros((0, n_joints, 2)), np.zeros((0, n_joints), dtype=int))

    @staticmethod
    def of_image(image: Detections, people: Sequence[Tracked]) -> OwnedDetections:
        """Of one image, the newest of its camera; it is in frame 0."""
        owner = np.full(image.confidence.shape, NOBODY)
        for each in people:
            if image.camera in each.seen:
                detection, joint = each.seen[image.camera]
                known = detection != NOBODY
                owner[detection[known], joint[known]] = each.person
        return OwnedDetections(np.zeros(image.n_people, dtype=int), image.points2d_px, owner)

    def thinned(self, every: int) -> OwnedDetections:
        """Of one frame in so many."""
        kept = self.frame % every == 0
        return OwnedDetections(self.frame[kept] // every, self.points2d_px[kept], self.owner[kept])

    def n_unused(self, n_frames: int) -> Int[np.ndarray, " frame"]:
        """How many detections of each frame belong to nobody."""
        return np.bincount(self.frame[(self.owner == NOBODY).all(axis=1)], minlength=n_frames)


class Presence(IntEnum):
    """Where somebody is in a frame of the recording."""

    OUTSIDE = 0
    """Before the first or after the last frame in which a camera detects them."""
    SEEN = 1
    """At least one camera detects them."""
    PREDICTED = 2
    """No camera detects them, and they are still followed."""
    AWAY = 3
    """They were lost, and will be found again."""


def presence(association: Association, person: int) -> Int[np.ndarray, " frame"]:
    """Of one person in every frame of the recording, values of Presence. Raises KeyError if there is no such person."""
    seen, time_s = association.people[person], association.frames.frame_time_s
    state = np.full(len(time_s), Presence.OUTSIDE)
    detected = (seen.detection != NOBODY).any(axis=(1, 2))
    state[seen.frames] = np.where(detected, Presence.SEEN, Presence.PREDICTED)
    lost_s = [event.time_s for event in association.events if event.person == person and event.what == "lost"]
    for lost in nearest(np.array(lost_s), time_s).tolist():
        begin = lost + int(state[lost] == Presence.SEEN)
        again = np.flatnonzero(state[begin:] == Presence.SEEN)
        if len(again):
            state[begin : begin + again[0]] = Presence.AWAY
    return state


def presence_of_tracked(tracked: Tracked) -> Presence:
    """Of somebody who is in the room, live: whether who is lost will be found again is not known."""
    return Presence.PREDICTED if tracked.state is TrackState.COASTING else Presence.SEEN


def detection_class(person: Int[np.ndarray, " point"]) -> UInt16[np.ndarray, " point"]:
    """Annotation of the detections of these people, by their colours, or of nobody: 0."""
    return np.where(person == NOBODY, 0, 1 + 2 * (person % len(palette.PEOPLE))).astype(np.uint16)


def _body_class(person: int) -> int:
    """Annotation of what was estimated of somebody: the same colour, and bones."""
    return 2 + 2 * (person % len(palette.PEOPLE))


def log_people_scene(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, up: UpAxis) -> None:
    """Everything static before there is anybody."""
    _log_annotations(stream, skeleton)
    log_cameras(stream, rig, up, [palette.PLAIN] * rig.n_cameras)
    for c, name in enumerate(rig.names):
        stream.log(paths.detections(name), rr.Points2D.from_fields(radii=_DETECTION_RADIUS), static=True)
        _log_count(stream, paths.join(paths.UNUSED, name), name, palette.camera_colour(c))
    _log_count(stream, paths.N_PEOPLE, "people", palette.PLAIN)


def _log_count(stream: rr.RecordingStream, path: str, name: str, colour: palette.Colour) -> None:
    """Name and appearance of a line that shows whole numbers."""
    steps = rr.components.InterpolationMode.StepAfter
    stream.log(path, rr.SeriesLines(names=name, colors=[colour], widths=[1.5], interpolation_mode=steps), static=True)


def _log_annotations(stream: rr.RecordingStream, skeleton: Skeleton) -> None:
    """One class for each colour: however many people come, nothing is added."""
    classes = [annotation_class(0, "nobody", palette.NOBODY, skeleton)]
    bones = (*skeleton.bones, *skeleton.lines)
    first = np.arange(len(palette.PEOPLE))
    for person, number in zip(first.tolist(), detection_class(first).tolist(), strict=True):
        name, colour = f"person {person}, {person + len(first)}, ...", palette.person_colour(person)
        classes.append(annotation_class(number, name, colour, skeleton))
        classes.append(annotation_class(_body_class(person), name, colour, skeleton, bones))
    stream.log("/", rr.AnnotationContext(classes), static=True)


def log_person_styles(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, person: int) -> None:
    """How somebody looks, wherever they are shown."""
    name, colour = paths.person(person), palette.person_colour(person)
    log_body_styles(stream, rig, skeleton, name, _body_class(person), colour)
    label = rr.Points3D.from_fields(**TEXT_LOOK)
    stream.log(paths.label(paths.person(person)), label, static=True)
    log_line(stream, paths.join(paths.REPROJECTION_PX, name), f"person {person}", colour)
    looks = {Presence.SEEN: colour, Presence.PREDICTED: palette.faded(colour), Presence.AWAY: palette.AWAY}
    lanes = rr.StateConfiguration(values=[state.name.lower() for state in looks], colors=list(looks.values()))
    stream.log(paths.join(paths.TRACKS, name), lanes, static=True)


def association_rows(association: Association, rig: CameraRig, every: int = 1) -> Iterator[Rows]:
    """Detections in every camera, how many of them are nobody's, lives of the tracks, how many people there are.

    Args:
        association: of the whole recording.
        rig: its cameras, in its order.
        every: rows are made of one frame in so many.
    """
    time_s = association.frames.frame_time_s[::every]
    for c, camera in enumerate(rig.cameras):
        yield from _camera_rows(OwnedDetections.of(association, c).thinned(every), camera, len(time_s))
    n_people = np.zeros(len(time_s))
    for person in association.people:
        state = presence(association, person)[::every]
        n_people += (state == Presence.SEEN) | (state == Presence.PREDICTED)
        yield _life_rows(person, state)
    yield scalar_rows(paths.N_PEOPLE, n_people)
    event_s = np.array([event.time_s for event in association.events])
    yield _event_rows(association.events, nearest(event_s, time_s))


def update_rows(
    images: Sequence[Detections],
    people: Sequence[Tracked],
    events: Sequence[TrackEvent],
    rig: CameraRig,
    before: Mapping[int, Presence],
    emptied: Collection[str] = (),
) -> Iterator[Rows]:
    """The same of one update of the tracker.

    Args:
        images: at most one of each camera; the other cameras stay as they were.
        people: who is there.
        events: what has happened since the update before.
        rig: the cameras.
        before: where people were in the update before.
        emptied: cameras without an image that detect nobody now.
    """
    shown = dict.fromkeys(emptied, OwnedDetections.nothing(0))
    shown |= {image.camera: OwnedDetections.of_image(image, people) for image in images}
    for camera in rig.cameras:
        if camera.name in shown:
            yield from _camera_rows(shown[camera.name], camera, 1)
    now = {each.person: presence_of_tracked(each) for each in people}
    for person in sorted({*before, *now}):
        state = np.array([now.get(person, Presence.OUTSIDE)])
        yield _life_rows(person, state, before.get(person, Presence.OUTSIDE))
    yield scalar_rows(paths.N_PEOPLE, np.array([float(len(people))]))
    yield _event_rows(events, np.zeros(len(events), dtype=int))


def _camera_rows(detections: OwnedDetections, camera: Camera, n_frames: int) -> Iterator[Rows]:
    yield _detection_rows(detections, camera, n_frames)
    n_unused = detections.n_unused(n_frames).astype(float)
    yield scalar_rows(paths.join(paths.UNUSED, camera.name), n_unused)


def picture_rows(
    detections: Detections | None, people: Sequence[Tracked], camera: Camera, gone: Collection[int] = ()
) -> Iterator[Rows]:
    """The points in one picture of a camera.

    Args:
        detections: in it, if it was used.
        people: who is estimated to be there.
        camera: that took it.
        gone: who was in the picture before, and is not in this one.
    """
    nothing = OwnedDetections.nothing(0)
    yield _detection_rows(nothing if detections is None else OwnedDetections.of_image(detections, people), camera, 1)
    for each in people:
        points_px = camera.project(each.estimate.positions_m)
        yield point_rows(paths.reprojections(camera.name, paths.person(each.person)), rr.Points2D, points_px[None])
    yield from absent_rows(gone, camera.name)


def absent_rows(people: Collection[int], camera: str) -> Iterator[Rows]:
    """These people are not in the image of a camera."""
    for person in people:
        yield point_rows(paths.reprojections(camera, paths.person(person)), rr.Points2D, np.zeros((1, 0, 2)))


def _detection_rows(detections: OwnedDetections, camera: Camera, n_frames: int) -> Rows:
    points_px = camera.undistort(detections.points2d_px)
    known = np.isfinite(points_px).all(axis=-1)
    detection, joint = np.nonzero(known)
    fields = {
        "positions": points_px[known],
        "keypoint_ids": joint.astype(np.uint16),
        "class_ids": detection_class(detections.owner[known]),
    }
    lengths = np.bincount(detections.frame[detection], minlength=n_frames)
    return Rows(paths.detections(camera.name), rr.Points2D, lengths, fields)


def _life_rows(person: int, state: Int[np.ndarray, " frame"], before: Presence = Presence.OUTSIDE) -> Rows:
    names = np.array(["", *(each.name.lower() for each in list(Presence)[1:])])
    return change_rows(paths.join(paths.TRACKS, paths.person(person)), names[state], str(names[before]))


def _event_rows(events: Sequence[TrackEvent], frames: Int[np.ndarray, " event"]) -> Rows:
    texts = [f"person {event.person} {event.what}: {event.reason}" for event in events]
    colours = [person_colour(event.person) for event in events]
    return log_rows(paths.EVENTS, texts, [event.what for event in events], colours, frames)


def person_rows(
    person: int,
    trajectory: Trajectory,
    rig: CameraRig,
    up: Float[np.ndarray, " 3"],
    before: np.ndarray | None = None,
) -> Iterator[Rows]:
    """Somebody's body, their number above it, and their reprojection error over all cameras.

    Args:
        person: their number.
        trajectory: one frame or more.
        rig: the cameras.
        up: of length 1.
        before: (J,) status in the frame before the first, if they were there.
    """
    name = paths.person(person)
    yield from body_rows(name, trajectory, rig, person_colour(person), before=before)
    label_m = over_joints_m(trajectory.positions_m, up)
    known = np.isfinite(label_m).all(axis=-1)
    is_seen = np.asarray(trajectory.observed.any(axis=1))[known]
    texts = [f"{person}" if seen else f"{person} predicted" for seen in is_seen]
    yield Rows(paths.label(name), rr.Points3D, known.astype(int), {"positions": label_m[known], "labels": texts})
    if trajectory.residual_px is not None:
        error_px = known_medians(trajectory.residual_px.reshape(trajectory.n_frames, -1))
        yield scalar_rows(paths.join(paths.REPROJECTION_PX, name), error_px)


def absent(trajectory: Trajectory) -> Trajectory:
    """One frame of the same person in which they are not there: nothing is known, and nothing is missing."""
    skeleton, n_joints = trajectory.skeleton, trajectory.skeleton.n_joints
    has_covariance, has_residuals = trajectory.covariance_m2 is not None, trajectory.residual_px is not None
    return Trajectory(
        skeleton=skeleton,
        time_s=trajectory.time_s[-1:],
        positions_m=np.full((1, n_joints, 3), np.nan),
        status=np.full((1, n_joints), Status.OBSERVED),
        covariance_m2=np.full((1, n_joints, 3, 3), np.nan) if has_covariance else None,
        residual_px=np.full((1, len(trajectory.camera_names), n_joints), np.nan) if has_residuals else None,
        camera_names=trajectory.camera_names,
    )
