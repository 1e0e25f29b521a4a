"""What a calibration with boards found, as figures and in words: for the command line and for the viewer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.calibration.board.calibrate import CalibratedFromBoards
from fgpose.pipeline.calibration_report import page, texts, texts_unless_given, verdict

_MOST_NAMED = 6  # views that are left out, one by one
_DISAGREE = 1.2  # with corners that err independently it is within a tenth of 1
# Parts of the image, by the distance from its middle as a share of the way to its corner.
_RINGS = {"in the middle": (0.0, 0.35), "between": (0.35, 0.7), "near the corners": (0.7, np.inf)}


def board_rows(result: CalibratedFromBoards) -> dict[str, list[str]]:
    """By quantity, one value for each camera: place, direction and focal length, each with its standard deviation, the
    lens, the views, and the reprojection errors by the part of the image."""
    rig, sigmas = result.rig, result.sigmas
    sees = result.sightings.shows_board.sum(axis=0)
    out = Counter(each.camera for each in result.sightings.left_out)
    rows = {f"place {axis} [m]": texts(rig.positions_m[:, a], 4) for a, axis in enumerate("xyz")}
    rows["  ± [mm]"] = texts(1000 * sigmas.position_m, 2)
    rows["direction ± [deg]"] = texts(sigmas.direction_deg, 3)
    rows["focal length [px]"] = texts(rig.focal_px, 1)
    rows["  ± [%]"] = texts_unless_given(100 * sigmas.focal, 3)
    rows["lens"] = [lens.partition(",")[0] for lens in result.lenses]
    rows["coefficients"] = [lens.partition(", ")[2] or "given" for lens in result.lenses]
    rows["lens at the border ± [px]"] = texts_unless_given(sigmas.border_px, 2)
    if result.start_s is not None:
        rows["began after the first [s]"] = texts(result.start_s, 4)
        rows["  ± [ms]"] = texts(1000 * sigmas.start_s, 2)
    rows["image covered [%]"] = texts(100 * (result.sightings.coverage > 0).mean(axis=(1, 2)), 0)
    if result.sightings.n_without:
        rows["images without the board"] = [str(n) for n in result.sightings.n_without]
    rows["views used"] = [str(n) for n in sees.tolist()]
    rows["views left out"] = [str(out[name]) for name in rig.names]
    rows["seen together with others"] = [str(n) for n in _together(result).tolist()]
    rows["reprojection, RMS [px]"] = texts(result.rms_px, 2)
    for where, values_px in _by_region(result).items():
        rows[f"  {where}"] = texts(values_px, 2)
    return rows


# Of a camera alone there is nothing else.
_OF_LENSES = ("focal length [px]", "  ± [%]", "lens", "coefficients", "lens at the border ± [px]", "views used")
_ERRORS = ("images without the board", "views left out", "reprojection, RMS [px]", *(f"  {where}" for where in _RINGS))


def lens_rows(results: Sequence[CalibratedFromBoards]) -> dict[str, list[str]]:
    """What board_rows says of the lenses, of cameras that were calibrated one by one."""
    each = [board_rows(result) for result in results]
    known = (quantity for quantity in (*_OF_LENSES, *_ERRORS) if all(quantity in rows for rows in each))
    return {quantity: [rows[quantity][0] for rows in each] for quantity in known}


def board_summary(result: CalibratedFromBoards) -> list[str]:
    """The board, the world, and the views that are not used, in sentences."""
    sightings = result.sightings
    lines = [
        f"The board {sightings.board.text} at {len(sightings.time_s)} moments. All lengths are those of its squares: "
        "measure them on the print; an error of 1 % of them is one of 1 % of everything, which ± does not know.",
        result.world,
    ]
    if result.sigmas.disagreement >= _DISAGREE:
        lines.append(
            f"± is {result.sigmas.disagreement:.1f} times what the noise of the corners makes: by so much do the "
            "moments disagree about the cameras, as where a board bends, or corners of one view err together."
        )
    if sightings.left_out:
        named = [f"{each.camera} {sightings.when(each.time_s)}: {each.reason}" for each in sightings.left_out]
        more = f"; and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
        lines.append(f"Views left out: {'; '.join(named[:_MOST_NAMED])}{more}.")
    return lines


def board_markdown(result: CalibratedFromBoards) -> str:
    """The same as one page."""
    said = verdict(result.findings, result.grade)
    return page(said, board_summary(result), result.rig.names, board_rows(result))


def _together(result: CalibratedFromBoards) -> np.ndarray:
    sees = result.sightings.shows_board
    return (sees & (sees.sum(axis=1) > 1)[:, None]).sum(axis=0)


def _by_region(result: CalibratedFromBoards) -> dict[str, Float[np.ndarray, " camera"]]:
    """Root mean square of the reprojection errors; NaN where no corner was seen."""
    sizes_px = np.array(result.sightings.sizes_px, dtype=float)
    from_middle = np.linalg.norm(result.sightings.points_px - (sizes_px[:, None] - 1) / 2, axis=-1)
    share = from_middle / (np.linalg.norm(sizes_px, axis=1)[:, None] / 2)
    found = {}
    for where, (low, high) in _RINGS.items():
        inside = (share >= low) & (share < high)
        square_px2 = np.where(inside, result.residual_px**2, 0.0).sum(axis=(0, 2))
        with np.errstate(invalid="ignore"):
            found[where] = np.sqrt(square_px2 / inside.sum(axis=(0, 2)))
    return found
