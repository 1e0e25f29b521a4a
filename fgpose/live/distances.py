"""Distances of people from the links of a robot, with their uncertainty, and the faults that make them worthless.

THIS IS NO SAFETY FUNCTION. No camera, network, computer or line of this program is rated for protecting people. A robot
that can hurt somebody needs a rated device that stops it whatever is said here. What is said here is for research, for
slowing down out of courtesy, and for seeing what a rated device would have to cope with.

A person is a set of capsules (fgpose.live.body). Each is taken to be nearer than expected by a quantile of the error of
its joints along the line to the link (fgpose.live.clearance), and by what a person can walk or reach in the age of the
data, with the speeds of ISO 13855. The links are taken to be where the given poses put them: how far the robot moves
before it stops is left to the caller (S_robot and S_stop of ISO 10218-2).

A fault is latched: it stays, with its first reason, until reset() is called, also when its cause is gone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.live.approach import Approach
from fgpose.live.body import ARM, Body
from fgpose.live.cell import Cell
from fgpose.live.clearance import Axes, clearance
from fgpose.live.frame import CameraState, LiveFrame
from fgpose.live.links import PlacedLinks, world_poses
from fgpose.skeleton import Skeleton

NO_SAFETY_FUNCTION = (
    "Distances are no safety function: nothing here is rated for protecting people. A robot that can hurt somebody "
    "needs a rated device that stops it whatever is said here."
)
"""For the help of commands and the heads of outputs."""

_FUTURE_S = 0.1  # by which clocks of computers in one room may differ; data from farther ahead have a wrong clock


@dataclass(frozen=True)
class Fault:
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
    """Of the same part of the body, without these allowances."""
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
    """Of the newest image that the people were estimated from."""
    observed_share: float
    """Of the surroundings of the link, by at least two cameras that are ok."""
    fault: Fault | None


@dataclass(frozen=True, eq=False)
class _Measured:
    """A frame against the links: everybody's capsules and each link's nearest shape."""

    least_m: Float[np.ndarray, "person capsule link"]
    """inf where a capsule has no place because a joint is missing."""
    expected_m: Float[np.ndarray, "person capsule link"]
    along: Float[np.ndarray, "person capsule link"]

    def without_place(self) -> list[int]:
        """People of whom no capsule is known."""
        return np.flatnonzero(np.isinf(self.expected_m).all(axis=(1, 2))).tolist()


class DistanceMonitor:
    """Distances of people from links. No safety function: see the top of this module.

    ``publish`` takes the frames as they come; ``measure`` says what is true at a moment, from the newest frame, and is
    meant to be called in the loop that moves the robot: only there can silence be noticed. ``publish`` may be called
    from another thread.

    Every link has a fault until frames have come and ``reset`` has been called.

    Raises:
        ValueError: the skeleton lacks a joint that a body needs, or too little around a zone is observed.
    """

    def __init__(self, cell: Cell, rig: CameraRig, skeleton: Skeleton) -> None:
        self._limits = cell.limits
        self._skeleton = skeleton
        self._body = Body.of(skeleton, cell.radius_m)
        speeds_m_s = {True: cell.limits.hand_m_s, False: cell.limits.walking_m_s}
        self._speed_m_s = np.array([speeds_m_s[part in ARM] for part in self._body.parts])
        self._links = PlacedLinks(cell, rig)
        self._camera_names = rig.names
        self._frame: LiveFrame | None = None
        self._faults: dict[int, Fault] = {}
        self._approach = Approach(cell.limits.walking_m_s)

    def publish(self, frame: LiveFrame) -> None:
        """The newest frame. Never blocks."""
        self._frame = frame

    def close(self) -> None:
        """Does nothing: there is nothing to close."""

    def reset(self) -> None:
        """Clear the latched faults of all links. A cause that is still there is a fault again at once."""
        self._faults.clear()

    def measure(self, poses: Mapping[str, np.ndarray], now_s: float) -> tuple[LinkDistance, ...]:
        """Smallest distance of each link, in the order of the cell.

        Args:
            poses: (4, 4) pose of each link in the world (world_T_link, metres), as it is now. A link without one, or
                with one that is not a rigid transform, has a fault; other names are ignored. Zones need none.
            now_s: Unix time.
        """
        frame, every_link = self._frame, range(len(self._links.links))
        if frame is None or math.isnan(frame.time_s):
            self._latch(every_link, "no image has come yet" if frame else "no frame has come yet", now_s)
            return tuple(self._anywhere(link, math.inf, 0.0) for link in every_link)
        world_T_link, wrong = world_poses(self._links.links, poses)
        for link, reason in wrong.items():
            self._latch([link], reason, now_s)
        age_s = now_s - frame.time_s
        self._check_age(age_s, now_s)
        shares = [self._check_views(frame, link, world_T_link[link], now_s) for link in every_link if link not in wrong]
        share_of = dict(zip((link for link in every_link if link not in wrong), shares, strict=True))
        measured = self._measured(frame, world_T_link, max(age_s, 0.0))
        self._check_joints(frame, measured, now_s)
        self._approach.add(frame, measured.expected_m.min(axis=1))
        unknown = set(every_link) if measured.without_place() else set(wrong)
        return tuple(
            self._anywhere(link, age_s, share_of.get(link, 0.0))
            if link in unknown
            else self._nearest(link, frame, measured, age_s, share_of[link])
            for link in every_link
        )

    def _latch(self, links: Iterable[int], reason: str, now_s: float) -> None:
        for link in links:
            self._faults.setdefault(link, Fault(reason, now_s))

    def _check_age(self, age_s: float, now_s: float) -> None:
        every_link = range(len(self._links.links))
        if age_s > self._limits.max_age_s:
            self._latch(every_link, f"the data are {age_s:.2f} s old", now_s)
        elif not age_s >= -_FUTURE_S:
            self._latch(every_link, f"the data are {-age_s:.2f} s ahead of the clock", now_s)

    def _check_views(self, frame: LiveFrame, link: int, world_T_link: Float[np.ndarray, "4 4"], now_s: float) -> float:
        state = {camera.name: camera.state for camera in frame.cameras}
        is_ok = np.array([state.get(name) is CameraState.OK for name in self._camera_names])
        share = self._links.observed_share(link, world_T_link, is_ok)
        if share < self._limits.min_observed_share:
            others = [f"{name} {state[name].value if name in state else 'missing'}"
                      for name, ok in zip(self._camera_names, is_ok, strict=True) if not ok]  # fmt: skip
            because = f" ({', '.join(others)})" if others else ""
            self._latch([link], f"two cameras observe only {share:.0%} of its surroundings{because}", now_s)
        return share

    def _measured(self, frame: LiveFrame, world_T_link: Float[np.ndarray, "link 4 4"], age_s: float) -> _Measured:
        body, n_joints = self._body, self._skeleton.n_joints
        positions_m = np.array([person.positions_m for person in frame.people]).reshape(-1, n_joints, 3)
        covariance_m2 = np.array([person.covariance_m2 for person in frame.people]).reshape(-1, n_joints, 3, 3)
        known = np.asarray(np.isfinite(positions_m).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-2, -1)))
        has_place = known[:, body.joints].all(axis=(-2, -1))
        person, capsule = np.nonzero(has_place)
        axes = Axes(
            body.ends_m(positions_m)[person, capsule],
            covariance_m2[person[:, None, None], body.joints[capsule]],
            body.radius_m[capsule],
            body.is_sphere[capsule],
        )
        of_shapes = clearance(axes, self._links.shapes(world_T_link), self._limits.quantile)
        n_links = len(self._links.links)
        arrays = [np.full((len(positions_m), len(body.parts), n_links), np.inf) for _ in range(3)]
        for link in range(n_links):
            shapes = np.flatnonzero(self._links.link_of_shape == link)
            best = shapes[of_shapes.least_m[:, shapes].argmin(axis=1)][:, None]
            for array, values in zip(arrays, (of_shapes.least_m, of_shapes.expected_m, of_shapes.along), strict=True):
                array[person, capsule, link] = np.take_along_axis(values, best, axis=1)[:, 0]
        least_m, expected_m, along = arrays
        return _Measured(least_m - self._speed_m_s[:, None] * age_s, expected_m, along)

    def _check_joints(self, frame: LiveFrame, measured: _Measured, now_s: float) -> None:
        nowhere = measured.without_place()
        for number, person in enumerate(frame.people):
            missing = [self._skeleton.joints[joint] for joint in self._body.missing(person)]
            is_near = measured.expected_m[number].min(axis=0) < self._limits.missing_within_m
            links = range(len(is_near)) if number in nowhere else np.flatnonzero(is_near).tolist()
            if missing:
                self._latch(links, f"person {person.person} has no estimate of {', '.join(missing)}", now_s)

    def _anywhere(self, link: int, age_s: float, share: float) -> LinkDistance:
        """Where people or the link may be anywhere."""
        name, fault = self._links.links[link].name, self._faults.get(link)
        return LinkDistance(name, -math.inf, -math.inf, None, "", "", math.nan, age_s, share, fault)

    def _nearest(self, link: int, frame: LiveFrame, measured: _Measured, age_s: float, share: float) -> LinkDistance:
        name, fault = self._links.links[link].name, self._faults.get(link)
        if not frame.people:
            return LinkDistance(name, math.inf, math.inf, None, "", "", math.nan, age_s, share, fault)
        least_m = measured.least_m[:, :, link]
        number, capsule = np.unravel_index(np.argmin(least_m), least_m.shape)
        end = int(measured.along[number, capsule, link] > 0.5)
        return LinkDistance(
            link=name,
            distance_m=float(least_m[number, capsule]),
            expected_m=float(measured.expected_m[number, capsule, link]),
            person=frame.people[number].person,
            part=self._body.names[capsule],
            joint=self._skeleton.joints[self._body.joints[capsule, end, 0]],
            closing_m_s=self._approach.closing_m_s(int(number), link),
            age_s=age_s,
            observed_share=share,
            fault=fault,
        )
