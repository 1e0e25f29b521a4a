"""Following everybody through all views, image by image, each at its own time.

Detections are given to the people whose predicted pose they fit best (matching.py); where several cameras agree on a
body that is nobody's, or one tells how far it is, somebody new is followed (founding.py). Whether somebody is there at
all is decided by a sequential probability ratio test (Wald 1945): each image in which they should be seen tells for or
against them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from fgpose.association.detectability import Blind, FrozenCameras, detection_probability
from fgpose.association.founding import MAX_GAIN, Founded, found, found_alone
from fgpose.association.identity.appearance import MeanAppearance, Resemblance
from fgpose.association.identity.exchange import Encounters, Finding, Settled
from fgpose.association.identity.likeness import Builds, Likeness, Passage
from fgpose.association.identity.lost import Lost
from fgpose.association.identity.sides import Shown, Sides, Turned, turned
from fgpose.association.likelihood import padded
from fgpose.association.matching import Matches, Moment, follow
from fgpose.association.pose_filter import PoseFilters
from fgpose.association.sighting import NewPerson, Sighting
from fgpose.association.track import (
    COASTING_S,
    SAME_MOMENT_S,
    Track,
    TrackEvent,
    TrackState,
    at_one_place,
    tell_apart,
    whose,
)
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.parameters import TrackingConfig
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

# Log of the probability that all cameras miss somebody who is there, at which they are taken to have gone.
_GONE = np.log(1e-3)
# Odds of somebody who is tentative, and time without a detection, at which they are given up.
_HARDLY, _TENTATIVE_S = -2.0, 0.2
# Two tracks that stay at one place for this long are one person, found twice; unless they were seen apart.
_ONE_BODY_S = 0.3


class Follower:
    """Follows everybody; see the module.

    With one camera alone that does not tell it, the distance of people is a guess by their size: where they are in its
    image is followed.

    Args:
        rig, skeleton: of the images.
        config: None: the default.
        lost: who was lost before; None: nobody.
        looks_back: whether what is found to be exchanged is put right from when it was: numbers of people, sides.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        config: TrackingConfig | None = None,
        lost: Lost | None = None,
        *,
        looks_back: bool = False,
    ) -> None:
        self.rig, self._skeleton, self._config = rig, skeleton, config or TrackingConfig()
        self._n_agreeing = min(2, rig.n_cameras)
        """So many cameras must agree on somebody of whom none tells the distance."""
        self.tracks: list[Track] = []
        self.events: list[TrackEvent] = []
        self._free: dict[str, Moment] = {}
        """Of each camera the detections in its newest image that are nobody's, or of somebody whom it alone shows."""
        self._of_one_view: dict[str, dict[int, Track]] = {}
        """By camera, who the latter are, by the number of the detection."""
        self._n_tracks = self.n_people = 0
        self._lost = Lost(self._config.forget_s) if lost is None else lost
        self._encounters, self._looks_back = Encounters(self._lost.builds), looks_back
        self.exchanged: list[Finding] = []
        """Who got the numbers of before again; of who looks back."""
        self._shown: list[Shown] = []
        """The newest images."""
        self.turned: list[tuple[int, float, Turned]] = []
        """Numbers of tracks whose left was called right, and since when; of who looks back."""
        self.resemblance = Resemblance()
        self._blind, self._frozen = Blind(rig.names), FrozenCameras()
        self.person_of_track: dict[int, int] = {}
        """Who each track is that is confirmed, or has ended with the newest images; people are counted from 0 as they
        are confirmed."""

    @property
    def passages(self) -> dict[int, Passage]:
        """Of everybody who is confirmed, or was lost and is not forgotten, by number."""
        of = self._lost.passage_of
        return self._lost.passages | {track.person: of(track) for track in self.tracks if track.is_confirmed}

    @property
    def lost(self) -> Collection[int]:
        """Numbers of those who were lost and are not forgotten."""
        return self._lost.passages.keys()

    @property
    def builds(self) -> Builds:
        """How far lengths that are measured lie apart."""
        return self._lost.builds

    def go_on(self, n_people: int, passages: Mapping[int, Passage], resemblance: Resemblance) -> None:
        """Know what another follower has left: so many numbers were given, and these people may come back."""
        self.n_people, self.resemblance = n_people, resemblance
        self._lost.remember(passages)

    def see(self, images: Sequence[Detections]) -> list[Sighting]:
        """Take the next images, and say whom each shows that is not the one before again.

        Images of one call are taken to be of about one moment; of one camera there is at most one.
        """
        given, images = images, self._frozen.without(images)
        if not images:
            if given:
                self._age(given[-1].time_s)
            return []
        moment = Moment.of(images, self.rig)
        tracks = np.array([track.number for track in self.tracks], dtype=int)
        self.person_of_track = {track.number: track.person for track in self.tracks if track.is_confirmed}
        matches = self._match(moment)
        tell_apart(self.tracks, matches.chosen != NOBODY)
        self._look(images, matches)
        self._offer(moment, matches)
        begun = self._found(moment.time_s)
        self._age(moment.time_s)
        return [Sighting(image, tracks, matches, c, tuple(begun[image.camera])) for c, image in enumerate(images)]

    def is_provisional(self, track: Track, now_s: float) -> bool:
        """Whether somebody who is confirmed may still be recognised as one of those who were lost, was and not for
        certain, or may have been exchanged with somebody."""
        may_be_recognised = len(self._lost) > 0 and track.may_be_recognised(now_s)
        return may_be_recognised or self._lost.is_claimed(track) or self._encounters.is_open(track)

    def finish(self) -> None:
        """No image follows: who is tentative is taken for real, for nothing has told against them."""
        for track in self.tracks:
            if track.state is TrackState.TENTATIVE and track.score >= 0 and not track.near_s:
                self._confirm(track, track.seen_s)
        for finding in self._encounters.finish():
            self._settle(finding, finding.together.until_s)

    def _match(self, moment: Moment) -> Matches:
        """Give the detections to those who are followed, and let these follow them."""
        if not self.tracks:
            return Matches.nobody(*moment.points_px.shape[:3])
        exists = np.array([self._exists(track) for track in self.tracks])
        people = PoseFilters.stacked([track.pose for track in self.tracks])
        people, matches = follow(people, exists, moment, self._skeleton.mirror)
        self._score(people, matches, moment)
        self._put_sides_right(moment, matches)
        return matches

    def _put_sides_right(self, moment: Moment, matches: Matches) -> None:
        """Of those whose left images have called right for most of the time."""
        now_s, recent_s = moment.time_s, moment.time_s - SAME_MOMENT_S
        self._shown = [each for each in self._shown if each.moment.time_s > recent_s]
        self._shown.append(Shown(moment, matches, [track.number for track in self.tracks]))
        for track in self.tracks:
            other = turned(self._shown, track.number, self.rig, self._skeleton)
            track.sides.told(now_s, are_wrong=other is not None)
            if other is None or not track.sides.are_wrong:
                continue
            since_s, track.pose, track.sides = track.sides.since_s, other.pose, Sides(recent_s)
            if self._looks_back:
                self.turned.append((track.number, since_s, other))
            elif track.is_confirmed:
                self._note(now_s, track, "sides exchanged", f"since {since_s:.2f} s, by {', '.join(other.cameras)}")

    def _exists(self, track: Track) -> float:
        """Probability that somebody is there."""
        return 1.0 if track.is_confirmed else 1 / (1 + np.exp(self._confirm_score - track.score))

    @property
    def _confirm_score(self) -> float:
        """At worst somebody is founded in vain in every second."""
        return np.log(3600.0 / self._config.false_tracks_per_hour)

    def _look(self, images: Sequence[Detections], matches: Matches) -> None:
        for c, image in enumerate(images):
            if image.appearance is not None:
                for track, chosen in zip(self.tracks, matches.chosen[c].tolist(), strict=True):
                    if chosen != NOBODY:
                        track.likeness.looks.add(image.appearance[chosen])

    def _offer(self, moment: Moment, matches: Matches) -> None:
        """The detections on which cameras may agree."""
        drifting = np.array([track.drifts(moment.time_s) for track in self.tracks], dtype=bool)
        offered = matches.is_free
        for c, name in enumerate(moment.cameras.names):
            shown = np.flatnonzero((matches.chosen[c] != NOBODY) & drifting).tolist()
            self._of_one_view[name] = {int(matches.chosen[c, k]): self.tracks[k] for k in shown}
            offered[c, list(self._of_one_view[name])] = True
        free = moment.without(~offered)
        self._free |= {name: free.of_camera(c) for c, name in enumerate(moment.cameras.names)}

    def _score(self, people: PoseFilters, matches: Matches, moment: Moment) -> None:
        probability = detection_probability(people, people, moment.cameras)
        self._blind.learn(moment.cameras.names, moment.times_s, probability, matches.chosen.T != NOBODY)
        missed = self._blind.log_missed(moment.cameras.names, probability, sum(t.is_confirmed for t in self.tracks))
        shows = matches.chosen != NOBODY
        gain = np.where(shows, np.minimum(matches.gain, MAX_GAIN), missed.T)
        for k, track in enumerate(self.tracks):
            track.pose = people[k : k + 1]
            track.told(moment.cameras.names, moment.times_s, shows[:, k], gain[:, k], self._n_agreeing)

    def _found(self, now_s: float) -> dict[str, list[NewPerson]]:
        """Follow those who are new, or found again. By camera those whom its newest image shows."""
        begun: dict[str, list[NewPerson]] = {name: [] for name in self.rig.names}
        recent = [free for free in self._free.values() if free.time_s > now_s - SAME_MOMENT_S]
        offered = padded([np.isfinite(free.points_px[0]).all(axis=-1).any(axis=-1) for free in recent], False)
        of_one_view = np.zeros(offered.shape, dtype=bool)
        for c, free in enumerate(recent):
            of_one_view[c, list(self._of_one_view[free.cameras.names[0]])] = True
        agreeing = offered.any(axis=1).sum() >= self._n_agreeing or any(free.tells_distance.any() for free in recent)
        if not agreeing or not (offered & ~of_one_view).any():
            return begun
        moment = Moment.together(recent, self.rig)
        known = PoseFilters.stacked([track.pose for track in self.tracks]) if self.tracks else None
        alone = self.rig.n_cameras == 1
        people = found_alone(moment) if alone else found(moment, known, self._skeleton, self._blind, of_one_view)
        for somebody in people:
            numbers = zip(moment.cameras.names, somebody.chosen.tolist(), strict=True)
            chosen = {name: number for name, number in numbers if number != NOBODY}
            nobodys = {name: number for name, number in chosen.items() if number not in self._of_one_view[name]}
            shown = [self._of_one_view[name][number] for name, number in chosen.items() if name not in nobodys]
            track = whose(self.tracks, shown, somebody.pose.middle_m[0], now_s)
            if track not in shown and len(nobodys) < min(len(chosen), self._n_agreeing):
                continue
            track = self._begin(track, somebody, nobodys, moment)
            for name, number in nobodys.items():
                self._free[name].points_px[0, number] = np.nan
                begun[name].append(NewPerson(track.number, number, somebody.pose))
        return begun

    def _begin(self, known: Track | None, somebody: Founded, cameras: Collection[str], moment: Moment) -> Track:
        """The track of somebody on whom these cameras agree, whom it finds again, or a new one."""
        now_s, shown_s = moment.time_s, dict.fromkeys(cameras, moment.time_s)
        if known is not None:
            known.found_again(somebody.pose, shown_s)
            self._note(now_s, known, "found again", f"{', '.join(sorted(known.at_once))} agree on a body near there")
            return known
        # On whom several agree was searched for among all their pairs: that does not count again.
        score = min(somebody.score, MAX_GAIN) if len(cameras) == 1 else 0.0
        likeness = Likeness(self._skeleton, MeanAppearance(self.resemblance))
        track = Track(self._n_tracks, somebody.pose, score, now_s, now_s, shown_s, likeness)
        # Of the others too: that they do not show them was counted.
        track.scored_s = dict(zip(moment.cameras.names, moment.times_s.tolist(), strict=True))
        self._n_tracks += 1
        self.tracks.append(track)
        return track

    def _age(self, now_s: float) -> None:
        for track in self.tracks:
            unseen_s, age_s = now_s - track.seen_s, track.seen_s - track.founded_s
            if track.state is TrackState.TENTATIVE:
                # Who is at the place of somebody else may be the same one, found twice.
                if track.score >= self._confirm_score and not track.near_s:
                    self._confirm(track, now_s)
                elif track.score < _HARDLY or unseen_s > _TENTATIVE_S:
                    track.state = TrackState.ENDED
            elif track.score < _HARDLY:
                self._lose(track, now_s, "others explain the detections, or cameras that should see them do not")
            elif track.absent < _GONE or unseen_s > min(self._config.coast_s, max(_TENTATIVE_S, age_s / 2)):
                self._lose(track, now_s, f"not detected for {unseen_s:.1f} s")
            else:
                track.state = TrackState.COASTING if unseen_s > COASTING_S else TrackState.CONFIRMED
        self._merge(now_s)
        self.tracks = [track for track in self.tracks if track.state is not TrackState.ENDED]
        self._learn(now_s)
        for finding in self._encounters.see([track for track in self.tracks if track.is_confirmed], now_s):
            self._settle(finding, now_s)
        self._recognise(now_s)

    def _settle(self, finding: Finding, now_s: float) -> None:
        """Two who were together are exchanged, or not, or that is open."""
        one, other = finding.together.tracks
        for who, beside in ((one.person, other.person), (other.person, one.person)):
            why = f"with {beside}: {finding.reason}"
            self.events.append(TrackEvent(now_s, who, finding.settled.value, why, beside=beside))
        if finding.settled is Settled.EXCHANGED and self._looks_back:
            self.exchanged.append(finding)
            one.exchange_numbers(other)

    def _confirm(self, track: Track, now_s: float) -> None:
        track.state, track.confirmed_s = TrackState.CONFIRMED, now_s
        track.person = self.n_people
        self.n_people += 1
        self.person_of_track[track.number] = track.person
        self._note(now_s, track, "confirmed", f"{', '.join(sorted(track.shown_s))} agree, log odds {track.score:.1f}")

    def _lose(self, track: Track, now_s: float, reason: str) -> None:
        track.state = TrackState.ENDED
        self._lost.add(track)
        self._note(now_s, track, "lost", reason)

    def _learn(self, now_s: float) -> None:
        confirmed = [track for track in self.tracks if track.is_confirmed]
        for track in confirmed:
            if track.seen_s > now_s - SAME_MOMENT_S:
                track.likeness.add(track.pose, now_s)
        self._lost.learn(confirmed, now_s)
        self.resemblance.learn([track.likeness.looks for track in confirmed], now_s)

    def _recognise(self, now_s: float) -> None:
        """New ones may be somebody who was lost before, and who was recognised somebody else."""
        for track, log_odds in self._lost.doubted(self.tracks):
            self._note(now_s, track, "doubted", f"log odds of place, bones and looks {log_odds:.1f}")
        new = [track for track in self.tracks if track.is_confirmed and track.may_be_recognised(now_s)]
        for track, person, why in self._lost.recognised(new, now_s):
            self._note(now_s, track, "recognised", f"as {person}: {why}", person)
            # Who is recognised at once was never called by another number.
            track.former = track.person if track.confirmed_s < now_s else None
            track.person, track.is_recognised = person, True
            self.person_of_track[track.number] = person

    def _merge(self, now_s: float) -> None:
        """Of two at one place the one who is confirmed stays, or the elder."""
        live = [track for track in self.tracks if track.state is not TrackState.ENDED]
        live.sort(key=lambda track: not track.is_confirmed)
        for n, younger in enumerate(live):
            elders = [
                elder
                for elder in live[:n]
                if elder.state is not TrackState.ENDED
                and elder.number not in younger.apart_from
                and at_one_place(elder, younger)
            ]
            younger.near_s = {elder.number: younger.near_s.get(elder.number, now_s) for elder in elders}
            for elder in elders:
                if now_s - younger.near_s[elder.number] > _ONE_BODY_S:
                    if younger.is_confirmed:
                        self.person_of_track[younger.number] = elder.person
                        # A number from before an absence meant somebody then, whoever this is.
                        became = None if younger.is_recognised else elder.person
                        self._note(now_s, younger, "merged", f"at the place of {elder.person}", became)
                    younger.state = TrackState.ENDED
                    break

    def _note(self, time_s: float, track: Track, what: str, reason: str, became: int | None = None) -> None:
        self.events.append(TrackEvent(time_s, track.person, what, reason, became))
