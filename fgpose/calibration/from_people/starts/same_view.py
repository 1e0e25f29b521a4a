"""Two videos of one camera: a copy, another encoding, the same stream twice."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.starts.epipolar_shift import fit_epipolar_shift
from fgpose.calibration.from_people.starts.views import View
from fgpose.geometry.epipolar_distance import sampson_errors

# Across the epipolar lines are the errors of the detections alone, along them these and the disparity. At the root of
# two the disparity is as large as the errors: below, nobody's distance shows.
_DISPARITY_SHOWS = np.sqrt(2.0)
# Of EpipolarShift: the joints satisfy the geometry to within the errors of detectors.
_MAX_MISFIT = 0.5


def shows_the_same(first: View, second: View, shift_s: float) -> bool:
    """Whether two views cannot be told from two videos of one camera: joints are displaced from one to the other by the
    errors of the detections alone.

    Errors have no preferred direction; what another place of a camera does to a joint is along its epipolar line.

    Args:
        first, second: of one walker, each by its own clock.
        shift_s: time of the first less that of the second, to within 0.1 s.
    """
    if not _overlap(first, second, shift_s):
        return False
    fit = fit_epipolar_shift(first, second, shift_s)
    if fit is None or fit.misfit > _MAX_MISFIT:
        return False
    there = second.at(first.time_s - fit.clock.shift_s)
    known = np.asarray(np.isfinite(there + first.xy).all(axis=-1))
    along = _along_lines(first.xy[known], there[known], fit.F)
    # The difference of two images has the errors of both.
    errors = np.sqrt(2.0) * np.abs(sampson_errors(fit.F, first.xy[known], there[known]))
    return bool(np.median(along) <= _DISPARITY_SHOWS * np.median(errors))


def _overlap(first: View, second: View, shift_s: float) -> bool:
    """Whether the bodies cover each other in the image, as a rule."""
    apart = np.linalg.norm(second.at(first.time_s - shift_s) - first.xy, axis=-1) / first.radius[:, None]
    known = np.isfinite(apart)
    return bool(known.any() and np.median(apart[known]) < 1)


def _along_lines(
    first: Float[np.ndarray, "point 2"], second: Float[np.ndarray, "point 2"], F: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, " point"]:
    """Displacements from the first to the second image along the epipolar lines in the second."""
    normal = first @ F[:2, :2].T + F[:2, 2]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-18)
    displaced = second - first
    return np.abs(displaced[:, 0] * normal[:, 1] - displaced[:, 1] * normal[:, 0])
