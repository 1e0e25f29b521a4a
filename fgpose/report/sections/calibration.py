"""How the cameras were calibrated: the verdict, and where in their images a board was."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Int

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Block, Note, Table, TableCell, number, percent
from fgpose.report.sections.origin import FROM_PEOPLE

_HEIGHT_PX = 54  # of the picture of an image
_FAINTEST = 0.25  # one corner is seen


def verdict(recording: FinishedRecording) -> list[Block]:
    """Reasons with what helps, and the coverage of a board."""
    how = recording.calibrated or FROM_PEOPLE
    covered = _coverage(recording)
    if not recording.findings and recording.calibrated:
        return [Note(f"The cameras were calibrated {how}; nothing was said against that."), *covered]
    if not recording.findings:
        return [Note("No verdict: nothing is known of how the cameras were calibrated.", is_missing=True)]
    rows = [
        (
            TableCell(finding.camera or "all"),
            TableCell(finding.grade.value),
            TableCell(finding.reason),
            TableCell(finding.remedy),
        )
        for finding in recording.findings
    ]
    columns = ("camera", "verdict", "reason", "remedy")
    return [Table(columns, tuple(rows), f"Verdict of the calibration {how}", numeric=(False,) * 4), *covered]


def _coverage(recording: FinishedRecording) -> list[Block]:
    sizes_px = {} if recording.rig is None else {each.name: each.size_px for each in recording.rig.cameras}
    counts = {name: np.array(of_image) for name, of_image in recording.board_coverage.items() if name in sizes_px}
    if not counts:
        return []
    most = max(int(of_image.max()) for of_image in counts.values())
    rows = [
        (
            TableCell(name),
            TableCell("", svg=_picture(of_image, sizes_px[name], most), key=float(np.mean(of_image > 0))),
            percent(float(np.mean(of_image > 0)), bad_below=0.6),
            percent(_of_border(of_image), bad_below=0.6),
            number(float(of_image.sum()), 0),
        )
        for name, of_image in counts.items()
    ]
    hints = (
        "", "the image in parts: the stronger the colour, the more corners; empty: none", "parts with a corner",
        "the same of the parts along its border, where a lens bends most", "",
    )  # fmt: skip
    columns = ("camera", "where the board was", "image covered", "border covered", "corners")
    numeric = (False, False, True, True, True)
    return [Table(columns, tuple(rows), "Where in the images the board was seen", numeric, hints)]


def _of_border(counts: Int[np.ndarray, "row column"]) -> float:
    inner = np.zeros(counts.shape, dtype=bool)
    inner[1:-1, 1:-1] = True
    return float(np.mean(counts[~inner] > 0))


def _picture(counts: Int[np.ndarray, "row column"], size_px: tuple[int, int], most: int) -> str:
    """As SVG, in the shape of the image."""
    n_rows, n_columns = counts.shape
    height = _HEIGHT_PX
    width = round(height * size_px[0] / size_px[1])
    across, down = width / n_columns, height / n_rows
    parts = "".join(
        f'<rect x="{column * across:.1f}" y="{row * down:.1f}" width="{across:.1f}" height="{down:.1f}" '
        f'fill-opacity="{_shade(int(counts[row, column]), most):.2f}"/>'
        for row, column in np.argwhere(counts > 0).tolist()
    )
    label = f"{100 * np.mean(counts > 0):.0f} % of the image covered"
    frame = f'<rect width="{width}" height="{height}" fill="none" stroke="currentColor" stroke-opacity="0.5"/>'
    return (
        f'<svg width="{width}" height="{height}" role="img" aria-label="{label}" style="fill:var(--accent,#0b6e86)">'
        f"<title>{label}</title>{parts}{frame}</svg>"
    )


def _shade(count: int, most: int) -> float:
    """Ten corners are much more than one, and hardly less than a hundred."""
    return _FAINTEST + (1 - _FAINTEST) * math.log1p(count - 1) / max(math.log1p(most - 1), 1e-9)
