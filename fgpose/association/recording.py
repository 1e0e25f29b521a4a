"""Who is who in a whole recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.detectability import repeats
from fgpose.association.follow import Follower
from fgpose.association.identity.exchange import Settled, Together
from fgpose.association.identity.likeness import Passage
from fgpose.association.identity.lost import EverybodyLost, links
from fgpose.association.identity.sides import Turned
from fgpose.association.matching import Moment, follow
from fgpose.association.pose_filter import PoseFilters
from fgpose.association.track import TrackEvent
from fgpose.correspondences import NO_IMAGE, NOBODY, MatchedFrames, Seen, SeenInImage
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.parameters import TrackingConfig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.shown import Shown
from fgpose.skeleton import Skeleton

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of frames in all."""

# Who is not detected for so long is not followed farther back: one camera alone does not tell the distance, and what it
# shows after a gap may be somebody else.
_GAP_S = 0.2
_SETTLED = (Settled.EXCHANGED.value, Settled.KEPT.value)
# What is said of two for the time being, or says nothing that results do not.
_DOUBTS = (Settled.PERHAPS.value, Settled.KEPT.value)


@dataclass(frozen=True, eq=False, repr=False)
class Association(Shown):
    """Who is who in a recording."""

    observations: PeopleObservations
    rig: CameraRig
    people: Mapping[int, Seen]
    """By the number of the person, those seen most first."""
    events: tuple[TrackEvent, ...]
    """Every change in the life of a track, and why, in the order of time."""
    _passages: Mapping[int, tuple[Passage, ...]] = field(default_factory=dict, repr=False)
    """When and where each of them came and was lost, and what is known of their bodies."""

    def of(self, person: int) -> Observations:
        """What the cameras saw of one person, from the first to the last frame in which any saw them.

        Raises:
            KeyError: there is no such person.
        """
        return self.observations.of_person(self.people[person])

    @property
    def frames(self) -> MatchedFrames:
        """Which images belong together."""
        return self.observations.frames

    @property
    def why_nobody(self) -> str:
        """What is known of the reason, where nobody is found."""
        n_showing = self.observations.n_showing
        together = np.count_nonzero(n_showing >= min(2, self.rig.n_cameras))
        if not n_showing.any():
            return "no camera shows anybody in any image"
        if not together:
            return "no two cameras show somebody at the same time"
        return (
            f"no two cameras agree on anybody, although two or more show somebody in {together} of {len(n_showing)} "
            "frames"
        )

    @cached_property
    def repeated(self) -> tuple[Bool[np.ndarray, "frame camera"], Bool[np.ndarray, "frame camera"]]:
        """Which images show exactly what the one before of their camera does, and which show somebody after another."""
        same, judged = np.zeros((2, *self.frames.image.shape), dtype=bool)
        for c in range(same.shape[1]):
            before: Detections | None = None
            for frame in np.flatnonzero(self.frames.image[:, c] != NO_IMAGE).tolist():
                image = self.observations.image(frame, c)
                judged[frame, c] = before is not None and image.n_people > 0
                same[frame, c] = before is not None and repeats(image, before)
                before = image
        return same, judged

    @cached_property
    def n_unused(self) -> int:
        """How many detections belong to nobody."""
        used = [np.zeros((0, 3), dtype=int)]
        for seen in self.people.values():
            t, c, j = np.nonzero(seen.detection != NOBODY)
            used.append(np.unique(np.stack([seen.first_frame + t, c, seen.detection[t, c, j]], axis=-1), axis=0))
        return sum(image.n_people for image in self.observations.images) - len(np.unique(np.concatenate(used), axis=0))


