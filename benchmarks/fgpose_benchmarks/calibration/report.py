"""The report of the benchmark of calibration from people: one Markdown file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgpose.io.atomic import write_text
from fgpose_benchmarks.calibration.figures import FIGURES, every, group_of, median, share, worst
from fgpose_benchmarks.calibration.scores import FAILED_DEG, GOOD_DEG, RIGHT_PEAK_S, CalibrationScore
from fgpose_benchmarks.calibration.variants import VARIANTS, VERSION
from fgpose_benchmarks.comparison import tables
from fgpose_benchmarks.comparison.scores import Scored
from fgpose_benchmarks.synthetic import STUDIOS

_HEAD = (
    "One walker in simulated studios, seen by cameras without extrinsics: real motion, the lenses of real cameras, and "
    "detections with the errors of real ones, among them a bias of 20 to 40 mm of each joint that depends on the side "
    "from which the body is seen. Positions are after the similarity that lays the estimated rig on the true one, "
    "rotations those between any two cameras. Induced: what the rig makes of exact detections, at the joints of the "
    "walker, after a similarity. The ratios compare the MPJPE of the smoothed walk with that of the true rig, after a "
    "similarity (ratio) and after a rigid motion (metric). Numbers are medians over all cameras, pairs and recordings, "
    "behind the stroke the worst. Baselines are told who is who and when each image was taken."
)
_SIGMAS = {
    "position": "position_sigmas",
    "direction": "direction_sigmas",
    "focal length": "focal_sigmas",
    "start": "start_sigmas",
}
_GROUP_TITLES = {
    "walk": "One walker, intrinsics known, synchronised",
    "errors": "Other errors of the detections",
    "scale": "Other cues for the scale",
    "focal length": "Focal lengths unknown within 40 %",
    "starts": "Videos that start at different moments",
    "people": "Several people",
    "hard": "Too little to calibrate from",
    "real": "Real recordings",
}


def write_report(scores: Sequence[CalibrationScore], folder: Path, command: str) -> Path:
    """Write report.md into a folder, whole or not at all.

    Args:
        folder: made if it is absent.
        command: what makes the same report again.

    Raises:
        ValueError: there are no scores.
        OSError: the folder cannot be written into.
    """
    if not scores:
        raise ValueError("there are no scores to report")
    parts = ["# The benchmark of calibration from people", f"Version {VERSION}. To reproduce:", f"    {command}", _HEAD]
    ours = [score for score in scores if score.group == "ours"]
    methods = list(dict.fromkeys(score.method for score in ours))
    for method in methods:
        own = [score for score in ours if score.method == method]
        named = f": {method}" if len(methods) > 1 else ""
        parts += [f"## Figures to reach{named}", figures(own)]
        parts += [f"### Verdicts{named}", verdicts(own), f"### Stated standard deviations{named}", sigmas(own)]
    for group, title in _GROUP_TITLES.items():
        of_group = [score for score in scores if group_of(score.variant) == group]
        if of_group:
            parts += [f"## {title}", *_descriptions(of_group), errors(of_group)]
    parts += _unnoticed(ours)
    path = folder / "report.md"
    write_text(path, "\n\n".join(parts) + "\n")
    return path


def figures(scores: Sequence[CalibrationScore]) -> str:
    """What is reached of what is to be reached."""
    rows = []
    for figure in FIGURES:
        value, n_recordings = figure.reached(scores)
        verdict = tables.NONE if np.isnan(value) else "yes" if figure.met(value) else "**no**"
        bound = f"{'≥' if figure.at_least else '≤'} {figure.limit:g}"
        reached = tables.fixed(value, figure.decimals)
        rows.append([f"{figure.number}. {figure.what}", bound, reached, verdict, str(n_recordings)])
    return tables.markdown(["figure", "target", "reached", "met", "recordings"], rows)


def verdicts(scores: Sequence[CalibrationScore]) -> str:
    """How calibrations were judged, by how good they are."""
    between = [score for score in scores if not score.is_right and not score.has_failed]
    kinds = {
        f"right: rotations within {GOOD_DEG:g} degrees": [score for score in scores if score.is_right],
        f"within {FAILED_DEG:g} degrees": between,
        f"failed: beyond, refused, or a start off by {RIGHT_PEAK_S:g} s": [s for s in scores if s.has_failed],
    }
    outcomes = ("good", "coarse", "failed")
    rows = [
        [kind, *(str(sum(s.outcome == outcome for s in own)) for outcome in outcomes)] for kind, own in kinds.items()
    ]
    return tables.markdown(["calibrations", *outcomes], rows)


def sigmas(scores: Sequence[CalibrationScore]) -> str:
    """Share of the errors within one and within two stated standard deviations."""
    rows = []
    for what, number in _SIGMAS.items():
        found = every(scores, number)
        within = [tables.fixed(share((found <= most).tolist())) for most in (1.0, 2.0)]
        rows.append([what, str(len(found)), *within])
    return tables.markdown(["error of", "number", "within 1 sigma, %", "within 2 sigma, %"], rows)


def errors(scores: Sequence[CalibrationScore]) -> str:
    """Every variant and method of some scores, one in each row."""
    rows = []
    for variant, method in dict.fromkeys((score.variant, score.method) for score in scores):
        own = [score for score in scores if (score.variant, score.method) == (variant, method)]
        rows.append([tables.words(variant), method, *(column(own) for column in _COLUMNS.values())])
    kept = [n for n in range(len(_COLUMNS)) if any(row[2 + n] != tables.NONE for row in rows)]
    header = ["variant", "method", *(list(_COLUMNS)[n] for n in kept)]
    return tables.markdown(header, [[*row[:2], *(row[2 + n] for n in kept)] for row in rows])


class _Pair:
    """Median and worst of a number."""

    def __init__(self, number: str, decimals: int) -> None:
        self._number, self._decimals = number, decimals

    def __call__(self, scores: Sequence[CalibrationScore]) -> str:
        middle = median(scores, self._number)
        if np.isnan(middle):
            return tables.NONE
        return f"{middle:.{self._decimals}f} / {worst(scores, self._number):.{self._decimals}f}"


def _right_peaks(scores: Sequence[CalibrationScore]) -> str:
    found = every(scores, "right_peak")
    return f"{found.sum():.0f} of {len(found)}" if len(found) else tables.NONE


def _outcomes(scores: Sequence[CalibrationScore]) -> str:
    counts = [sum(score.outcome == outcome for score in scores) for outcome in ("good", "coarse", "failed")]
    return "/".join(map(str, counts)) if any(counts) else tables.NONE


def _seconds(scores: Sequence[CalibrationScore]) -> str:
    return tables.significant(median(scores, "time_s"))


_COLUMNS = {
    "position, mm": _Pair("position_mm", 0),
    "rotation, °": _Pair("rotation_deg", 2),
    "induced, mm": _Pair("induced_mm", 1),
    "ratio": _Pair("ratio", 2),
    "metric": _Pair("metric_ratio", 2),
    "scale, %": _Pair("scale_percent", 1),
    "vertical, °": _Pair("vertical_deg", 2),
    "floor, mm": _Pair("floor_mm", 0),
    "focal, %": _Pair("focal_percent", 1),
    "start, frames": _Pair("start_frames", 2),
    "right peaks": _right_peaks,
    "good/coarse/failed": _outcomes,
    "s": _seconds,
}


def _descriptions(scores: Sequence[Scored]) -> list[str]:
    """A list of the variants, in one part."""
    studios = {studio.name: studio.description for studio in STUDIOS}
    lines = []
    for name in dict.fromkeys(score.variant for score in scores):
        known = next((variant for variant in VARIANTS if variant.name == name), None)
        if known is not None:
            told = [text for text in (studios.get(known.studio), known.description) if text]
            lines.append(f"- {tables.words(name)}: {'. '.join(told)}.")
    return ["\n".join(lines)] if lines else []


def _unnoticed(scores: Sequence[CalibrationScore]) -> list[str]:
    """Failures that were called good, and good ones that were called failures."""
    lines = []
    for score in scores:
        if score.has_failed == (score.outcome != "good") or not (score.has_failed or score.is_right):
            continue
        rotation = f"{max(score.rotation_deg):.1f} degrees" if score.rotation_deg else "no rig"
        reasons = f": {'; '.join(score.reasons)}" if score.reasons else ""
        lines.append(
            f"- {tables.words(score.variant)}, {score.clip}, {score.method}: {rotation}, {score.outcome}{reasons}"
        )
    return ["## Verdicts that are wrong", "\n".join(lines)] if lines else []
