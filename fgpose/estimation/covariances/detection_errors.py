"""How large the errors of detections are, how long they last and which joints share them, from what the views of a
frame contradict each other by.

With J the Jacobian of a joint's detections in one frame, in their standard deviations, P = 1 - J (J' J)^-1 J' projects
onto what no position of the joint explains (the parity space of its views). There the residual r is the error e, P r =
P e, whatever the pose: neither bones nor motion have smoothed it. If the errors of joints j and l have the covariance v
after k frames, in every view alike and independent between views,

    E[(P r)_t,j . (P r)_t+k,l] = v tr(P_t,j P_t+k,l).

Two cameras have one such dimension for each joint, four have five. What all views have in common is in none of them: it
looks like another position. So errors are those against the joint as the detector sees it from all sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.vectors import norm

_LONGEST_LAG_S, _MOST_LAGS = 1.0, 12
IN_LINE = 1e-9
"""Of the trace of the information on a joint: two cameras in line with it do not tell its distance."""
_LEAST_DIMENSIONS = 1e-6
_GOOD_WEIGHT = 0.3  # detections with less are rejected: hallucinations have correlations of their own
# A rejected detection that is nearer to the pose, in its standard deviations, may be of a visible joint: errors that
# last are rejected long before white ones of this size. At 4 and 6 the 50 % ellipsoids hold 10 % fewer and more errors
# where detections are coarse, elsewhere 5.
_MAY_BE_VISIBLE, _RING = 5.0, 1.5


@dataclass(frozen=True, eq=False)
class Parity:
    """What the views of some frames contradict each other by."""

    residual: Float[np.ndarray, "frame joint view"]
    """In parity space, in standard deviations; a view is one axis of the image of one camera."""
    explained: Float[np.ndarray, "frame joint view 3"]
    """Orthonormal basis of what a move of the joint explains."""
    known: Bool[np.ndarray, "frame joint view"]

    @staticmethod
    def of(
        residual: Float[np.ndarray, "frame camera joint 2"],
        jacobian: Float[np.ndarray, "frame camera joint 2 3"],
        known: Bool[np.ndarray, "frame camera joint"],
    ) -> Parity:
        """Of the known detections, where there are two of a joint.

        Args:
            residual, jacobian: of the projection of any pose near the optimum, in standard deviations of the
                detections.
            known: which detections count.
        """
        known = known & (known.sum(axis=1, keepdims=True) >= 2)
        of_view = np.repeat(known.transpose(0, 2, 1), 2, axis=-1)
        residual = np.where(known[..., None], residual, 0.0).transpose(0, 2, 1, 3).reshape(of_view.shape)
        jacobian = np.where(known[..., None, None], jacobian, 0.0).transpose(0, 2, 1, 3, 4).reshape(*of_view.shape, 3)
        information = jacobian.swapaxes(-1, -2) @ jacobian
        root = np.linalg.cholesky(invertible(information))
        explained = np.linalg.solve(root, jacobian.swapaxes(-1, -2)).swapaxes(-1, -2)
        moved = explained @ (explained.swapaxes(-1, -2) @ residual[..., None])
        return Parity(np.where(of_view, residual - moved[..., 0], 0.0), explained, of_view)

    def frames(self, frames: slice | Int[np.ndarray, " frame"]) -> Parity:
        """Some of the frames."""
        return Parity(self.residual[frames], self.explained[frames], self.known[frames])

    def times(self, factor: Float[np.ndarray, "frame 1 1"]) -> Parity:
        """With residuals so many times as large; where that is nothing, of detections that are not known."""
        known = factor > 0
        return Parity(factor * self.residual, known[..., None] * self.explained, known & self.known)

    @staticmethod
    def joined(parts: list[Parity]) -> Parity:
        """Of parts that follow each other."""
        return Parity(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))


def invertible(information: Float[np.ndarray, "*joints 3 3"]) -> Float[np.ndarray, "*joints 3 3"]:
    """On joints, also on those that cameras in line see, or none."""
    trace = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
    return information + np.where(trace > 0, IN_LINE * trace, 1.0) * np.eye(3)


@dataclass(frozen=True, eq=False)
class TellingDetections:
    """The detections that tell how large errors are: those that were accepted, and those that were rejected although a
    visible joint might have given them. To leave these out is to leave out the largest errors."""

    parities: tuple[Parity, Parity]
    """Of the accepted ones alone, and of all."""
    within: float
    """Number of the rejected ones that are near."""
    around: float
    """Of those in a ring around them, in whose place no visible joint is seen."""

    @staticmethod
    def of(
        residual: Float[np.ndarray, "frame camera joint 2"],
        jacobian: Float[np.ndarray, "frame camera joint 2 3"],
        weights: Float[np.ndarray, "frame camera joint"],
    ) -> TellingDetections:
        """Of all detections; a joint that is not seen has a Jacobian of zero.

        Args:
            residual, jacobian: in standard deviations of the detections as they are weighted.
            weights: of the detections, small where they were rejected.
        """
        seen, good = np.asarray(jacobian.any(axis=(-2, -1))), accepted(jacobian, weights)
        # As if a rejected one had the weight of others.
        usual = float(weights[good].mean()) if good.any() else 1.0
        scale = np.where(seen & ~good, np.sqrt(usual / np.where(seen, weights, 1.0)), 1.0)
        residual, jacobian = scale[..., None] * residual, scale[..., None, None] * jacobian
        rejected = np.where(seen & ~good, norm(np.where(seen[..., None], residual, 0.0)), np.inf)
        near, far = rejected < _MAY_BE_VISIBLE, rejected < _RING * _MAY_BE_VISIBLE
        alone = Parity.of(residual, jacobian, good)
        both = Parity.of(residual, jacobian, good | near) if near.any() else alone
        return TellingDetections((alone, both), float(near.sum()), float(far.sum() - near.sum()))

    def in_sizes(self, sizes: Float[np.ndarray, " frame"]) -> TellingDetections:
        """With errors in these variances of each frame; where that is 0, they tell nothing."""
        factor = np.divide(1.0, np.sqrt(sizes), out=np.zeros_like(sizes), where=sizes > 0)
        alone, both = (each.times(factor[:, None, None]) for each in self.parities)
        return replace(self, parities=(alone, both))


def accepted(
    jacobian: Float[np.ndarray, "frame camera joint 2 3"], weights: Float[np.ndarray, "frame camera joint"]
) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections that are probably of their joints; one that is not seen has a Jacobian of zero."""
    return np.asarray(jacobian.any(axis=(-2, -1)) & (weights > _GOOD_WEIGHT))


