"""Who sends to the live system in the storm: cameras, a robot, and others who should not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from distance_truth import RESET_EVERY_S, world_T_arm
from fgpose.people_observations import Detections
from fgpose.robot.distance_messages import encode_robot
from storm_camera import MOST_CONNECTIONS, StormCamera, others
from storm_plan import PlannedFault, StormSession
from storm_reception import Reception
from storm_visitors import StormVisitors
from timeline import Timeline

_ROBOT, _OTHER = MOST_CONNECTIONS, MOST_CONNECTIONS + 100
_ROBOT_HZ, _TRANSIT_S = 10.0, 0.003


class StormSenders:
    """Cameras and robot, which send as long as a session lasts, and others.

    Args:
        session: what happens.
        reception: of what they send.
        visitors: who is seen.
        timeline: on which they send.
        rate_hz: of the cameras.
        rng: of what others send.
    """

    def __init__(
        self,
        session: StormSession,
        reception: Reception,
        visitors: StormVisitors,
        timeline: Timeline,
        rate_hz: float,
        rng: np.random.Generator,
    ) -> None:
        self._session, self._reception, self._visitors, self._timeline = session, reception, visitors, timeline
        self._rate_hz, self._rng, self._began_s = rate_hz, rng, timeline.clock.now_s()
        self._robot_faults: dict[str, PlannedFault] = {}
        self._reset_s = -math.inf
        self._is_over = False
        first = math.ceil(visitors.number(self._began_s))
        for camera in reception.cameras.values():
            self._again(visitors.time_s(first), lambda camera=camera: self._take_image(camera, first))
        self._again(self._began_s, lambda: self._move(self._began_s))

    def end(self) -> None:
        """Nobody sends any more."""
        self._is_over = True

    def begin_fault(self, fault: PlannedFault) -> None:
        """Of a camera, its clock, messages or the robot."""
        if "robot" in fault.kind:
            self._robot_faults[fault.kind] = fault
            return
        if fault.kind in ("second sender", "copies ahead", "says nobody", "garbage", "flood", "poison"):
            self._again(fault.begin_s, lambda: self._disturb(fault, fault.begin_s))
            return
        # What all detectors say together nobody can tell from the truth.
        only_one = fault.kind == "wrong people" or (fault.kind == "freezes" and not self._is_somebody_seen(fault))
        for name in fault.cameras[:1] if only_one else fault.cameras:
            self._reception.cameras[name].faults[fault.kind] = fault
            if fault.kind in ("source fails", "cameras end"):
                self._reception.live[name].failed("nothing answers there")

    def end_fault(self, fault: PlannedFault) -> None:
        """It is over."""
        self._robot_faults.pop(fault.kind, None)
        for name in fault.cameras:
            camera = self._reception.cameras[name]
            if camera.faults.pop(fault.kind, None) is None:
                continue
            if fault.kind == "reconnects":
                camera.connection = int(self._rng.integers(MOST_CONNECTIONS))
            elif fault.kind == "source fails":
                self._reception.live[name].connected()
            elif fault.kind == "cameras end":
                self._reception.begin(name)

    def _again(self, time_s: float, do: Callable[[], None]) -> None:
        self._timeline.at(time_s, lambda: None if self._is_over else do())

    def _is_somebody_seen(self, fault: PlannedFault) -> bool:
        number = int(self._visitors.number(fault.begin_s)) + 1
        return all(self._visitors.seen(name, number).n_people for name in fault.cameras)

    def _take_image(self, camera: StormCamera, number: int) -> None:
        taken_s = self._visitors.time_s(number)
        self._again(self._visitors.time_s(number + 1), lambda: self._take_image(camera, number + 1))
        found = camera.found(self._visitors.seen(camera.camera.name, number))
        stamp_s, arrives_s = camera.stamp_s(taken_s, taken_s - self._began_s), camera.arrives_s(taken_s)
        n_times = 2 if "shuffled" in camera.faults and self._rng.random() < 0.3 else 1
        for _ in range(n_times) if math.isfinite(arrives_s) else ():
            self._again(arrives_s, lambda: self._reception.image(camera, found, stamp_s))

    def _disturb(self, fault: PlannedFault, now_s: float) -> None:
        """Others send under the names of cameras, or anything."""
        period_s = 1.0 / (self._rate_hz * (1 + 3 * fault.amount))
        if now_s + period_s < fault.end_s:
            self._again(now_s + period_s, lambda: self._disturb(fault, now_s + period_s))
        for name in fault.cameras:
            number = int(self._visitors.number(now_s))
            old = self._visitors.seen(name, number - round(2 * self._rate_hz))
            found, stamp_s = old, now_s - 0.03
            if fault.kind == "copies ahead":
                stamp_s = now_s + 0.4
            elif fault.kind == "says nobody":
                found = Detections(name, 0.0, old.points2d_px[:0], old.confidence[:0])
            elif fault.kind in ("second sender", "flood"):
                found = others(old, self._rng)
            bodies = [self._reception.body(found, stamp_s)]
            if fault.kind == "garbage":
                bodies = [self._rng.bytes(45) for _ in range(20)]
            elif fault.kind == "flood":
                bodies *= 20
            elif fault.kind == "poison":
                bodies = [body[: len(body) // 2] + body[: len(body) // 3] for body in bodies]
                bodies.append(self._reception.body(found, math.nan))
            for body in bodies:
                self._reception.message(body, _OTHER)

    def _move(self, now_s: float) -> None:
        """The robot says where it is."""
        self._again(now_s + 1 / _ROBOT_HZ, lambda: self._move(now_s + 1 / _ROBOT_HZ))
        faults, says_times = self._robot_faults, self._session.robot_says_times
        if "robot stops" in faults:
            return
        is_reset = now_s >= self._reset_s + RESET_EVERY_S
        self._reset_s = now_s if is_reset else self._reset_s
        arrives_s = now_s + _TRANSIT_S
        if "robot late" in faults:
            arrives_s += 0.3 + faults["robot late"].amount
            # Whoever does not say when a pose is promises that it comes at once.
            if not says_times:
                return
        if "robot pauses" in faults:
            arrives_s = max(arrives_s, faults["robot pauses"].end_s)
        bodies = [self._pose(now_s, reset=is_reset)]
        if "robot flood" in faults:
            bodies = [self._pose(now_s - 1.0 + k / 100, reset=False) for k in range(100)] + bodies
        if "robot garbage" in faults:
            bodies += [self._rng.bytes(45) for _ in range(30)] + [encode_robot({"leg": np.eye(4)})]
        for body in bodies:
            self._again(arrives_s, lambda body=body: self._reception.robot_message(body, _ROBOT))
        if "second robot" in faults:
            away = encode_robot({"arm": world_T_arm(now_s + 2 * math.pi)})
            self._again(arrives_s, lambda: self._reception.robot_message(away, _ROBOT + 1))

    def _pose(self, at_s: float, *, reset: bool) -> bytes:
        pose, faults = world_T_arm(at_s), self._robot_faults
        if "robot scaled" in faults:
            pose[:3, :3] *= 1.05
        said_s = at_s + (0.15 + faults["robot ahead"].amount if "robot ahead" in faults else 0.0)
        return encode_robot({"arm": pose}, time_s=said_s if self._session.robot_says_times else None, reset=reset)
