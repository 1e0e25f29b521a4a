"""Distances of people from the links of a robot, with their uncertainty, and the faults that make them worthless.

THIS IS NO SAFETY FUNCTION. No camera, network, computer or line of this program is rated for protecting people. A robot
that can hurt somebody needs a rated device that stops it whatever is said here. What is said here is for research, for
slowing down out of courtesy, and for seeing what a rated device would have to cope with.

A person is a set of capsules (body). Each is taken to be nearer than expected by a quantile of the error of its joints
along the line to the link (clearance) or, where fewer than two cameras see a joint, by what it can have moved since two
did (unseen), or as far as bones reach if it has no place (reach); and by what a person can walk or reach in the age of
the data, with the speeds of ISO 13855. The links are taken to be where the given poses put them: how far the robot
moves before it stops is left to the caller (S_robot and S_stop of ISO 10218-2).

What may be said without a fault is decided in one place (assurance). A fault is latched: it stays, with its
first reason, until reset() is called, also when its cause is gone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.robot.approach import Approach
from fgpose.robot.assurance import FOUND_S, Facts, faults_of, is_new
from fgpose.robot.body import ARM, Body
from fgpose.robot.cell import Cell
from fgpose.robot.clearance import Axes, clearance
from fgpose.robot.links import PlacedLinks, world_poses
from fgpose.robot.nobodys import Nobodys
from fgpose.robot.reach import Places, Reach
from fgpose.robot.unseen import Unseen
from fgpose.robot.vanished import Remembered
from fgpose.skeleton import Skeleton

NO_SAFETY_FUNCTION = (
    "Distances are no safety function: nothing here is rated for protecting people. A robot that can hurt somebody "
    "needs a rated device that stops it whatever is said here."
)
"""For the help of commands and the heads of outputs."""


@dataclass(frozen=True, eq=False)
class _Measured:
    """A frame against the links: everybody's capsules and each link's nearest shape."""

    least_m: Float[np.ndarray, "person capsule link"]
    """-inf where nothing tells."""
    expected_m: Float[np.ndarray, "person capsule link"]
    """inf where nothing tells."""
    along: Float[np.ndarray, "person capsule link"]
    is_known: Bool[np.ndarray, "person capsule"]
    """Whether all joints of a capsule have a place; else those that have none are taken to be where others are."""

    @cached_property
    def without_place(self) -> list[int]:
        """People of whom no capsule is known, or who may be anywhere."""
        is_anywhere = np.isneginf(self.least_m).any(axis=(1, 2))
        return np.flatnonzero(is_anywhere | ~self.is_known.any(axis=1)).tolist()


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
        self._unseen = Unseen(skeleton, cell.limits)
        self._reach = Reach(self._body, skeleton.n_joints)
        self._newest: tuple[LiveFrame, Places] | None = None
        self._ok_since_s: dict[str, float] = {}
        """Of the cameras that are: from when they were published so."""
        self._faults: dict[int, DistanceFault] = {}
        self._approach = Approach(cell.limits.walking_m_s)
        self._nobodys = Nobodys(rig, skeleton, cell.limits)
        self._remembered = Remembered(rig, cell.volume, cell.limits)

    @property
    def frame_s(self) -> float:
        """When the newest frame was published, Unix time; NaN: none has come."""
        newest = self._newest
        return math.nan if newest is None else newest[0].published_s

    def publish(self, frame: LiveFrame) -> None:
        """The newest frame. Never blocks."""
        self._ok_since_s = {
            # At the start it is the tracker that says since when.
            camera.name: self._ok_since_s.get(camera.name, -math.inf if self._newest is None else frame.published_s)
            for camera in frame.cameras
            if camera.state is CameraState.OK
        }
        if self._newest is not None:
            before, places = self._newest
            self._remembered.add(frame, before, places)
        self._newest = frame, self._reach.places(frame, self._unseen.away_m(frame))

    def close(self) -> None:
        """Does nothing: there is nothing to close."""

    def reset(self) -> None:
        """Clear the latched faults of all links. A cause that is still there is a fault again at once."""
        self._faults.clear()

    def measure(
        self, poses: Mapping[str, np.ndarray], now_s: float, poses_s: Mapping[str, float] | None = None
    ) -> tuple[LinkDistance, ...]:
        """Smallest distance of each link, in the order of the cell.

        Args:
            poses: (4, 4) pose of each link in the world (world_T_link, metres). A link without one, or with one that is
                not a rigid transform, has a fault; other names are ignored. Zones need none.
            now_s: Unix time.
            poses_s: of when each pose is, Unix time; by default, of now.
        """
        newest, links = self._newest, self._links.links
        if newest is not None and math.isnan(newest[0].time_s):  # before the first image
            newest = None
        frame = None if newest is None else newest[0]
        world_T_link, is_rigid = world_poses(links, poses)
        known_s = {name: now_s if poses_s is None else poses_s.get(name, math.nan) for name in poses}
        pose_s = [now_s if link.is_fixed else known_s.get(link.name, math.nan) for link in links]
        if newest is None or frame is None:
            measured, incomplete, lost, nobodys = None, _nobody(len(links)), _nobody(len(links)), [""] * len(links)
        else:
            measured = self._measured(newest[1], world_T_link, max(now_s - taken_s(frame), 0.0))
            incomplete = self._incomplete(frame, measured)
            self._approach.add(frame, measured.expected_m.min(axis=1))
            lost = self._lost(frame, world_T_link)
            ok = [camera.name for camera in frame.cameras if camera.state is CameraState.OK]
            nobodys = self._nobodys.near(frame, ok, self._links.shapes(world_T_link), self._links.link_of_shape)
        now_ok = {name for name, since_s in self._ok_since_s.items() if now_s - since_s >= FOUND_S}
        of_frame, said = self._facts(frame, now_ok), []
        for number, link in enumerate(links):
            facts = replace(
                of_frame,
                pose_s=pose_s[number],
                is_rigid=bool(is_rigid[number]),
                observed_share=0.0 if frame is None else self._observed_share(now_ok, number, world_T_link[number]),
                incomplete=tuple(incomplete[number]),
                lost=tuple(lost[number]),
                nobodys=nobodys[number],
            )
            faults = faults_of(facts, self._limits, now_s)
            if faults:
                self._faults.setdefault(number, DistanceFault(faults[0], now_s))
            is_placed = facts.is_rigid and is_new(facts.pose_s, self._limits, now_s)
            nearest = self._nearest(number, frame, measured) if is_placed else _said(-math.inf, -math.inf)
            said.append(
                LinkDistance(
                    link=link.name,
                    **nearest,
                    age_s=math.inf if frame is None else now_s - facts.taken_s,
                    pose_age_s=now_s - facts.pose_s,
                    observed_share=facts.observed_share,
                    fault=self._faults.get(number),
                )
            )
        return tuple(said)

    def _facts(self, frame: LiveFrame | None, ok: Collection[str]) -> Facts:
        """What a frame tells of every link; nothing is known of any yet."""
        nothing = Facts(math.nan, math.nan, math.nan, math.nan, is_rigid=False, observed_share=0.0)
        if frame is None:
            return nothing
        state, at_s = {camera.name: camera.state for camera in frame.cameras}, taken_s(frame)
        return replace(
            nothing,
            taken_s=at_s,
            tracking_since_s=frame.tracking_since_s,
            tracked_s=frame.time_s,
            not_ok=tuple(
                f"{name} {self._said_of(name, state.get(name))}" for name in self._camera_names if name not in ok
            ),
            unproven=tuple(camera.name for camera in in_use(frame) if camera.unproven_s is None),
            doubt_s=frame.time_s - at_s,
        )

    def _said_of(self, name: str, state: CameraState | None) -> str:
        return "missing" if state is None else f"{state.value}{' again' if name in self._ok_since_s else ''}"

    def _observed_share(self, ok: Collection[str], link: int, world_T_link: Float[np.ndarray, "4 4"]) -> float:
        return self._links.observed_share(link, world_T_link, np.array([name in ok for name in self._camera_names]))

    def _measured(self, places: Places, world_T_link: Float[np.ndarray, "link 4 4"], age_s: float) -> _Measured:
        body, n_links = self._body, len(self._links.links)
        has_place = np.isfinite(places.away_m)[:, body.joints].all(axis=(-2, -1))
        person, capsule = np.nonzero(has_place)
        of_shapes = clearance(
            self._axes(places, person, capsule), self._links.shapes(world_T_link), self._limits.quantile
        )
        least_m = np.full((*has_place.shape, n_links), -np.inf)
        expected_m, along = np.full_like(least_m, np.inf), np.zeros_like(least_m)
        for link in range(n_links):
            shapes = np.flatnonzero(self._links.link_of_shape == link)
            best = shapes[of_shapes.least_m[:, shapes].argmin(axis=1)]
            of_best = np.arange(len(best)), best
            least_m[person, capsule, link] = of_shapes.least_m[of_best]
            expected_m[person, capsule, link] = of_shapes.expected_m[of_best]
            along[person, capsule, link] = of_shapes.along[of_best]
        unseen_m = places.away_m[:, body.joints].max(axis=(-2, -1))[person, capsule, None]
        least_m[person, capsule] = np.minimum(least_m[person, capsule], expected_m[person, capsule] - unseen_m)
        least_m -= self._speed_m_s[:, None] * age_s
        is_known = np.asarray(places.is_known[:, body.joints].all(axis=(-2, -1)))
        # Whatever is not a number may be anywhere.
        return _Measured(np.where(np.isnan(least_m), -np.inf, least_m), expected_m, along, is_known)

    def _axes(self, places: Places, person: Int[np.ndarray, " row"], capsule: Int[np.ndarray, " row"]) -> Axes:
        """Of these capsules of these people."""
        body = self._body
        return Axes(
            body.ends_m(places.positions_m)[person, capsule],
            places.covariance_m2[person[:, None, None], body.joints[capsule]],
            body.radius_m[capsule],
            body.is_sphere[capsule],
        )

    def _incomplete(self, frame: LiveFrame, measured: _Measured) -> list[list[str]]:
        """By link, the people near it, or anywhere, of whom joints are missing."""
        nowhere, incomplete = measured.without_place, _nobody(len(self._links.links))
        for number, person in enumerate(frame.people):
            missing = [self._skeleton.joints[joint] for joint in self._body.missing(person)]
            is_near = measured.expected_m[number].min(axis=0) < self._limits.missing_within_m
            lacks = f"has no estimate of {', '.join(missing)}" if missing else "may be anywhere"
            for link in np.flatnonzero((is_near & bool(missing)) | (number in nowhere)).tolist():
                incomplete[link].append(f"person {person.person} {lacks}")
        return incomplete

    def _lost(self, frame: LiveFrame, world_T_link: Float[np.ndarray, "link 4 4"]) -> list[list[str]]:
        """By link, who was lost near it and was not seen again."""
        lost = _nobody(len(self._links.links))
        for missing in self._remembered.people:
            least_m, ago_s = self._measured(missing.places, world_T_link, 0.0).least_m[0], frame.time_s - missing.time_s
            for link, of_link_m in enumerate(least_m.min(axis=0).tolist()):
                if of_link_m < self._limits.surroundings_m:
                    where = f"{max(of_link_m, 0.0):.1f} m from it {ago_s:.1f} s ago"
                    lost[link].append(f"person {missing.person} was lost {where}, and not seen again")
        return lost

    def _nearest(self, link: int, frame: LiveFrame | None, measured: _Measured | None) -> dict[str, Any]:
        if frame is None or measured is None or measured.without_place:
            return _said(-math.inf, -math.inf)
        if not frame.people:
            return _said(math.inf, math.inf)
        least_m = measured.least_m[:, :, link]
        number, capsule = np.unravel_index(np.argmin(least_m), least_m.shape)
        end = int(measured.along[number, capsule, link] > 0.5)
        return {
            "distance_m": float(least_m[number, capsule]),
            "expected_m": float(measured.expected_m[number, capsule, link]),
            "person": frame.people[number].person,
            "part": self._body.names[capsule],
            "joint": self._skeleton.joints[self._body.joints[capsule, end, 0]],
            "closing_m_s": self._approach.closing_m_s(int(number), link),
        }


def taken_s(frame: LiveFrame) -> float:
    """The earliest at which the images may have been taken that the people of a frame come from."""
    return frame.time_s - max((camera.unproven_s or 0.0 for camera in in_use(frame)), default=0.0)


def in_use(frame: LiveFrame) -> list[CameraStatus]:
    """The cameras whose images may have entered a frame."""
    gone = (CameraState.LOST, CameraState.RECONNECTING)
    return [camera for camera in frame.cameras if camera.state not in gone]


def _nobody(n_links: int) -> list[list[str]]:
    return [[] for _ in range(n_links)]


def _said(distance_m: float, expected_m: float) -> dict[str, Any]:
    """Nobody is there, or people or the link may be anywhere."""
    nobody = {"person": None, "part": "", "joint": "", "closing_m_s": math.nan}
    return {"distance_m": distance_m, "expected_m": expected_m, **nobody}
