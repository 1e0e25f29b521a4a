"""Whether the cameras agree where people are, from those whom the tracker follows: one that was moved does not.

The measure and its limits are those by which a calibration from people is judged: third views (cross_checks).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.association.track import Tracked
from fgpose.calibration.disagreement import Disagreement, allowed_third_view_mrad, disagreement
from fgpose.calibration.from_people.verdict.cross_checks import third_view_of
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.live.tracking.common_sightings import CommonSighting, CommonSightings
from fgpose.live.tracking.motion_lags import EVERY_S, MotionLags
from fgpose.live.tracking.nobody_followed import NobodyFollowed
from fgpose.live.tracking.seen_twice import SeenTwice
from fgpose.people_observations import Detections
from fgpose_factors.robust_statistics import known_medians

_LOG = logging.getLogger("fgpose.live")
# Errors of detections are correlated over less.
_EVERY_S = 1.0
# Looks at somebody: the median follows a camera that is moved after half of them.
_KEPT = 40
# By then somebody who walks has been seen from several sides.
_FEWEST = 15
# What was said is taken back when the disagreement is clearly less than what is said.
_OVER_SHARE = 0.8
# What was said of a camera is said again if the angle is another.
_OTHER_SHARE = 0.25
_REMEDY = "fgpose calibrate --from rig.toml"


class CameraAgreement:
    """Looks at somebody once a second, a camera at a time, and remembers the last 40 looks; more often for clocks that
    are grossly wrong.

    What was said stays until the camera is seen to agree again: also while nobody is there.

    Args:
        rig: as it was calibrated.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._sightings = CommonSightings(rig)
        n = rig.n_cameras
        self._all_mrad = np.full((_KEPT, n), np.nan)
        self._without_mrad = np.full((_KEPT, n, n), np.nan)
        self._n_kept = 0
        self._work: list[_Work] = []
        self._lags = MotionLags(rig)
        self._nobody_followed, self._seen_twice = NobodyFollowed(rig), SeenTwice(rig)
        self._left_out: frozenset[str] = frozenset()
        """Cameras whose views would spoil those of all others."""
        self._newest_s = self._taken_s = self._looked_s = -np.inf
        self._parts: dict[tuple[int, ...], CameraRig] = {}
        self._said: Disagreement | None = None
        self._n_unclear = 0
        """Looks since which it is not clear who is wrong: at first, and while a camera moves, it is not."""
        self._lasting: dict[str, str] = {}
        self.faults: dict[str, str] = {}
        """By camera, in words; none where it agrees or nothing is known."""

    def add(self, images: Sequence[Detections], people: Sequence[Tracked]) -> None:
        """The newest images, and who is in them. Hardly anything is computed."""
        self._sightings.add(images, people)
        self._nobody_followed.add(images, people)
        self._seen_twice.add(images, people)
        self._newest_s = max([self._newest_s, *(image.time_s for image in images)])

    @property
    def is_due(self) -> bool:
        """Whether it is time to look at somebody."""
        return not self._work and self._newest_s >= self._taken_s + EVERY_S

    def look(self, offsets_s: Float[np.ndarray, " camera"], sigma_s: Float[np.ndarray, " camera"]) -> None:
        """Take somebody as they are seen now; go_on does the rest.

        Args:
            offsets_s: how much later than its times say each camera takes its images.
            sigma_s: of these.
        """
        self._taken_s = self._newest_s
        sighting = self._sightings.take(offsets_s, sigma_s)
        if sighting is not None:
            self._lags.add(sighting, sigma_s)
        self._leave_out()
        self._say()
        if sighting is None:
            return
        if self._newest_s < self._looked_s + _EVERY_S:
            return
        self._looked_s, sighting = self._newest_s, sighting.of_known_clocks
        is_left_out = np.isin(self._rig.names, list(self._left_out))
        seen = np.flatnonzero((sighting.confidence > 0).any(axis=1) & ~is_left_out).tolist()
        if len(seen) < min(3, self._rig.n_cameras):
            return
        row = self._n_kept % _KEPT
        self._all_mrad[row], self._without_mrad[row] = np.nan, np.nan
        self._n_kept += 1
        self._work = [_Work(row, c, seen, sighting) for c in seen]

    def _leave_out(self) -> None:
        """Two and more cameras in which nobody is found, or a double, as where they are exchanged: without one the
        others disagree as much as without any other. Of a single one the angle tells more."""
        found = frozenset(self._nobody_followed.faults | self._seen_twice.faults)
        found = found if len(found) > 1 else frozenset[str]()
        if found - self._left_out:  # the looks so far have them
            self._all_mrad[:], self._without_mrad[:] = np.nan, np.nan
            self._n_kept = self._n_unclear = 0
            self._work = []
        self._left_out = found

    def go_on(self) -> None:
        """Do a part of the work, about half a millisecond."""
        if not self._work:
            return
        work = self._work.pop()
        self._all_mrad[work.row, work.camera], self._without_mrad[work.row, :, work.camera] = self._third_views(work)
        if not self._work:
            self._decide()

    def _third_views(self, work: _Work) -> tuple[float, Float[np.ndarray, " left_out"]]:
        """Of one camera, with all others and without each of them."""
        px, confidence, seen = work.sighting.undistorted_px[None], work.sighting.confidence[None], work.seen
        without_mrad = np.full(self._rig.n_cameras, np.nan)
        others = [c for c in seen if c != work.camera]
        if len(seen) == 3:
            for left_out in others:
                pair = [c for c in seen if c != left_out]
                own = pair.index(work.camera)
                without_mrad[left_out] = third_view_of(own, px[:, pair], confidence[:, pair], self._part(pair))[0]
            others = []
        # All at once: without nobody, and without each of the others.
        weights = np.repeat(confidence[:, seen], 1 + len(others), axis=0)
        for n, left_out in enumerate(others):
            weights[1 + n, seen.index(left_out)] = 0.0
        rows_px = np.repeat(px[:, seen], len(weights), axis=0)
        mrad = third_view_of(seen.index(work.camera), rows_px, weights, self._part(seen))
        without_mrad[others] = mrad[1:]
        return float(mrad[0]), without_mrad

    def _part(self, cameras: Sequence[int]) -> CameraRig:
        key = tuple(cameras)
        if key not in self._parts:
            self._parts[key] = CameraRig(tuple(self._rig.cameras[c] for c in key))
        return self._parts[key]

    def _decide(self) -> None:
        known = np.isfinite(self._all_mrad).sum(axis=0) >= _FEWEST
        if known.sum() < 2:
            return
        all_mrad = np.where(known, known_medians(self._all_mrad, axis=0), np.nan)
        enough = np.isfinite(self._without_mrad).sum(axis=0) >= _FEWEST
        without_mrad = np.where(enough, known_medians(self._without_mrad, axis=0), np.nan)
        found = disagreement(all_mrad, without_mrad, _OVER_SHARE if self._lasting else 1.0)
        is_unclear = found is not None and found.camera is None
        self._n_unclear = self._n_unclear + 1 if is_unclear else 0
        if is_unclear and self._n_unclear < _FEWEST:
            return
        if found is not None and self._said is not None and found.is_like(self._said, _OTHER_SHARE):
            return
        self._said = found
        kept = {name: reason for name, reason in self._lasting.items() if not known[self._rig.names.index(name)]}
        self._lasting = kept | self._in_words(found, all_mrad)
        self._say()

    def _in_words(self, found: Disagreement | None, all_mrad: Float[np.ndarray, " camera"]) -> dict[str, str]:
        if found is None:
            return {}
        if found.camera is not None:
            reason = f"it sees the people {found.mrad:.0f} mrad beside where the other cameras do: was it moved?"
            return {self._rig.names[found.camera]: f"{reason} {_REMEDY} [{Code.MOVED_CAMERA}]"}
        reason = (
            f"the cameras do not agree where the people are ({found.mrad:.0f} mrad), and which is wrong is not clear"
        )
        limit_mrad = _OVER_SHARE * allowed_third_view_mrad(float(np.nanmedian(all_mrad)))
        involved = np.array(self._rig.names)[all_mrad > limit_mrad].tolist()
        return dict.fromkeys(involved, f"{reason}: was one moved? {_REMEDY} [{Code.DISAGREEING_CAMERA}]")

    def _say(self) -> None:
        lasting = {name: reason for name, reason in self._lasting.items() if name not in self._left_out}
        faults = self._seen_twice.faults | self._nobody_followed.faults | self._lags.faults | lasting
        for name in faults.keys() - self.faults.keys():
            _LOG.warning("camera %s: doubtful: %s", name, faults[name])
        for name in self.faults.keys() - faults.keys():
            _LOG.info("camera %s: it sees the people where the others do again", name)
        self.faults = faults


@dataclass(frozen=True, eq=False)
class _Work:
    """The third views of one camera at one instant."""

    row: int
    camera: int
    seen: list[int]
    """Cameras that see the person."""
    sighting: CommonSighting
