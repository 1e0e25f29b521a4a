"""Two causes at once of all cameras, neither of which makes them agree without the other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

from fgpose.diagnosis.hypotheses.cameras import pose_hypotheses
from fgpose.diagnosis.hypotheses.exchanged import exchange_hypotheses
from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis
from fgpose.diagnosis.hypotheses.images import normalised_hypotheses, turned_hypotheses
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.diagnosis.hypotheses.sizes import simple_size_hypotheses


def pair_hypotheses(scene: SynchronousViews) -> Iterator[tuple[Hypothesis, Hypothesis]]:
    """Of different kinds, without those that a grid is searched for; the one that is put right first is the first."""
    everybody = tuple(range(scene.n_cameras))
    # Turned back are pixels of images that are as large as the calibration's.
    kinds = (
        [*normalised_hypotheses(scene, everybody), *simple_size_hypotheses(scene, everybody)],
        list(turned_hypotheses(scene, everybody)),
        list(exchange_hypotheses(scene, everybody)),
        [each for each in pose_hypotheses(scene) if each.cameras == everybody and not each.of_many],
    )
    for first, second in combinations(kinds, 2):
        yield from product(first, second)