def associate(
    observations: PeopleObservations,
    rig: CameraRig,
    config: TrackingConfig | None = None,
    progress: Progress | None = None,
) -> Association:
    """Follow everybody through all images of a recording.

    Images of different cameras that belong together make a frame (see PeopleObservations.frames), each at its own time.

    Args:
        observations: of the rig's cameras, or some of them.
        rig: the cameras.
        config: how people are told apart.
        progress: told after every frame.

    Raises:
        ValueError: a camera of the observations is not in the rig.
    """
    recording = _Frames(rig.subset(observations.camera_names), observations.frames, observations.by_camera)
    lost = EverybodyLost()
    follower = Follower(recording.rig, observations.skeleton, config, lost, looks_back=True)
    seen: dict[int, list[SeenInImage]] = {}
    first: dict[int, tuple[int, PoseFilters]] = {}
    confirmed: dict[int, int] = {}
    for frame in range(len(recording)):
        _, images = recording[frame]
        for sighting in follower.see(images):
            c = recording.rig.names.index(sighting.image.camera)
            first = {begun.track: (frame, begun.pose) for begun in sighting.begun} | first
            for track, detection, joint in sighting.joints():
                seen.setdefault(track, []).append((frame, c, detection, joint))
        confirmed |= follower.person_of_track
        while follower.exchanged:
            _put_right(seen, follower.exchanged.pop().together, recording.frames.frame_time_s)
        while follower.turned:
            _turn_round(seen, first, *follower.turned.pop(), recording, observations.skeleton.mirror)
        if progress:
            progress(frame + 1, len(recording))
    follower.finish()
    person_of, events, passages = _recognised(follower, confirmed | follower.person_of_track, lost)
    # Who was founded on images of frames before has no image of the first.
    first = {track: first[track] for track in person_of if track in first}
    used = {(t, c, int(p)) for own in seen.values() for t, c, detection, _ in own for p in detection}
    for track, image in _looked_back(recording, used, first, observations.skeleton):
        seen.setdefault(track, []).append(image)
    by_person: dict[int, list[SeenInImage]] = {}
    for track, person in person_of.items():
        by_person.setdefault(person, []).extend(seen.get(track, []))
    people = {person: Seen.of_images(own, recording.rig.n_cameras) for person, own in by_person.items() if own}
    ordered = dict(sorted(people.items(), key=lambda item: -total_confidence(observations, item[1])))
    return Association(observations, recording.rig, ordered, tuple(events), passages)


def _put_right(
    seen: dict[int, list[SeenInImage]], together: Together, frame_time_s: Float[np.ndarray, " frame"]
) -> None:
    """Exchange what is seen of two since they could least be told apart."""
    since = int(np.searchsorted(frame_time_s, together.unclear_s))
    one, other = (track.number for track in together.tracks)
    before, after = (
        [[each for each in seen.get(n, []) if (each[0] < since) is early] for n in (one, other)]
        for early in (True, False)
    )
    seen[one], seen[other] = before[0] + after[1], before[1] + after[0]


def _turn_round(
    seen: dict[int, list[SeenInImage]],
    first: dict[int, tuple[int, PoseFilters]],
    track: int,
    since_s: float,
    turned: Turned,
    recording: _Frames,
    mirror: Int[np.ndarray, " joint"],
) -> None:
    """Call left right, and vice versa, in what some cameras show of somebody since then, and in the pose in which they
    were founded."""
    since = int(np.searchsorted(recording.frames.frame_time_s, since_s))
    cameras = {recording.rig.names.index(name) for name in turned.cameras}
    seen[track] = [
        (frame, c, detection[mirror], joint[mirror])
        if frame >= since and c in cameras
        else (frame, c, detection, joint)
        for frame, c, detection, joint in seen.get(track, [])
    ]
    if turned.are_all and track in first and first[track][0] >= since:
        begun, pose = first[track]
        first[track] = begun, pose.exchanged(mirror)


def _without_doubts(events: Sequence[TrackEvent]) -> list[TrackEvent]:
    """Of people who were together what is known in the end."""
    settled = {(event.person, event.beside): event.time_s for event in events if event.what in _SETTLED}
    return [
        event
        for event in events
        if event.what not in _DOUBTS or event.time_s > settled.get((event.person, event.beside), -np.inf)
    ]


