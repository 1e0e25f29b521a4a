"""Each joint as it would be filtered alone, and what the graph makes of that.

The detections of two cameras whose rays cross at 45 degrees leave six times the variance along the line midway between
the rays than across it, and errors along the two axes of the image differ. So a joint alone is filtered along three
directions, the eigenvectors of the information M of its detections, each as if there were no other (filter_response).
With A the covariance that it would have then, in a graph that takes errors for independent, A^-1/2 C A^-1/2 compares
the covariance C in the graph with it: below 1 where bones average errors of joints, above 1 where fewer cameras than
usual see the joint. All are functions of matrices that do not depend on which eigenvectors stand for equal eigenvalues.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.estimation.covariances.detection_errors import invertible
from fgpose.estimation.covariances.filter_response import FilterResponse


@dataclass(frozen=True, eq=False)
class Directions:
    """In which the detections of a usual frame tell independently of each other."""

    by_axis: Float[np.ndarray, "joint axis 3 3"]
    """Information of the detections, 1/m^2, from the horizontal and from the vertical axis of the images."""
    units: Float[np.ndarray, "joint 3 direction"]
    """Each of length 1, in the world."""
    information: Float[np.ndarray, "joint direction"]
    """Of the detections along each, 1/m^2."""

    @staticmethod
    def of(by_axis: Float[np.ndarray, "joint axis 3 3"]) -> Directions:
        """From the information of both axes."""
        information, units = np.linalg.eigh(invertible(by_axis.sum(axis=1)))
        return Directions(by_axis, units, information)

    def matrices(self, values: Float[np.ndarray, "joint direction"]) -> Float[np.ndarray, "joint 3 3"]:
        """With these eigenvalues."""
        return _matrices(self.units, values)


@dataclass(frozen=True, eq=False)
class InGraph:
    """Joints in the graph, compared with those alone."""

    directions: Directions
    steady_m2: Float[np.ndarray, "joint direction"]
    """Variance of the joint alone, as the graph takes errors and motion."""
    root_m: Float[np.ndarray, "joint 3 3"]
    """Square root of the covariance of the joint alone."""
    inverse: Float[np.ndarray, "joint 3 3"]
    """Of that."""
    units: Float[np.ndarray, "joint 3 3"]
    ratio: Float[np.ndarray, "joint 3"]
    """Of the covariance in the graph, where that of the joint alone is 1: along each of the units, of its square
    root."""

    @staticmethod
    def of(
        directions: Directions, steady: Float[np.ndarray, "joint direction"], linear_m2: Float[np.ndarray, "joint 3 3"]
    ) -> InGraph:
        """With these covariances, if so much of the variance of the detections of a frame is left in a steady state."""
        steady_m2 = steady / directions.information
        root_m, inverse = directions.matrices(np.sqrt(steady_m2)), directions.matrices(1 / np.sqrt(steady_m2))
        ratio, units = np.linalg.eigh(inverse @ linear_m2 @ inverse)
        return InGraph(directions, steady_m2, root_m, inverse, units, np.maximum(ratio, 0.0))

    def noise_m2(
        self,
        noise: Float[np.ndarray, "joint direction"],
        axes: Float[np.ndarray, "joint axis"],
        shared: Float[np.ndarray, " joint"],
    ) -> Float[np.ndarray, "joint 3 3"]:
        """Covariance from errors of the detections.

        Args:
            noise: of the joint alone, in its variance as the graph takes errors.
            axes: variance along each axis of the image, in that of both.
            shared: share of the errors that neighbours have too: bones do not average it.
        """
        root = self.directions.matrices(np.sqrt(noise * self.steady_m2 / self.directions.information))
        alone_m2 = root @ np.einsum("ja,jaik->jik", axes, self.directions.by_axis) @ root
        averaged = np.minimum(self.ratio, 1.0)
        return self._with_bones(alone_m2, averaged + shared[:, None] * (1 - averaged))

    def motion_m2(self, response: FilterResponse) -> Float[np.ndarray, "joint 3 3"]:
        """Covariance from motion as rough as the graph takes it, where as many cameras as usual see the joint."""
        return self._with_bones(self.directions.matrices(response.motion * self.steady_m2), np.minimum(self.ratio, 1.0))

    @property
    def excess_m2(self) -> Float[np.ndarray, "joint 3 3"]:
        """What more there is in the graph of joints that fewer cameras than usual see: it is of motion too."""
        return self.root_m @ _matrices(self.units, np.maximum(self.ratio - 1, 0.0)) @ self.root_m

    def _with_bones(
        self, alone_m2: Float[np.ndarray, "joint 3 3"], left: Float[np.ndarray, "joint 3"]
    ) -> Float[np.ndarray, "joint 3 3"]:
        """What is left of the covariance of the joint alone, along each of the units."""
        change = self.root_m @ _matrices(self.units, np.sqrt(left)) @ self.inverse
        return change @ alone_m2 @ change.swapaxes(-1, -2)


def _matrices(
    units: Float[np.ndarray, "joint 3 direction"], values: Float[np.ndarray, "joint direction"]
) -> Float[np.ndarray, "joint 3 3"]:
    return (units * values[:, None]) @ units.swapaxes(-1, -2)
