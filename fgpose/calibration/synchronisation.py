"""When the cameras of a calibrated rig began to film, where nobody has synchronised them: from the motion they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.starts.placed_joining import fits_at_shifts
from fgpose.calibration.from_people.starts.start_findings import AMBIGUOUS_REMEDY, in_words
from fgpose.calibration.from_people.starts.starts import Starts, find_starts
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.starts.walker import Compare, main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.shown import Shown

_WALK, _CUT = "walk about where all cameras see you", "or cut the recordings to begin at the same moment"

# With wrong poses, too, several moments fit about as well, and badly.
_OTHERS = "or is the calibration of other cameras (exchanged?)"


@dataclass(frozen=True, eq=False, repr=False)
class Synchronised(Shown):
    """A rig whose clocks are known."""

    rig: CameraRig
    """Of the cameras whose start is known. time_offset_s of each turns its clock into that of the first."""
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation of the offsets; zero of the first camera."""
    findings: tuple[CalibrationFinding, ...]
    """Of each camera whose start is not known the reason (grade failed), and doubts about others."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """Cameras whose start is not known."""
        return tuple(finding.camera for finding in self.findings if finding.grade is Grade.FAILED)


def synchronise(people: PeopleObservations, rig: CameraRig) -> Synchronised:
    """Find when each camera of a rig began, however far apart that is, from the motion of the person who is seen most.

    At the right shift the joints of one camera lie on the epipolar lines of those of another; see
    fgpose.calibration.from_people.starts.placed_joining. estimate_time_offsets, which uses everybody, refines offsets
    of less than a quarter of a second.

    Args:
        people: what the cameras saw, each by its own clock.
        rig: the cameras; their time offsets are not used.

    Raises:
        ValueError: the cameras differ, fewer than two see the same person, or the starts of fewer than two are found;
            the message gives the reasons.
    """
    people.check_cameras(rig.names)
    unsynchronised = rig.with_time_offsets(np.zeros(rig.n_cameras))
    tracks = main_tracks(find_tracks(people), people.skeleton, compare=_placed(unsynchronised))
    starts = find_starts(tracks, people.skeleton, unsynchronised, placed=True)
    if starts.trusted.sum() < 2:
        failed = [_with_remedy(each) for each in starts.findings if each.grade is Grade.FAILED]
        raise ValueError(f"it is not found when the cameras began: {in_words(failed)}")
    names = [name for name, is_trusted in zip(rig.names, starts.trusted.tolist(), strict=True) if is_trusted]
    offsets_s = _offsets_s(starts, [track for track in tracks if track.camera in names])
    own = rig.subset(names).with_starts(offsets_s - offsets_s[0])
    findings = tuple(_with_remedy(each) for each in starts.findings)
    return Synchronised(own, starts.sigma_s[starts.trusted], findings)


def _placed(rig: CameraRig) -> Compare:
    """Two tracks are compared by the joints, through the poses of their cameras."""
    cameras = dict(zip(rig.names, rig.cameras, strict=True))
    view = cache(lambda track: View.of(track, cameras[track.camera], placed=True))
    return lambda one, other: fits_at_shifts(view(one), view(other))


def _with_remedy(finding: CalibrationFinding) -> CalibrationFinding:
    """What helps with a rig whose poses are known, where the motion does not tell."""
    if "walk" not in finding.remedy and "--synchronised" not in finding.remedy:
        return finding
    ambiguous = finding.remedy.startswith(AMBIGUOUS_REMEDY)
    return replace(finding, remedy=f"{AMBIGUOUS_REMEDY}; {_CUT}; {_OTHERS}" if ambiguous else f"{_WALK}; {_CUT}")


def _offsets_s(starts: Starts, tracks: Sequence[Track]) -> Float[np.ndarray, " camera"]:
    """What turns the clock of each camera into the common one: as it is in the middle of what all show, should it
    drift."""
    spans_s = np.array([starts.common_s(track.camera, track.time_s[[0, -1]]) for track in tracks])
    middle_s = float(spans_s[:, 0].max() + spans_s[:, 1].min()) / 2
    return starts.offsets_at_s([track.camera for track in tracks], middle_s)