def _recognised(
    follower: Follower, person_of_track: Mapping[int, int], lost: EverybodyLost
) -> tuple[dict[int, int], list[TrackEvent], dict[int, tuple[Passage, ...]]]:
    """Who each track is, once it is known who comes back, all that has happened to them, in the order of time, and when
    each person was there."""
    tracks = [*lost.tracks, *(track for track in follower.tracks if track.is_confirmed)]
    passages = {track.person: track.passage for track in tracks}
    identity = {person: person for person in person_of_track.values()}
    events = _without_doubts(follower.events)
    lost.builds.learn_between(list(passages.values()))
    for link in links(passages, lost.room.area_m2, lost.builds):
        identity[link.after] = identity[link.before]
        begin_s = passages[link.after].begin_s
        away_s = begin_s - passages[link.before].end_s
        reason = f"away for {away_s:.1f} s, log odds of place and bones {link.log_odds:.1f}"
        events.append(TrackEvent(begin_s, link.after, "recognised", reason))
    known = [replace(event, person=identity.get(event.person, event.person)) for event in events]
    known.sort(key=lambda event: event.time_s)
    of_person: dict[int, tuple[Passage, ...]] = {}
    for number, passage in passages.items():
        person = identity.get(number, number)
        of_person[person] = (*of_person.get(person, ()), passage)
    return {track: identity[person] for track, person in person_of_track.items()}, known, of_person


def total_confidence(observations: PeopleObservations, seen: Seen) -> float:
    """Sum over all joints that were seen of somebody."""
    total = 0.0
    for t, c in np.argwhere((seen.detection != NOBODY).any(axis=-1)).tolist():
        image = observations.image(seen.first_frame + t, c)
        known = seen.detection[t, c] != NOBODY
        total += float(image.confidence[seen.detection[t, c, known], seen.joint[t, c, known]].sum())
    return total


@dataclass(frozen=True, eq=False)
class _Frames:
    """The frames of a recording."""

    rig: CameraRig
    frames: MatchedFrames
    images: dict[str, list[Detections]]

    def __len__(self) -> int:
        return len(self.frames.image)

    def __getitem__(self, frame: int) -> tuple[list[int], list[Detections]]:
        """Numbers of the cameras that have an image, and the images."""
        image_of = self.frames.image[frame]
        cameras = np.flatnonzero(image_of != NO_IMAGE).tolist()
        return cameras, [self.images[self.rig.names[c]][image_of[c]] for c in cameras]

    def free(self, frame: int, used: set[tuple[int, int, int]]) -> Moment:
        """The detections of a frame that are nobody's."""
        cameras, images = self[frame]
        moment = Moment.of(images, self.rig)
        numbers = range(moment.points_px.shape[1])
        taken = [[(frame, c, p) in used for p in numbers] for c in cameras]
        return moment.without(np.array(taken, dtype=bool).reshape(len(cameras), len(numbers)))


def _looked_back(
    recording: _Frames,
    used: set[tuple[int, int, int]],
    first: Mapping[int, tuple[int, PoseFilters]],
    skeleton: Skeleton,
) -> Iterator[tuple[int, SeenInImage]]:
    """Follow people back from where they were first found, to where one camera alone sees them: by track, what shows
    them in images before.

    Args:
        recording: its frames.
        used: frame, camera and number of the detections that are somebody's.
        first: of each track the frame in which it begins, and the pose then.
        skeleton: the joints.
    """
    poses: dict[int, PoseFilters] = {}
    seen_s: dict[int, float] = {}
    for frame in reversed(range(len(recording))):
        cameras, _ = recording[frame]
        if not cameras:
            continue
        moment = recording.free(frame, used)
        now_s = -float(moment.times_s.min())
        poses = {track: pose for track, pose in poses.items() if now_s - seen_s[track] <= _GAP_S}
        if poses:
            backwards = replace(moment, times_s=-moment.times_s)
            tracks, there = list(poses), np.ones(len(poses))
            people, matches = follow(PoseFilters.stacked(list(poses.values())), there, backwards, skeleton.mirror)
            poses = {track: people[k : k + 1] for k, track in enumerate(tracks)}
            for c, k in np.argwhere((matches.detection != NOBODY).any(axis=-1)).tolist():
                seen_s[tracks[k]] = now_s
                yield tracks[k], (frame, cameras[c], matches.detection[c, k], matches.joint[c, k])
        begun = {track: pose.reversed for track, (at, pose) in first.items() if at == frame}
        poses, seen_s = poses | begun, seen_s | dict.fromkeys(begun, now_s)
