"""Gaps of the keypoints that were filled by interpolation before they were given."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
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
_LONG_S = 0.3  # somebody who works has turned round by then


def interpolated_keypoints(examined: Examined) -> list[Finding]:
    """Joints that move along straight lines, at the same speed to the last digit: no network finds them there."""
    seen = examined.main
    if seen.n_frames < _IN_A_ROW + 2:
        return []
    filled = np.stack([_filled(seen.points2d_px[:, c]) for c in range(seen.n_cameras)], axis=1)
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
            f"{100 * share:.2g} % of the detections of {where} lie exactly on straight lines between others, for up to "
            f"{longest_s:.2g} s (at {from_s:.2f} s): gaps that were filled by interpolation, where nobody was detected",
            "Leave them empty (NaN, or confidence 0): filled ones claim to know where somebody was. fgpose bridges "
            "gaps by itself, and says how sure it is.",
            min(1.0, 5 * share),
            camera=cameras[0] if len(cameras) == 1 else "",
            numbers={"share": share, "longest_s": longest_s},
        )
    ]


def _filled(points_px: Float[np.ndarray, "frame joint 2"]) -> Bool[np.ndarray, "frame joint"]:
    """Of one camera."""
    filled = np.zeros(points_px.shape[:2], dtype=bool)
    known = np.asarray(np.isfinite(points_px).all(axis=-1))
    exact_px = max(2.01 * _decimal_step(points_px[known]), _EXACT * _spread_px(points_px, known))
    bend_px = _bends_px(points_px)
    bends_px = bend_px[np.isfinite(bend_px)]
    if len(bends_px) < _FEWEST or not np.quantile(bends_px, _BENT, overwrite_input=True) > _FINER * exact_px:
        return filled
    for part in parts_of(len(bend_px)):
        moved_px = points_px[part.start + 2 : part.stop + 2] - points_px[part]
        moves = np.linalg.norm(moved_px, axis=-1) > 2 * _MOVES * exact_px
        filled[part.start + 1 : part.stop + 1] = (bend_px[part] <= exact_px) & moves
    if filled.sum() > _RESAMPLED * known.sum():
        return filled
    in_a_row = np.asarray(np.lib.stride_tricks.sliding_window_view(filled, _IN_A_ROW, axis=0).all(axis=-1))
    kept = np.zeros_like(filled)
    for k in range(_IN_A_ROW):
        kept[k : len(in_a_row) + k] |= in_a_row
    return kept


def _spread_px(points_px: Float[np.ndarray, "frame joint 2"], known: Bool[np.ndarray, "frame joint"]) -> float:
    """Of the joints in an image that shows all of them."""
    parts = parts_of(len(points_px))
    spreads_px = np.concatenate([np.std(points_px[part][known[part].all(axis=1)], axis=1) for part in parts])
    return float(np.median(spreads_px)) if len(spreads_px) else 0.0


def _bends_px(points_px: Float[np.ndarray, "frame joint 2"]) -> Float[np.ndarray, "frame-2 joint"]:
    """Second differences, the larger of both axes; in double precision, as what counts as exact is not far above the
    rounding of single."""
    bends_px = np.empty((max(len(points_px) - 2, 0), points_px.shape[1]))
    for part in parts_of(len(bends_px)):
        some_px = points_px[part.start : part.stop + 2].astype(float)
        bends_px[part] = np.abs(some_px[:-2] - 2 * some_px[1:-1] + some_px[2:]).max(axis=-1)
    return bends_px


def _decimal_step(values: Float[np.ndarray, "*values"]) -> float:
    """The last decimal that numbers were rounded to; 0: they were not."""
    sampled = values.ravel()[:: max(1, values.size // _SAMPLED)]
    for decimals in range(_MOST_DECIMALS):
        scaled = sampled * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=0, atol=0.01):
            return 10.0**-decimals
    return 0.0


def _longest(filled: Bool[np.ndarray, "frame joint"]) -> tuple[int, int]:
    """How many images in a row, and the first of them, with a minus: of two the earlier one is larger."""
    runs = [(end - first, -first) for joint in filled.T for first, end in stretches(joint)]
    return max(runs)
