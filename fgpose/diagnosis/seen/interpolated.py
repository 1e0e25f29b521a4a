"""Gaps of the keypoints that were filled by interpolation before they were given."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen.keypoints import spread_px
from fgpose.diagnosis.seen.rounded import differences_px, filled_and_rounded
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import parts_of, stretches, usual_step_s

# Images in a row in which a joint stands exactly in the middle between the one before and the one after, although it
# moves. Where that is more of all, every second image, or two of three, are filled.
_IN_A_ROW, _RESAMPLED = 3, 0.2
_FEWEST = 10  # detections
_MOST_DECIMALS, _SAMPLED = 6, 10_000
_EXACT = 1e-6  # of the spread of the joints in the image: rounding of numbers in single precision
# What counts as exact must be this much smaller than what bends other ways (the largest fifth, where every second image
# or two of three are filled): numbers are not too coarse, and keypoints have errors, as those of all networks.
_FINER, _BENT = 100, 0.8
_MOVES = 20  # times what counts as exact
_OF_FOURTH = 8.0  # times the rounding of second differences, that of fourth ones
_LONG_S = 0.3  # somebody who works has turned round by then


def interpolated_keypoints(examined: Examined) -> list[Finding]:
    """Joints that move along straight lines, at the same speed to the last digit: no network finds them there."""
    seen = examined.main
    if seen.n_frames < _IN_A_ROW + 2:
        return []
    filled = np.stack([_filled_of(seen.points2d_px[:, c]) for c in range(seen.n_cameras)], axis=1)
    counts = filled.sum(axis=(0, 2))
    found = [c for c, count in enumerate(counts.tolist()) if count >= _FEWEST]
    if not found:
        return []
    longest, first = max(_longest(filled[:, c]) for c in found)
    longest_s, from_s = longest * usual_step_s(seen.frame_time_s), float(seen.frame_time_s[-first])
    share = float(counts[found].sum() / seen.seen[:, found].sum())
    cameras = [seen.camera_names[c] for c in found]
    where = examined.in_words(cameras)
    return [
        Finding(
            Code.INTERPOLATED_KEYPOINTS,
            Severity.WRONG if longest_s >= _LONG_S else Severity.DOUBTFUL,
            f"{100 * share:.2g} % of the detections of {where} lie on straight lines or cubic curves between others, "
            f"to the last digit, for up to {longest_s:.2g} s (at {from_s:.2f} s): gaps that were filled by "
            "interpolation, where nobody was detected",
            "Leave them empty (NaN, or confidence 0): filled ones claim to know where somebody was. fgpose bridges "
            "gaps by itself, and says how sure it is.",
            min(1.0, 5 * share),
            camera=cameras[0] if len(cameras) == 1 else "",
            numbers={"share": share, "longest_s": longest_s},
        )
    ]


def _filled_of(points_px: Float[np.ndarray, "frame joint 2"]) -> Bool[np.ndarray, "frame joint"]:
    """Of one camera."""
    known = np.asarray(np.isfinite(points_px).all(axis=-1))
    exact_px, step_px = _EXACT * spread_px(points_px), _step_px(points_px[known])
    bend_px = differences_px(points_px, 2)
    filled = _filled(points_px, bend_px, known, max(2.01 * step_px, exact_px))
    if filled.any():
        return filled
    if step_px > exact_px:
        return filled_and_rounded(points_px, bend_px, step_px)
    return _on_curves(points_px, bend_px, exact_px)


def _filled(
    points_px: Float[np.ndarray, "frame joint 2"],
    bend_px: Float[np.ndarray, "frame-2 joint"],
    known: Bool[np.ndarray, "frame joint"],
    exact_px: float,
) -> Bool[np.ndarray, "frame joint"]:
    """Those of which hardly a bend is as small as what counts as exact."""
    filled = np.zeros(points_px.shape[:2], dtype=bool)
    known_px = bend_px[np.isfinite(bend_px)]
    if len(known_px) < _FEWEST or not np.quantile(known_px, _BENT, overwrite_input=True) > _FINER * exact_px:
        return filled
    for part in parts_of(len(bend_px)):
        moved_px = points_px[part.start + 2 : part.stop + 2] - points_px[part]
        moves = np.linalg.norm(moved_px, axis=-1) > 2 * _MOVES * exact_px
        filled[part.start + 1 : part.stop + 1] = (bend_px[part] <= exact_px) & moves
    if filled.sum() > _RESAMPLED * known.sum():
        return filled
    return _runs(filled)


def _on_curves(
    points_px: Float[np.ndarray, "frame joint 2"], bend_px: Float[np.ndarray, "frame-2 joint"], exact_px: float
) -> Bool[np.ndarray, "frame joint"]:
    """On a cubic curve, as splines fill gaps: without fourth differences."""
    filled = np.zeros(points_px.shape[:2], dtype=bool)
    fourth_px, exact_px = differences_px(points_px, 4), _OF_FOURTH * exact_px
    known_px = fourth_px[np.isfinite(fourth_px)]
    if len(known_px) < _FEWEST or not np.quantile(known_px, 1 - _BENT, overwrite_input=True) > _FINER * exact_px:
        return filled
    filled[2:-2] = (fourth_px <= exact_px) & (bend_px[1:-1] > exact_px)
    return _runs(filled)


def _runs(filled: Bool[np.ndarray, "frame joint"]) -> Bool[np.ndarray, "frame joint"]:
    """Those of which there are some in a row."""
    if len(filled) < _IN_A_ROW:
        return np.zeros_like(filled)
    in_a_row = np.asarray(np.lib.stride_tricks.sliding_window_view(filled, _IN_A_ROW, axis=0).all(axis=-1))
    kept = np.zeros_like(filled)
    for k in range(_IN_A_ROW):
        kept[k : len(in_a_row) + k] |= in_a_row
    return kept


def _step_px(values: Float[np.ndarray, "*values"]) -> float:
    """What numbers were rounded to: a decimal, or several of it, as of heatmaps; 0: they were not."""
    sampled = values.ravel()[:: max(1, values.size // _SAMPLED)].astype(float)
    for decimals in range(_MOST_DECIMALS):
        scaled = sampled * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=0, atol=0.01):
            different = np.unique(np.round(scaled))
            return float(np.diff(different).min()) / 10.0**decimals if len(different) > 1 else 0.0
    return 0.0


def _longest(filled: Bool[np.ndarray, "frame joint"]) -> tuple[int, int]:
    """How many images in a row, and the first of them, with a minus: of two the earlier one is larger."""
    runs = [(end - first, -first) for joint in filled.T for first, end in stretches(joint)]
    return max(runs)