def share_of_visible(within: float, around: float) -> float:
    """Of the rejected detections that are near, how many are more than hallucinations would be, which are as dense in
    the ring around them."""
    return max(1.0 - around / (_RING**2 - 1) / within, 0.0) if within else 0.0


@dataclass(frozen=True, eq=False)
class ErrorProducts:
    """Sums over frames of products of errors in parity space, and what these would be if all errors were the same and
    of variance 1: its dimensions."""

    n_frames: float
    later: Float[np.ndarray, "lag joint"]
    """With the error of the same joint some frames later."""
    later_dimensions: Float[np.ndarray, "lag joint"]
    others: Float[np.ndarray, "joint joint"]
    """With the errors of the other joints in the same frame."""
    others_dimensions: Float[np.ndarray, "joint joint"]
    axes: Float[np.ndarray, "joint axis"]
    """Of the errors with themselves, by axis of the image: horizontal and vertical."""
    axes_dimensions: Float[np.ndarray, "joint axis axis"]
    """What each is if the errors along one of the axes have variance 1, and the others none."""

    @staticmethod
    def of(parity: Parity, lags: Int[np.ndarray, " lag"], spread: Int[np.ndarray, " frame"]) -> ErrorProducts:
        """Of a recording.

        Args:
            parity: of consecutive frames.
            lags: number of frames, the first 0.
            spread: frames that tell which joints share their errors; neighbours tell the same.
        """
        n_frames = len(parity.residual)
        pairs = [(parity.frames(slice(0, n_frames - lag)), parity.frames(slice(lag, None))) for lag in lags.tolist()]
        later = [tuple(part.sum(axis=0) for part in products_later(*pair)) for pair in pairs]
        squared, dimensions = (np.stack(parts) for parts in zip(*later, strict=True))
        others, axes = products_of_others(parity.frames(spread)), products_of_axes(parity)
        return ErrorProducts(float(n_frames), squared, dimensions, *others, *axes)

    def mixed(self, other: ErrorProducts, share: float) -> ErrorProducts:
        """With this share of others."""
        return ErrorProducts(*((1 - share) * own + share * getattr(other, name) for name, own in vars(self).items()))

    @property
    def autocovariance(self) -> Float[np.ndarray, "lag joint"]:
        """0 where nothing is known."""
        return self.later / np.maximum(self.later_dimensions, _LEAST_DIMENSIONS)

    @property
    def correlation(self) -> Float[np.ndarray, "joint joint"]:
        """Between the errors of joints in one view; 0 where nothing is known."""
        covariance = self.others / np.maximum(self.others_dimensions, _LEAST_DIMENSIONS)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        product = np.outer(sigma, sigma)
        return np.clip(np.divide(covariance, product, out=np.zeros_like(product), where=product > 0), -1.0, 1.0)


