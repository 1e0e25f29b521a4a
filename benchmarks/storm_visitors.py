"""People of the storm, and a stand-in for the tracker that recognises what images show instead of estimating it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.association.track import Tracked, TrackEvent, TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Status
from simulated_visitors import SimulatedClip, Visitors

# Quantiles of the time until somebody is found, as found_again.py has measured them.
_FOUND_SHARE, _FOUND_AFTER_S = (0.0, 0.5, 0.99, 1.0), (0.03, 0.13, 0.50, 0.62)
# Standard deviations of joints that so many cameras see, and over which time errors are correlated.
_SIGMA_M, _CORRELATED_S = (0.0, 0.12, 0.03, 0.025, 0.02), 0.3
_WALKING_M_S = 0.8
_COASTS_S, _LAG_S = 1.0, 0.3
# What the motion in one image tells of a clock, and so many count.
_TOLD_SIGMA_S, _REMEMBERED = 0.3, 300


@dataclass(frozen=True)
class ShownTruth:
    """What an image shows in truth."""

    number: float
    """Of the image in the simulation; NaN: nobody knows, as nobody is in it."""
    people: frozenset[int]


_NOTHING = ShownTruth(math.nan, frozenset())


class StormVisitors(Visitors):
    """Visitors who are recognised in what a detector sends of them, whatever stamp it has."""

    def __init__(self, clips: Sequence[SimulatedClip], *args: Any) -> None:
        super().__init__(clips, *args)
        self._of_image: dict[bytes, tuple[int, int, frozenset[int]]] = {}
        for clip_number, clip in enumerate(clips):
            scene = clip.scene
            who_in = {
                (image.camera, image.time_s): frozenset(who[who >= 0].tolist())
                for image, who in zip(scene.observations.images, scene.who, strict=True)
            }
            for images in clip.images.values():
                for k, image in enumerate(images):
                    if image.n_people:
                        self._of_image[_key(image)] = clip_number, k, who_in[image.camera, image.time_s]

    def shown(self, image: Detections, now_s: float) -> ShownTruth:
        """In an image that has come by now."""
        if not image.n_people or (found := self._of_image.get(_key(image))) is None:
            return _NOTHING
        clip, k, people = found
        newest = self.number(now_s)
        minute = int(newest / self._rate_hz / 60.0)
        for each in (minute, minute - 1):
            visit = self._visit(each)
            # Late images of a visit before, with the same clip, come when this one has begun.
            if visit is not None and visit.clip == clip and visit.first + k <= newest:
                return ShownTruth(visit.first + k, people)
        return _NOTHING

    def time_s(self, number: float) -> float:
        """When an image is taken, Unix time."""
        return self._start_s + number / self._rate_hz

    def people_m(self, number: float) -> Float[np.ndarray, "person joint 3"]:
        """Where everybody is when an image is taken; NaN: not there."""
        visit = self.of(int(number))
        if visit is None:
            return np.full((0, *self._clips[0].scene.motion.truth_m.shape[2:]), np.nan)
        return self._clips[visit.clip].truth_m((number - visit.first) / self._rate_hz)


def _key(image: Detections) -> bytes:
    return np.asarray(image.points2d_px, dtype=np.float32).tobytes()


class StandInOffsets:
    """What the motion would tell of the clocks: the truth, with the error that it says."""

    def __init__(self, n_cameras: int, rng: np.random.Generator) -> None:
        self.sigma_s = np.zeros(n_cameras)
        self._late_s, self._n = [0.0] * n_cameras, [0] * n_cameras
        self._error = rng.standard_normal(n_cameras).tolist()

    def add(self, camera: int, late_s: float) -> None:
        """Somebody was seen so much later than the time of the image says."""
        self._n[camera] = min(self._n[camera] + 1, _REMEMBERED)
        self._late_s[camera] += (late_s - self._late_s[camera]) / self._n[camera]

    @property
    def has_told(self) -> bool:
        """See RunningOffsets."""
        return any(n > 0 and sigma_s > 0 for n, sigma_s in zip(self._n, self.sigma_s.tolist(), strict=True))

    def relative(self, *, fits: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """See RunningOffsets."""
        cameras = list(zip(self.sigma_s.tolist(), self._n, self._late_s, self._error, strict=True))
        told_s = [min(_TOLD_SIGMA_S / math.sqrt(max(n, 1)), sigma_s) for sigma_s, n, _, _ in cameras]
        held_s = [late_s for sigma_s, n, late_s, _ in cameras if sigma_s == 0 and n > 0]
        mean_s = sum(held_s) / len(held_s) if held_s else 0.0
        offset_s = [
            late_s - mean_s + each_s * error if sigma_s > 0 else 0.0
            for (sigma_s, _, late_s, error), each_s in zip(cameras, told_s, strict=True)
        ]
        return np.array(offset_s), np.array(told_s)


@dataclass
class _Followed:
    since_s: float
    """When two cameras saw them first, and how long it takes until they are found."""
    wait_s: float
    seen_s: float
    error: np.ndarray
    """(J, 3) of the joints, in standard deviations."""
    estimate: Estimate | None = None


class StandInTracker:
    """In place of fgpose.Tracker.

    Args:
        visitors: whom it recognises.
        rig: the cameras.
        skeleton: of the people.
        now_s: Unix time.
        rng: of errors and waits.
        fails: called before each update; a tracker that fails raises here, one that hangs takes its time.
    """

    def __init__(
        self,
        visitors: StormVisitors,
        rig: CameraRig,
        skeleton: Any,
        now_s: Callable[[], float],
        rng: np.random.Generator,
        fails: Callable[[str], None],
    ) -> None:
        self._visitors, self._rig, self._skeleton, self._now_s, self._rng = visitors, rig, skeleton, now_s, rng
        self._fails = fails
        self.offsets, self.n_restarts = StandInOffsets(rig.n_cameras, rng), 0
        self._newest: dict[str, tuple[float, ShownTruth]] = {}
        self._followed: dict[int, _Followed] = {}
        self._n_updates, self._updated_s = 0, math.nan
        self.nobodys: dict[str, Detections] = {}
        """Nothing is shown of nobody."""
        self.used: Sequence[Detections] = ()
        self.set_clocks: dict[str, str] = {}
        """No clock is set while it runs."""

    def await_ready(self) -> None:
        """It has no processes."""

    def update(self, images: Sequence[Detections]) -> list[Tracked]:
        """See Tracker."""
        self._fails("update")
        self.used = images
        for image in images:
            camera, shown = self._rig.names.index(image.camera), self._visitors.shown(image, self._now_s())
            if shown.people:
                self.offsets.add(camera, self._visitors.time_s(shown.number) - image.time_s)
            self._newest[image.camera] = image.time_s, shown
        newest_s = max(time_s for time_s, _ in self._newest.values())
        seen: dict[int, list[tuple[float, float]]] = {}
        offset_s = self.offsets.relative()[0] if self.offsets.has_told else np.zeros(self._rig.n_cameras)
        for name, (time_s, shown) in self._newest.items():
            if time_s > newest_s - _LAG_S:
                at_s = time_s + offset_s[self._rig.names.index(name)]
                for who in shown.people:
                    seen.setdefault(who, []).append((at_s, shown.number))
        self._follow(seen, newest_s)
        self._n_updates += 1
        return [
            Tracked(who, TrackState.CONFIRMED if who in seen else TrackState.COASTING, person.estimate, {})
            for who, person in self._followed.items()
            if person.estimate is not None
        ]

    def _follow(self, seen: dict[int, list[tuple[float, float]]], newest_s: float) -> None:
        decay = math.exp(-abs(newest_s - self._updated_s) / _CORRELATED_S) if self._n_updates else 0.0
        self._updated_s = newest_s
        for who in [who for who, person in self._followed.items() if newest_s - person.seen_s > _COASTS_S]:
            del self._followed[who]
        for who, views in seen.items():
            if who not in self._followed:
                if len(views) < 2:
                    continue
                wait_s = float(np.interp(self._rng.random(), _FOUND_SHARE, _FOUND_AFTER_S))
                error = self._rng.standard_normal((self._skeleton.n_joints, 3))
                self._followed[who] = _Followed(newest_s, wait_s, newest_s, error)
            person = self._followed[who]
            person.seen_s = newest_s
            person.error = decay * person.error + math.sqrt(1 - decay**2) * self._rng.standard_normal(
                person.error.shape
            )
            if newest_s - person.since_s >= person.wait_s:
                person.estimate = self._estimate(who, views, person) or person.estimate
        for who, person in self._followed.items():
            if who not in seen and person.estimate is not None:
                person.estimate = self._predicted(person.estimate, newest_s)

    def _estimate(self, who: int, views: list[tuple[float, float]], person: _Followed) -> Estimate | None:
        """Where they were on average when the images were taken, at the mean of the times that these have."""
        shown_m = {number: self._visitors.people_m(number)[who] for number in {number for _, number in views}}
        true_m = np.sum([shown_m[number] for _, number in views], axis=0) / len(views)
        if not np.isfinite(true_m).all():
            return None
        n, sigma_m = len(true_m), _SIGMA_M[min(len(views), 4)]
        return Estimate(
            self._skeleton,
            self._n_updates,
            sum(at_s for at_s, _ in views) / len(views),
            true_m + sigma_m * person.error,
            np.full(n, Status.OBSERVED, dtype=np.int8),
            np.repeat(sigma_m**2 * np.eye(3)[None], n, axis=0),
        )

    def _predicted(self, last: Estimate, time_s: float) -> Estimate:
        """They have gone on as they may."""
        walked_m2 = (_WALKING_M_S * (time_s - last.time_s)) ** 2
        status = np.full(len(last.status), Status.PREDICTED, dtype=np.int8)
        covariance_m2 = (0.0 if last.covariance_m2 is None else last.covariance_m2) + walked_m2 * np.eye(3)
        return Estimate(self._skeleton, self._n_updates, time_s, last.positions_m, status, covariance_m2)

    def look(self) -> None:
        """See Tracker."""

    def tidy(self) -> None:
        """See Tracker."""
        self._fails("tidy")

    def leaves_out(self, image: Detections) -> bool:
        """See Tracker."""
        return False

    def events(self) -> list[TrackEvent]:
        """See Tracker."""
        return []

    def close(self) -> None:
        """See Tracker."""


class _NoAgreement:
    """In place of CameraAgreement, which only ever doubts cameras."""

    is_due = False
    faults: dict[str, str] = {}  # noqa: RUF012

    def add(self, images: Any, people: Any) -> None: ...

    def go_on(self) -> None: ...


class StandInTracking(LiveTracking):
    """The live system's own, but for the estimation."""

    def __init__(self, new_tracker: Callable[[], StandInTracker], *args: Any) -> None:
        self._make_tracker = new_tracker
        super().__init__(*args)
        self._agreement: Any = _NoAgreement()

    def _new_tracker(self) -> Any:
        return self._make_tracker()
