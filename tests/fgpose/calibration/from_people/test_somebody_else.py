"""Views of somebody else than the walker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walks import SKELETON, walk

from fgpose.calibration.from_people.rig.somebody_else import with_the_walker
from fgpose.calibration.from_people.starts.starts import GivenStart, Starts, find_starts
from fgpose.calibration.from_people.walk import Track, Walk
from fgpose.geometry.triangulation import triangulate_robust
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(4)
N_FRAMES = 120


def tracks_of(people: Walk, frames: slice = slice(None)) -> dict[str, Track]:
    return {
        name: Track(name, people.time_s[frames], people.points2d_px[frames, c], people.confidence[frames, c])
        for c, name in enumerate(people.camera_names)
    }


def exchanged(walker: Walk, other: Walk, camera: int, frames: slice) -> Walk:
    """The walker, but for some frames in which a camera shows the other."""
    points2d_px = walker.points2d_px.copy()
    points2d_px[frames, camera] = other.points2d_px[frames, camera]
    return replace(walker, points2d_px=points2d_px)


@pytest.fixture(scope="module")
def two() -> tuple[Walk, Walk, Starts]:
    """Who walk on opposite sides of a circle: the second is half a round ahead."""
    whole = walk(RIG, 600)
    ahead = replace(
        whole, points2d_px=np.roll(whole.points2d_px, 300, axis=0), confidence=np.roll(whole.confidence, 300, axis=0)
    )

    def first(of: Walk) -> Walk:
        return replace(
            of, time_s=of.time_s[:N_FRAMES], points2d_px=of.points2d_px[:N_FRAMES], confidence=of.confidence[:N_FRAMES]
        )

    walker = first(whole)
    in_step = {name: GivenStart(0.0) for name in RIG.names}
    return walker, first(ahead), find_starts(tuple(tracks_of(walker).values()), SKELETON, RIG, in_step)


def joints_of(seen: Walk) -> np.ndarray:
    return triangulate_robust(seen.points2d_px, seen.confidence, RIG, 20.0).positions_m


def test_a_camera_that_exchanged_two_people_shows_the_walker_again(two: tuple[Walk, Walk, Starts]) -> None:
    walker, other, starts = two
    seen = exchanged(walker, other, 2, slice(40, 80))
    everybody = {name: [tracks_of(seen)[name], tracks_of(other)[name]] for name in RIG.names}
    everybody["ring_2"].append(tracks_of(walker, slice(35, 85))["ring_2"])
    found = with_the_walker(seen, everybody, starts, RIG, joints_of(seen))
    np.testing.assert_allclose(found.points2d_px, walker.points2d_px, atol=1e-6)


def test_what_nobody_else_explains_is_left_out(two: tuple[Walk, Walk, Starts]) -> None:
    walker, other, starts = two
    seen = exchanged(walker, other, 2, slice(40, 80))
    found = with_the_walker(seen, {name: [] for name in RIG.names}, starts, RIG, joints_of(seen))
    assert np.isnan(found.points2d_px[40:80, 2]).all()
    assert not found.confidence[40:80, 2].any()
    np.testing.assert_array_equal(found.points2d_px[:40], walker.points2d_px[:40])


def test_one_walker_stays_as_it_is(two: tuple[Walk, Walk, Starts]) -> None:
    walker, _, starts = two
    everybody = {name: [track] for name, track in tracks_of(walker).items()}
    assert with_the_walker(walker, everybody, starts, RIG, joints_of(walker)) is walker


def test_a_camera_that_is_always_elsewhere_is_not_silenced(two: tuple[Walk, Walk, Starts]) -> None:
    """It is the camera that is wrong, and the verdict must see it."""
    walker, other, starts = two
    seen = exchanged(walker, other, 2, slice(0, 110))
    assert with_the_walker(seen, {name: [] for name in RIG.names}, starts, RIG, joints_of(seen)) is seen
