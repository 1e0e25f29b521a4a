"""Who walks where and when: routes of several people through one room, planned one person after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose_benchmarks.synthetic.crowd.bodies import Furniture
from fgpose_benchmarks.synthetic.crowd.floor_paths import AT_REST_MPS, curve, speed_profile, steps, turning_radps
from fgpose_benchmarks.synthetic.crowd.sitting import Seat
from fgpose_benchmarks.synthetic.noise import check_scales

_RESTARTS = 60
_TRIALS = 60  # of one leg; each takes about a millisecond
_WALL_M = 0.5  # nobody walks nearer to a wall or to furniture, but through a door
_DOOR_WALK_S = 5.0  # so long before an appointment somebody makes for a door
_RAMP_S = 0.6  # to walk off, and to come to rest
_MAX_TURN_RADPS = 2.0
_RISES = (0.7, 0.8)  # share of the recording after which somebody gets up from his seat
_MIN_SIT_S = 6.5  # 2 s of it to sit down and as many to get up
_SEAT_M, _FEET_M, _OWN_SEAT_M = 0.6, 0.5, 0.35  # who walks keeps so far from a seat, from the feet before it, from his
_FACING = -0.3  # cosine of the angle between the headings of two who cross, at most


@dataclass(frozen=True)
class CrowdPlan:
    """What people do in a room of which the world's origin is the middle of the floor.

    Raises:
        ValueError: a number is negative or not finite, a share lies outside [0, 1], or a lower limit exceeds its upper.
    """

    room_x_m: float = 6.0
    room_y_m: float = 6.0
    late_share: float = 0.25
    """Share of the people who come in after the start."""
    leaving_share: float = 0.25
    """Share of the people who leave for good before the end."""
    returning_share: float = 0.5
    """Share of the people who go out once and come back, through any door."""
    away_s: float = 5.0
    """How long they stay away, give or take a fifth."""
    working_share: float = 0.5
    """Share of the stops spent working on the spot; during the others people stand."""
    min_stop_s: float = 0.8
    """At the end of a leg: uniform from min_stop_s ..."""
    max_stop_s: float = 5.0
    """... to max_stop_s."""
    min_speed_mps: float = 0.7
    """Of each leg: uniform from min_speed_mps ..."""
    max_speed_mps: float = 1.4
    """... to max_speed_mps."""
    crossing_share: float = 0.6
    """Share of the legs that, where possible, lead past somebody who comes the other way."""
    min_crossing_m: float = 0.5
    """Distance of the pelvises when two pass each other: from min_crossing_m ..."""
    max_crossing_m: float = 0.8
    """... to max_crossing_m."""
    min_rest_distance_m: float = 0.85
    """Distance kept when at least one of two stands: arms need room."""

    def __post_init__(self) -> None:
        check_scales(self, shares=("late_share", "leaving_share", "returning_share", "working_share", "crossing_share"))
        for what in ("stop_s", "speed_mps", "crossing_m"):
            if getattr(self, f"min_{what}") > getattr(self, f"max_{what}"):
                raise ValueError(f"CrowdPlan.min_{what} must not exceed max_{what}")
        if self.min_speed_mps == 0 or min(self.room_x_m, self.room_y_m) <= 4 * _WALL_M:
            raise ValueError(f"CrowdPlan.min_speed_mps must be positive and the room larger than {4 * _WALL_M:g} m")


@dataclass(frozen=True, eq=False)
class Route:
    """The way of one person over the floor, frame by frame; NaN while he is not in the room."""

    ground_m: Float[np.ndarray, "frame 2"]
    work: Int[np.ndarray, " frame"]
    """Frame in which the work began that goes on in this frame, -1 where there is none."""
    sits: Bool[np.ndarray, " frame"]
    """At the seat, from before sitting down until after getting up: gestures are the work then."""
    seat: Seat | None = None

    def of_frames(self, frames: slice) -> Route:
        return Route(self.ground_m[frames], self.work[frames], self.sits[frames], self.seat)


@dataclass(frozen=True)
class Habit:
    """When somebody comes, makes for a door, how long he is away, and when he leaves for good; seconds, inf: never."""

    comes_s: float = 0.0
    trip_s: float = np.inf
    away_s: float = 5.0
    leaves_s: float = np.inf
    seat: Seat | None = None
    """Where somebody sits down as soon as possible."""
    rises_s: float = np.inf


@dataclass(frozen=True)
class _Leg:
    ground_m: Float[np.ndarray, "frame 2"]
    """Walk and stop."""
    n_walk: int


class _Planner:
    """Plans one person among others whose routes are fixed."""

    def __init__(
        self,
        rng: np.random.Generator,
        plan: CrowdPlan,
        fps: float,
        others_m: Float[np.ndarray, "person frame 2"],
        furniture: Sequence[Furniture],
        seats: Sequence[Seat],
    ) -> None:
        self.rng, self.plan, self.fps, self.others_m, self.furniture = rng, plan, fps, others_m, furniture
        self.seats = seats
        self.others_mps = np.array([steps(other_m) * fps for other_m in others_m]).reshape(others_m.shape)
        self.half_m = np.array([plan.room_x_m, plan.room_y_m]) / 2

    def route(self, habit: Habit) -> Route | None:
        """None where the person got stuck between the others."""
        n_frames = self.others_m.shape[1]
        route = Route(np.full((n_frames, 2), np.nan), np.full(n_frames, -1), np.zeros(n_frames, dtype=bool), habit.seat)
        comes = round(habit.comes_s * self.fps)
        if np.isfinite(habit.trip_s):
            gone = self._visit(route, comes, habit.trip_s, habit)
            if gone is None:
                return None
            comes = gone + round(habit.away_s * self.fps)
        return None if self._visit(route, comes, habit.leaves_s, habit) is None else route

    def _visit(self, route: Route, comes: int, goes_s: float, habit: Habit) -> int | None:
        """Fill in the frames from coming to going, in place. Gives the first frame after, None if stuck."""
        n_frames = len(route.ground_m)
        here_m, frame, to_door = (self._door() if comes > 0 else self._place()), comes, False
        while frame < n_frames and not to_door:
            to_door = frame / self.fps >= goes_s - _DOOR_WALK_S
            from_rest, to_seat = frame > comes or comes == 0, habit.seat is not None and not route.sits.any()
            if to_seat and not to_door:
                leg = self._leg_to_seat(here_m, frame, habit, from_rest=from_rest)
            else:
                leg = self._leg(here_m, frame, habit.seat, from_rest=from_rest, to_door=to_door)
            if leg is None:
                return None
            end = min(frame + len(leg.ground_m), n_frames)
            route.ground_m[frame:end] = leg.ground_m[: end - frame]
            if len(leg.ground_m) - leg.n_walk > 2 * self.fps and self.rng.random() < self.plan.working_share:
                route.work[frame + leg.n_walk : end] = frame + leg.n_walk
            route.sits[frame + leg.n_walk : end] = to_seat and not to_door
            here_m, frame = leg.ground_m[-1], end
        return frame

    def _leg_to_seat(
        self, start_m: Float[np.ndarray, " 2"], frame: int, habit: Habit, *, from_rest: bool
    ) -> _Leg | None:
        """To somebody's own seat; the stop is until he has got up."""
        assert habit.seat is not None
        for _ in range(_TRIALS):
            leg = self._random(start_m, np.array(habit.seat.feet_m), from_rest=from_rest, to_door=False)
            if leg is None:
                continue
            n_stay = round(max(habit.rises_s - (frame + leg.n_walk) / self.fps, _MIN_SIT_S) * self.fps)
            walk_m = leg.ground_m[: leg.n_walk]
            leg = _Leg(np.concatenate([walk_m, np.repeat(walk_m[-1:], n_stay, axis=0)]), leg.n_walk)
            if self._is_clear(leg, frame, habit.seat, to_door=False):
                return leg
        return None

    def _leg(
        self, start_m: Float[np.ndarray, " 2"], frame: int, seat: Seat | None, *, from_rest: bool, to_door: bool
    ) -> _Leg | None:
        """The first that keeps its distance; where a crossing is wanted, the first that crosses somebody, if any."""
        wants_crossing = self.rng.random() < self.plan.crossing_share
        spare = None
        for trial in range(_TRIALS):
            aimed = wants_crossing and trial % 2 == 0
            leg = self._aimed(start_m, frame, from_rest=from_rest, to_door=to_door) if aimed else None
            if leg is None:
                leg = self._random(
                    start_m, self._door() if to_door else self._place(), from_rest=from_rest, to_door=to_door
                )
            if leg is None or not self._is_clear(leg, frame, seat, to_door=to_door):
                continue
            if not wants_crossing or self._crosses(leg, frame):
                return leg
            spare = spare or leg
        return spare

    def _random(
        self, start_m: Float[np.ndarray, " 2"], end_m: Float[np.ndarray, " 2"], *, from_rest: bool, to_door: bool
    ) -> _Leg | None:
        bend_m = (start_m + end_m) / 2 + self.rng.normal(0.0, 0.35, 2)
        speed_mps = self.rng.uniform(self.plan.min_speed_mps, self.plan.max_speed_mps)
        return self._along(np.stack([start_m, bend_m, end_m]), speed_mps, from_rest=from_rest, to_door=to_door)

    def _aimed(self, start_m: Float[np.ndarray, " 2"], frame: int, *, from_rest: bool, to_door: bool) -> _Leg | None:
        """Past where somebody walks in a moment, at his side, and on to where he came from."""
        n_frames = self.others_m.shape[1]
        meeting = frame + int(self.rng.uniform(1.2, 4.0) * self.fps)
        if not len(self.others_m) or meeting >= n_frames:
            return None
        other = int(self.rng.integers(len(self.others_m)))
        place_m, velocity_mps = self.others_m[other, meeting], self.others_mps[other, meeting]
        other_mps = np.linalg.norm(velocity_mps)
        if not other_mps > self.plan.min_speed_mps / 2:
            return None
        heading = velocity_mps / other_mps
        beside_m = self.rng.choice([-1.0, 1.0]) * self.rng.uniform(self.plan.min_crossing_m, self.plan.max_crossing_m)
        via_m = place_m + beside_m * np.array([-heading[1], heading[0]])
        end_m = self._door() if to_door else via_m - self.rng.uniform(0.8, 2.5) * heading + self.rng.normal(0.0, 0.3, 2)
        needed_s = (meeting - frame) / self.fps - (_RAMP_S / 2 if from_rest else 0.0)
        speed_mps = float(np.linalg.norm(via_m - start_m)) / max(needed_s, 0.1)
        if not self.plan.min_speed_mps <= speed_mps <= self.plan.max_speed_mps:
            return None
        return self._along(np.stack([start_m, via_m, end_m]), speed_mps, from_rest=from_rest, to_door=to_door)

    def _along(
        self, points_m: Float[np.ndarray, "point 2"], speed_mps: float, *, from_rest: bool, to_door: bool
    ) -> _Leg | None:
        """Walk through points at one speed, then stop; None where the way is too short or bends too much."""
        line, way_m, at = curve(points_m)
        ramps_s = _RAMP_S / 2 * (from_rest + (not to_door))
        n_walk = round((way_m[-1] / speed_mps + ramps_s) * self.fps)
        if way_m[-1] < 0.8 or n_walk < 2 * _RAMP_S * self.fps:
            return None
        profile = speed_profile(n_walk, _RAMP_S * self.fps, from_rest=from_rest, to_rest=not to_door)
        walked_m = np.cumsum(profile) / profile.sum() * way_m[-1]
        walk_m = np.asarray(line(np.interp(walked_m, way_m, at)))
        if turning_radps(walk_m, self.fps) > _MAX_TURN_RADPS:
            return None
        stop_s = 0.0 if to_door else self.rng.uniform(self.plan.min_stop_s, self.plan.max_stop_s)
        stay_m = np.repeat(walk_m[-1:], round(stop_s * self.fps), axis=0)
        return _Leg(np.concatenate([walk_m, stay_m]), n_walk)

    def _is_clear(self, leg: _Leg, frame: int, seat: Seat | None, *, to_door: bool) -> bool:
        """Args: seat: of the person, if any."""
        n = min(len(leg.ground_m), self.others_m.shape[1] - frame)
        ground_m = leg.ground_m[:n]
        inset_m = self.half_m - _WALL_M
        # At a door people are within the distance from the wall.
        middle = slice(round(1.5 * self.fps), n - round(1.5 * self.fps) if to_door else n)
        if (np.abs(ground_m[middle]) > inset_m).any() or (np.abs(ground_m) > self.half_m + 1e-9).any():
            return False
        if any(_within(ground_m, box).any() for box in self.furniture):
            return False
        if any(_at_seat(ground_m, each, is_own=each == seat).any() for each in self.seats):
            return False
        distance_m = np.linalg.norm(self.others_m[:, frame : frame + n] - ground_m, axis=-1)
        rests = np.arange(n) >= leg.n_walk
        others_rest = np.linalg.norm(self.others_mps[:, frame : frame + n], axis=-1) < AT_REST_MPS
        if seat is not None:  # neighbours sit nearer to each other than people stand
            rests &= np.linalg.norm(ground_m - seat.feet_m, axis=-1) > self.plan.min_rest_distance_m
            others_rest &= np.linalg.norm(ground_m - seat.feet_m, axis=-1) > self.plan.min_rest_distance_m
        needed_m = np.where(others_rest | rests, self.plan.min_rest_distance_m, self.plan.min_crossing_m)
        return not (distance_m < needed_m).any()

    def _crosses(self, leg: _Leg, frame: int) -> bool:
        n = min(leg.n_walk, self.others_m.shape[1] - frame)
        own_m = leg.ground_m[:n]
        pairs = (crossing_frames(own_m, other_m[frame : frame + n], self.fps, self.plan) for other_m in self.others_m)
        return any(len(frames) > 0 for frames in pairs)

    def _place(self) -> Float[np.ndarray, " 2"]:
        return self.rng.uniform(-1.0, 1.0, 2) * (self.half_m - _WALL_M)

    def _door(self) -> Float[np.ndarray, " 2"]:
        """One of four, in the middle of each wall."""
        side = int(self.rng.integers(4))
        direction = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][side])
        return direction * self.half_m


