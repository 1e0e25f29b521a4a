"""Keypoints that belong to other cameras, or to the other side of the body."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis, with_sides_exchanged
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.finding import Code

_TRY_ALL = 4  # cameras have 23 other orders, five 119


def exchange_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Some cameras in another order: any, of many cameras two exchanged, or all counted from another number."""
    same = tuple(range(scene.n_cameras))
    if len(cameras) <= _TRY_ALL:
        orders = [order for order in permutations(cameras) if order != cameras]
    else:
        orders = [tuple({a: b, b: a}.get(c, c) for c in cameras) for a, b in combinations(cameras, 2)]
        orders += [cameras[shift:] + cameras[:shift] for shift in range(1, len(cameras))]
    for order in orders:
        new = dict(zip(cameras, order, strict=True))
        yield _reordered(scene, tuple(new.get(c, c) for c in same))


def _reordered(scene: SynchronousViews, order: tuple[int, ...]) -> Hypothesis:
    """Each camera gets the keypoints of another one: order[camera]."""
    names, moved = scene.names, tuple(c for c, own in enumerate(order) if c != own)

    def mend(given: SynchronousViews) -> SynchronousViews:
        return given.with_views({c: given.views[c].with_points(given.views[order[c]].points_px) for c in moved})

    if len(moved) == 2:
        words = f"The keypoints of {names[moved[0]]} and {names[moved[1]]} are exchanged"
    else:
        pairs = ", ".join(f"those of {names[order[c]]} are of {names[c]}" for c in moved)
        words = f"The keypoints belong to other cameras: {pairs}"
    return Hypothesis(
        Code.EXCHANGED_CAMERAS,
        moved,
        mend,
        words,
        "Rename folders or cameras, so that each has its own keypoints; are cameras counted from 0 in one place and "
        "from 1 in the other?",
    )


def side_hypotheses(cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Left and right exchanged in these views throughout."""
    yield Hypothesis(
        Code.EXCHANGED_SIDES,
        cameras,
        lambda given: with_sides_exchanged(given, cameras),
        "Left and right joints are exchanged in {cameras} throughout",
        "Exchange them back; does another network, or another order of joints, make these keypoints?",
    )
