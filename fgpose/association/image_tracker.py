"""Following people in the images of one camera alone, where no other camera agrees on them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.association.midlines import comparable, median_distance
from fgpose.association.person import Person, matches

# The box around a standing person is about as large as the person: this makes pixels metres, to a factor of two.
_BODY_M = 1.7


def follow_in_images(
    undistorted_px: Float[np.ndarray, "frame person joint 2"],
    midlines_px: Float[np.ndarray, "frame person feature 2"],
    completeness: Float[np.ndarray, "frame person"],
    time_s: Float[np.ndarray, " frame"],
) -> list[Person]:
    """Everybody in the images of one camera, frame by frame: each is the nearest to where they were before."""
    people: list[Person] = []
    metres_per_px = _BODY_M / _size_px(undistorted_px)
    free = comparable(midlines_px)
    for frame, now_s in enumerate(time_s.tolist()):
        for person, candidate in _matched(people, now_s, midlines_px[frame], metres_per_px[frame], free[frame]):
            person.move(midlines_px[frame, candidate], now_s)
            person.chosen[frame, 0], free[frame, candidate] = candidate, False
        for candidate in np.flatnonzero(free[frame]).tolist():
            person = Person(midlines_px[frame, candidate], now_s, (len(time_s), 1))
            person.chosen[frame, 0] = candidate
            people.append(person)
        for person in people:
            person.count(frame, completeness[frame][None])
        people = [person for person in people if person.is_real(now_s)]
    return people


def _matched(
    people: list[Person],
    time_s: float,
    midlines_px: Float[np.ndarray, "person feature 2"],
    metres_per_px: Float[np.ndarray, " person"],
    free: np.ndarray,
) -> list[tuple[Person, int]]:
    if not people:
        return []
    places_px = np.stack([person.place for person in people])
    distance_m = median_distance(np.linalg.norm(places_px[:, None] - midlines_px, axis=-1)) * metres_per_px
    reach_m = np.array([person.reach_m(time_s) for person in people])
    return [(people[k], candidate) for k, candidate in matches(distance_m, reach_m, free)]


def _size_px(points_px: Float[np.ndarray, "*people joint 2"]) -> Float[np.ndarray, "*people"]:
    """Diagonal of the box around each person's joints; a pixel at least."""
    known = np.isfinite(points_px)
    largest = np.where(known, points_px, -np.inf).max(axis=-2)
    smallest = np.where(known, points_px, np.inf).min(axis=-2)
    extent_px = np.where(known.any(axis=-2), largest - smallest, 0.0)
    return np.maximum(np.linalg.norm(extent_px, axis=-1), 1.0)