def plan_route(
    rng: np.random.Generator,
    others_m: Float[np.ndarray, "person frame 2"],
    fps: float,
    plan: CrowdPlan,
    furniture: Sequence[Furniture],
    habit: Habit,
    seats: Sequence[Seat] = (),
) -> Route:
    """Of one more person, who keeps his distance from the others (world frame, metres; NaN: not there).

    Raises:
        ValueError: there is no room between the others.
    """
    planner = _Planner(rng, plan, fps, others_m, furniture, seats)
    for _ in range(_RESTARTS):
        route = planner.route(habit)
        if route is not None:
            return route
    raise ValueError(
        f"{len(others_m) + 1} people find no way around each other in {plan.room_x_m:g} x {plan.room_y_m:g} m"
    )


def draw_habits(
    rng: np.random.Generator, n_people: int, duration_s: float, plan: CrowdPlan, seats: Sequence[Seat] = ()
) -> list[Habit]:
    """Who comes late, goes out or leaves: shares of the people, rounded, in random order. Who does not go out has a
    seat, the first of them the first one."""

    def chosen(share: float) -> Bool[np.ndarray, " person"]:
        return np.asarray(rng.permutation(n_people) < round(share * n_people))

    late, leaving, returning = chosen(plan.late_share), chosen(plan.leaving_share), chosen(plan.returning_share)
    comes_s = np.where(late, rng.uniform(0.08, 0.3, n_people) * duration_s, 0.0)
    goes_s = np.where(leaving, rng.uniform(0.75, 0.95, n_people) * duration_s, np.inf)
    trip_s = np.where(returning, rng.uniform(0.35, 0.6, n_people) * duration_s, np.inf)
    away_s = plan.away_s * rng.uniform(0.8, 1.2, n_people)
    habits = [
        Habit(*values) for values in zip(*(array.tolist() for array in (comes_s, trip_s, away_s, goes_s)), strict=True)
    ]
    for person, seat in zip(np.flatnonzero(~returning).tolist(), seats, strict=False):
        habits[person] = replace(habits[person], rises_s=float(rng.uniform(*_RISES)) * duration_s, seat=seat)
    return habits


