"""Two people and a poster, as cameras detect them, and what a Rerun file says of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rrd_contents import rows

from fgpose.association.recording import Association
from fgpose.association.track import Tracked, TrackEvent, TrackState
from fgpose.correspondences import NO_IMAGE, NOBODY, MatchedFrames, Seen
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.trajectory import Estimate, Status, Trajectory
from fgpose.viewer.rerun import palette

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

Update = tuple[list[Detections], list[Tracked], list[TrackEvent]]
"""Images, people and events: what a tracker is given, and what it returns."""


def time_s() -> np.ndarray:
    return 10.0 + np.arange(N_FRAMES) / 50


def body_m(place_m: tuple[float, float, float]) -> np.ndarray:
    """(T, J, 3) of somebody who moves a little."""
    rng = np.random.default_rng(0)
    start_m = rng.uniform(-0.3, 0.3, (SKELETON.n_joints, 3)) + np.array(place_m)
    return start_m + np.linspace(0, 0.1, N_FRAMES)[:, None, None]


def association_of(rig: CameraRig) -> Association:
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


def second_person(rig: CameraRig) -> Trajectory:
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


def first_person() -> Trajectory:
    status = np.full((N_FRAMES, SKELETON.n_joints), Status.OBSERVED)
    return Trajectory(SKELETON, time_s(), body_m(PLACE_M[FIRST]), status)


def estimate_of(trajectory: Trajectory, frame: int) -> Estimate:
    covariance_m2, residual_px = trajectory.covariance_m2, trajectory.residual_px
    return Estimate(
        skeleton=SKELETON,
        frame=frame,
        time_s=float(trajectory.time_s[frame]),
        positions_m=trajectory.positions_m[frame],
        status=trajectory.status[frame],
        covariance_m2=None if covariance_m2 is None else covariance_m2[frame],
        residual_px=None if residual_px is None else residual_px[frame],
    )


def updates_of(association: Association, first: Trajectory, second: Trajectory) -> list[Update]:
    """Of every frame; the second person coasts where no camera detects them."""
    trajectories = {FIRST: (0, first), SECOND: (SECOND_FRAMES.start, second)}
    by_camera, names = association.observations.by_camera, association.rig.names
    made = []
    for frame, image_of in enumerate(association.frames.image.tolist()):
        images = [by_camera[name][i] for name, i in zip(names, image_of, strict=True) if i != NO_IMAGE]
        people = []
        for person, (begin, trajectory) in trajectories.items():
            if 0 <= frame - begin < trajectory.n_frames:
                seen = association.people[person]
                of_camera = zip(names, seen.detection[frame - begin], seen.joint[frame - begin], strict=True)
                shown = {name: (own, joint) for name, own, joint in of_camera if (own != NOBODY).any()}
                now = TrackState.CONFIRMED if shown else TrackState.COASTING
                people.append(Tracked(person, now, estimate_of(trajectory, frame - begin), shown))
        events = [event for event in association.events if round((event.time_s - 10.0) * 50) == frame]
        made.append((images, people, events))
    return made


SHOWN = (
    (f"/world/person_{SECOND}/joints", "Points3D:positions"),
    (f"/world/person_{SECOND}/bones", "LineStrips3D:strips"),
    (f"/world/person_{SECOND}/covariance", "Ellipsoids3D:centers"),
    (f"/world/person_{SECOND}/label", "Points3D:positions"),
    *((f"/world/camera/{name}/image/reprojections/person_{SECOND}", "Points2D:positions") for name in CAMERAS),
)


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


def n_rows(path: Path, entity: str) -> int:
    from rerun.chunk import RrdReader

    batches = [chunk.to_record_batch() for chunk in RrdReader(path).stream().filter(content=entity).to_chunks()]
    return sum(len(batch) for batch in batches if "frame" in batch.schema.names)
