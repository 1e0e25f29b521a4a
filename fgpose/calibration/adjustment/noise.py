"""Standard deviations of everything that enters the objective of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.adjustment.unknowns import (
    CENTRE,
    FOCAL,
    N_OF_CAMERA,
    OFFSET,
    RADIAL,
    ROTATION,
    TRANSLATION,
    Unknowns,
)
from fgpose_factors import Kernel


@dataclass(frozen=True, eq=False)
class Noise:
    """Of detections, and of the cameras around what they were given as; infinite: nothing is known."""

    sigma_px: Float[np.ndarray, " camera"]
    """Of a good detection but for its bias."""
    kernel: Kernel
    kernel_scale: float
    bias_m: float = np.inf
    """Of each coordinate of a bias."""
    rotation_rad: float = np.inf
    translation_m: float = np.inf
    moved_scale: float = 1.0
    """Of the Cauchy kernel of the prior of a pose, in its standard deviations: so that a bumped camera moves alone.
    With Gaussian priors it would cost less if all cameras shared the move, which shifts the world (25 mm instead of 12
    mm on simulated recordings with one camera turned by 1 degree)."""
    focal: float = np.inf
    """Of the focal length, as a share of it."""
    k1: float = np.inf
    centre: float = np.inf
    """Of a principal point, each coordinate, as a share of the diagonal of the image."""
    offset_s: float = np.inf
    of_clocks: Float[np.ndarray, " camera"] | float = 1.0
    """How many times as much all detections of a camera say of its clock as by their weights, which may be those for
    its pose. So much less the prior of its time offset weighs."""

    def information(self, unknowns: Unknowns) -> Float[np.ndarray, "camera 11"]:
        """On the changes of each camera; what a group shares counts once."""
        information = np.zeros((unknowns.n_cameras, N_OF_CAMERA))
        information[:, ROTATION], information[:, TRANSLATION] = self.rotation_rad**-2, self.translation_m**-2
        information[:, OFFSET] = self.offset_s**-2 / self.of_clocks
        information[list(unknowns.centres), CENTRE] = self.centre**-2
        for row, groups, sigma in ((FOCAL, unknowns.focal, self.focal), (RADIAL, unknowns.radial, self.k1)):
            for group in groups:
                information[list(group), row] = 1 / (len(group) * sigma**2)
        return information