def crossing_frames(
    first_m: Float[np.ndarray, "frame 2"], second_m: Float[np.ndarray, "frame 2"], fps: float, plan: CrowdPlan
) -> Int[np.ndarray, " crossing"]:
    """Frames at which two people who walk towards each other are nearest, at the distance of a crossing."""
    distance_m = np.linalg.norm(first_m - second_m, axis=-1)
    velocities = [steps(way_m) * fps for way_m in (first_m, second_m)]
    speeds = [np.linalg.norm(velocity, axis=-1) for velocity in velocities]
    against = np.sum(velocities[0] * velocities[1], axis=-1) <= _FACING * speeds[0] * speeds[1]
    walking = (np.minimum(*speeds) > plan.min_speed_mps / 2) & against
    near = (distance_m >= plan.min_crossing_m - 0.05) & (distance_m <= plan.max_crossing_m)
    nearest = np.zeros(len(distance_m), dtype=bool)
    nearest[1:-1] = (distance_m[1:-1] < distance_m[:-2]) & (distance_m[1:-1] <= distance_m[2:])
    return np.flatnonzero(nearest & near & walking)


def _within(ground_m: Float[np.ndarray, "frame 2"], box: Furniture) -> Bool[np.ndarray, " frame"]:
    low_m, high_m = np.array(box.low_m[:2]) - _WALL_M, np.array(box.high_m[:2]) + _WALL_M
    return np.asarray(((ground_m > low_m) & (ground_m < high_m)).all(axis=-1))


def _at_seat(ground_m: Float[np.ndarray, "frame 2"], seat: Seat, *, is_own: bool) -> Bool[np.ndarray, " frame"]:
    """Who has no seat of his own there keeps clear of whoever may sit on it."""
    to_seat_m, to_feet_m = (np.linalg.norm(ground_m - place_m, axis=-1) for place_m in (seat.middle_m, seat.feet_m))
    return np.asarray(to_seat_m < _OWN_SEAT_M if is_own else (to_seat_m < _SEAT_M) | (to_feet_m < _FEET_M))
