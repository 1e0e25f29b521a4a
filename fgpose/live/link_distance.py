"""The distance of people from a link of a robot, as it is published; fgpose.robot measures it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DistanceFault:
    """Why the distances of a link are not to be believed."""

    reason: str
    since_s: float
    """Unix time at which it was noticed first."""


@dataclass(frozen=True)
class LinkDistance:
    """The person nearest to a link. Where there is a fault, the numbers are not to be believed."""

    link: str
    distance_m: float
    """Smallest distance of any person's surface, less the quantile and what a person can walk in the age of the data;
    negative: they may overlap. inf: nobody is there. -inf: anybody may be anywhere."""
    expected_m: float
    """Of the same part of the body, without these allowances. Where a joint of it has no place, that of the nearest one
    is taken that has."""
    person: int | None
    """Whose distance it is; None: nobody's."""
    part: str
    """Of the body: ``left lower arm``; empty for nobody."""
    joint: str
    """The joint nearest to the point of that part that is nearest to the link; empty for nobody."""
    closing_m_s: float
    """How fast this person and the link have come nearer over the last images; negative: moving apart. NaN: not known,
    because nobody was near this place before."""
    age_s: float
    """Of the images that the people were estimated from, by the worse of what stamps and arrivals say."""
    pose_age_s: float
    """Of the pose of the link; NaN: there was none."""
    observed_share: float
    """Of the surroundings of the link, by at least two cameras that have been ok for a second."""
    fault: DistanceFault | None
