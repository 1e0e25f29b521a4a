"""All kinds of factors, and the two forms of a cost that are made from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, runtime_checkable

import gtsam

from fgpose.estimation.factors.anchor import Anchors
from fgpose.estimation.factors.bone_length import bone_lengths
from fgpose.estimation.factors.depth import Depths
from fgpose.estimation.factors.fading import Fading
from fgpose.estimation.factors.held import Held
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.factors.prior import LengthPriors, Priors
from fgpose.estimation.factors.projection import Projections
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.factors.symmetry import Symmetries
from fgpose.estimation.keys import Keys
from fgpose.estimation.segment import Segment


@runtime_checkable
class Cost(Protocol):
    """A part of the cost of a segment: half the sum of squared whitened residuals, or of their robust losses."""

    def error(self, state: BatchState) -> float: ...

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None: ...

    def add_information(self, information: Information, state: BatchState) -> None: ...


@runtime_checkable
class Factors(Cost, Protocol):
    """All factors of a kind in a segment, as one table: a part of the cost, in numpy, and a part of a graph, GTSAM's
    factors, one a row."""

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]: ...


KINDS: tuple[Callable[[Segment], Iterable[Factors]], ...] = (
    Projections.of,
    Anchors.of,
    Held.of,
    Depths.of,
    Symmetries.of,
    bone_lengths,
    Motions.of,
    Fading.of,
    Priors.of,
    LengthPriors.of,
)


def factors_of(segment: Segment) -> list[Factors]:
    """All factors of a segment, by kind; a kind may have several tables (a camera each) or none."""
    return [factors for kind in KINDS for factors in kind(segment)]


def graph_factors(segment: Segment) -> Iterator[gtsam.NonlinearFactor]:
    """The same for a GTSAM graph."""
    for factors in factors_of(segment):
        yield from factors.graph_factors(segment.keys)