def lags_of(n_frames: int, step_s: float) -> Int[np.ndarray, " lag"]:
    """At which the autocovariance is taken, in frames; the first is none. The next frame always counts: of frames that
    are far apart it tells what is constant."""
    longest = min(max(int(_LONGEST_LAG_S / step_s), 1), n_frames - 1)
    return np.unique([0, *np.geomspace(1, max(longest, 1), _MOST_LAGS).astype(int)]) if longest else np.zeros(1, int)


def products_later(
    earlier: Parity, later: Parity
) -> tuple[Float[np.ndarray, "frame joint"], Float[np.ndarray, "frame joint"]]:
    """Of each frame with the one at the same place in the other, and the dimensions of their common parity space."""
    both = earlier.known & later.known
    squared = np.einsum("tjv,tjv->tj", earlier.residual, later.residual)
    own = np.vecdot(earlier.explained, earlier.explained) + np.vecdot(later.explained, later.explained)
    shared = earlier.explained.swapaxes(-1, -2) @ later.explained
    return squared, (both * (1.0 - own)).sum(axis=-1) + (shared**2).sum(axis=(-1, -2))


def products_of_others(parity: Parity) -> tuple[Float[np.ndarray, "joint joint"], Float[np.ndarray, "joint joint"]]:
    """The same for every pair of joints in one frame, summed over the frames."""
    known, explained = parity.known.astype(float), parity.explained
    squared = np.einsum("tjv,tkv->jk", parity.residual, parity.residual, optimize=True)
    by_view = np.einsum("tjv,tkv->jk", np.sum(explained**2, axis=-1), known, optimize=True)
    n_frames, n_joints, n_views, _ = explained.shape
    basis = explained.transpose(0, 1, 3, 2).reshape(n_frames, 3 * n_joints, n_views)
    shared = np.sum((basis @ basis.swapaxes(-1, -2)) ** 2, axis=0).reshape(n_joints, 3, n_joints, 3).sum(axis=(1, 3))
    return squared, np.einsum("tjv,tkv->jk", known, known, optimize=True) - by_view - by_view.T + shared


def products_of_axes(parity: Parity) -> tuple[Float[np.ndarray, "joint axis"], Float[np.ndarray, "joint axis axis"]]:
    """Of each joint's errors with themselves by axis of the image, and their dimensions, summed over the frames."""
    n_views = parity.residual.shape[-1]
    own = parity.known[..., None] * np.eye(n_views)
    projection = own - parity.explained @ parity.explained.swapaxes(-1, -2)
    by_axis = np.sum(projection**2, axis=0).reshape(-1, n_views // 2, 2, n_views // 2, 2).sum(axis=(1, 3))
    return np.sum(parity.residual**2, axis=0).reshape(-1, n_views // 2, 2).sum(axis=1), by_axis
