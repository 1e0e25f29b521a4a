"""What the errors of detections do to the shared bone lengths.

The lengths are a few numbers of all frames. To first order they deviate by G e, with e the errors of all detections and
G what the linearised graph makes of each (Linearized.length_effects_m). As e is a sum of components
(variance_components), the covariance of the lengths is the sum of G C G' over the components. White noise averages out
over the frames. What is constant for each joint and camera does not: what it does to a length is as much after an hour
as after a second, unless the body turns.

What is uncertain in the graph besides detections is that bones vary, that people move, and what is known of bodies. It
is taken to last as long as the errors of a network usually do (fgpose.estimation.noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.estimation.covariances.variance_components import (
    TIMES_S,
    ErrorComponents,
    correlation_after,
    covariance_of_sum,
)
from fgpose.estimation.noise import shared_errors
from fgpose.estimation.solvers.normal_equations import Linearized


@dataclass(frozen=True, eq=False)
class LengthEffects:
    """On the lengths, in metres, of the errors of detections, in their standard deviations."""

    of_detections_m: Float[np.ndarray, "frame camera slot 2 length"]
    of_doubted_m: Float[np.ndarray, "frame camera slot 2 length"]
    """The same, in the standard deviations that are left of them by their weights."""
    time_s: Float[np.ndarray, " frame"]
    bias_share: Float[np.ndarray, "frame slot"]
    """How much of constant errors is left, in their variance."""
    of_rest_m2: Float[np.ndarray, "length length"]
    """Covariance of the lengths if detections had no errors."""

    @staticmethod
    def of(
        linearized: Linearized, time_s: Float[np.ndarray, " frame"], bias_share: Float[np.ndarray, "frame slot"]
    ) -> LengthEffects:
        """In a problem around its solution."""
        effects_m, weight = linearized.length_effects_m(), linearized.weight[..., None, None]
        # The variance of a detection is the inverse of its weight: it may be hallucinated.
        in_graph_m = np.divide(effects_m, np.sqrt(weight), out=np.zeros_like(effects_m), where=weight > 0)
        of_noise_m2 = np.einsum("tcjal,tcjam->lm", in_graph_m, in_graph_m, optimize=True)
        of_rest_m2 = shared_errors(time_s) ** 2 * (linearized.length_covariance_m2() - of_noise_m2)
        return LengthEffects(effects_m, in_graph_m, time_s, bias_share, of_rest_m2)

    def taken_m2(self, residual: Float[np.ndarray, "frame camera slot 2"]) -> Float[np.ndarray, "length length"]:
        """Second moment of what smoothing has taken from the lengths for good: a smoothed walk has flatter steps, and
        shorter thighs, however long it lasts. What the residuals would do to the lengths if they were errors tells how
        much (twicing, Tukey 1977): errors leave nothing in them that does not average out."""
        taken_m = np.einsum("tcjal,tcja->l", self.of_detections_m, residual)
        return np.outer(taken_m, taken_m)

    def covariance_m2(
        self,
        components: ErrorComponents,
        lasting: Float[np.ndarray, "camera slot"] | float = 1.0,
        sizes: Float[np.ndarray, " frame"] | float = 1.0,
    ) -> Float[np.ndarray, "length length"]:
        """Of the lengths, from errors with these components, of whose lasting ones each view has so many times as much
        as all together; in each frame the variance of all is so many times as large."""
        n_lengths, mixing = self.of_detections_m.shape[-1], components.mixing
        covariance_m2, step_s = np.zeros((n_lengths, n_lengths)), np.diff(self.time_s, prepend=self.time_s[0])
        root_size = np.sqrt(np.broadcast_to(sizes, len(self.time_s)))[:, None, None, None, None]
        for time_s, variance in zip(TIMES_S, components.variances.T, strict=True):
            if not (n_lengths and variance.any()):
                continue
            sigma = np.sqrt(components.in_views(time_s, lasting)[..., None] * variance[:, None] * components.axes)
            own_m = root_size * sigma[..., None] * self.of_doubted_m
            if np.isinf(time_s):
                own_m *= np.sqrt(self.bias_share)[:, None, :, None, None]
            by_sample_m = np.einsum("js,tcjal->tcsal", mixing, own_m, optimize=True)
            correlation = correlation_after(time_s, step_s)
            covariance_m2 += covariance_of_sum(by_sample_m.reshape(len(step_s), -1, n_lengths), correlation)
        return covariance_m2
