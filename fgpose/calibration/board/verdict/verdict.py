"""The verdict on a calibration with boards: good, coarse or failed, each with the reason and the remedy in words.

Failed means that a camera may be more than 5 degrees or a tenth of its distance off; coarse, that it is good enough to
begin from and not to measure with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.board.adjusting import AdjustedBoards
from fgpose.calibration.board.placing import strongest_tree
from fgpose.calibration.board.verdict.given_lenses import GivenLenses
from fgpose.calibration.board.verdict.sigmas import BoardSigmas
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade, worst_grade
from fgpose.geometry.camera import CameraRig

_FEW_VIEWS = 10  # OpenCV's advice; with fewer, one that is wrong is not noticed
_FEW_LINKS = 5  # each has six numbers that one wrong view spoils
# Limits for coarse and failed. Of a place as a share of the distance to the boards: 12 mm at 4 m.
_SIGMA, _SIGMA_DEG, _FOCAL = np.array([0.003, 0.05]), np.array([0.3, 2.5]), np.array([0.005, 0.05])
# In an image of 1920 px.
_BORDER_PX, _RMS_PX = np.array([1.5, np.inf]), np.array([1.0, 10.0])
_REFERENCE_PX = 1920.0
_COVERED = 0.7  # of the way from the middle of the image to its corner
_TOGETHER, _TOGETHER_PX = np.array([1.5, 10.0]), 0.3  # to errors that a camera has alone
_MOST_LEFT_OUT = 0.3
_LENS_TO_WORST = 0.5  # of lenses that were given and are wrong, those are named that are about as far off
# Of five simulated calibrations without a fault the sum of squares is 4.3 at most, with four cameras of which one was
# turned by a degree 9 to 160.
_BY_CHANCE = 1e-3
_NEAR = "hold the board near to it, tilted, in 20 places all over its image"


@dataclass(frozen=True, eq=False)
class VerdictInputs:
    """All that the verdict rests on; arrays by camera."""

    names: tuple[str, ...]
    sigmas: BoardSigmas
    n_views: Int[np.ndarray, " camera"]
    left_out: Float[np.ndarray, " camera"]
    """Share of the views that were wrong."""
    links: Int[np.ndarray, "camera camera"]
    distance_m: Float[np.ndarray, " camera"]
    """To the boards, median."""
    covered: Float[np.ndarray, " camera"]
    """How far from the middle of the image corners were seen, as a share of the way to its corner; 1 of a lens that was
    given."""
    rms_px: Float[np.ndarray, " camera"]
    alone_px: Float[np.ndarray, " camera"]
    width_px: Float[np.ndarray, " camera"]
    """The longer side of the image."""
    focal_px: Float[np.ndarray, " camera"]
    converged: bool
    contradiction: Float[np.ndarray, " camera"]
    """By how many standard deviations the focal length of each differs from that which it has by itself."""
    stretch: Float[np.ndarray, " camera"]
    """By how much the image seems to be stretched in width, as a share; zero where pixels are square or were given."""
    given: GivenLenses
    """What is wrong with lenses that were given."""

    @staticmethod
    def of(
        adjusted: AdjustedBoards,
        rig: CameraRig,
        sigmas: BoardSigmas,
        alone_px: Float[np.ndarray, " camera"],
        links: Int[np.ndarray, "camera camera"],
        contradiction: Float[np.ndarray, " camera"],
        given: GivenLenses,
    ) -> VerdictInputs:
        """See the attributes."""
        sightings, bundle = adjusted.sightings, adjusted.bundle
        sees = sightings.shows_board
        to_boards_m = bundle.world_T_board[:, None, :3, 3] - bundle.world_T_camera[:, :3, 3]
        distance_m = np.where(sees, np.linalg.norm(to_boards_m, axis=-1), np.nan)
        sizes_px = np.array(sightings.sizes_px, dtype=float)
        from_middle = np.linalg.norm(sightings.points_px - (sizes_px[:, None] - 1) / 2, axis=-1)
        reach = np.nanmax(from_middle, axis=(0, 2)) / (np.linalg.norm(sizes_px, axis=1) / 2)
        n_out = np.array([sum(each.camera == name for each in sightings.left_out) for name in rig.names])
        return VerdictInputs(
            names=rig.names,
            sigmas=sigmas,
            n_views=sees.sum(axis=0),
            left_out=n_out / (n_out + sees.sum(axis=0)),
            links=links,
            distance_m=np.nanmedian(distance_m, axis=0),
            covered=np.where([kind.held for kind in adjusted.kinds], 1.0, reach),
            rms_px=adjusted.rms_px,
            alone_px=alone_px,
            width_px=sizes_px.max(axis=1),
            focal_px=rig.focal_px,
            converged=adjusted.converged,
            contradiction=contradiction,
            stretch=np.array(
                [
                    0.0 if kind.held else each.K[0, 0] / each.K[1, 1] - 1
                    for kind, each in zip(adjusted.kinds, rig.cameras, strict=True)
                ]
            ),
            given=given,
        )


def findings(inputs: VerdictInputs) -> tuple[CalibrationFinding, ...]:
    """All reasons against a calibration, the gravest first; none: it is good."""
    unsure = [*_unsure(inputs), *_uncovered(inputs)]
    grade = worst_grade(unsure)
    # Where lenses are wrong, or cameras contradict themselves, that is why all of them are unsure.
    wrong_lenses = _wrong_lenses(inputs, grade)
    of_wrong_lenses = {finding.camera for finding in wrong_lenses}
    found = [
        *_not_converged(inputs.converged),
        *(
            wrong_lenses
            or _stretched_print(inputs.stretch, grade)
            or _moved(inputs.names, inputs.contradiction, grade)
            or unsure
        ),
        *_weak_links(inputs.names, inputs.links),
        *_few_views(inputs.names, inputs.n_views),
        *(finding for finding in _large_errors(inputs) if finding.camera not in of_wrong_lenses),
        *_many_left_out(inputs.names, inputs.left_out),
    ]
    return tuple(sorted(found, key=lambda finding: -finding.grade.gravity))


def _not_converged(converged: bool) -> list[CalibrationFinding]:
    if converged:
        return []
    return [CalibrationFinding("", Grade.FAILED, "the adjustment did not converge", "take more views, near and tilted")]


def _moved(names: Sequence[str], contradiction: Float[np.ndarray, " camera"], grade: Grade) -> list[CalibrationFinding]:
    """Lenses that are others together than alone, by more than chance; and how bad that makes the cameras."""
    from scipy.stats import chi2

    if float(np.sum(contradiction**2)) < chi2.isf(_BY_CHANCE, len(names)):
        return []
    worst = int(np.argmax(np.abs(contradiction)))
    reason = (
        f"the focal length of {names[worst]} by itself differs from that of all cameras together by "
        f"{abs(contradiction[worst]):.0f} standard deviations: some camera was moved, refocused or zoomed between the "
        "views, or they are not of the same moments"
    )
    remedy = "fix the tripods, switch autofocus and stabilisation off, and film the board again"
    return [CalibrationFinding("", _worse(grade, Grade.COARSE), reason, remedy)]


def _wrong_lenses(inputs: VerdictInputs, grade: Grade) -> list[CalibrationFinding]:
    """Lenses that were given and are not those of their cameras, and how bad that makes the cameras."""
    given, names = inputs.given, inputs.names
    centre_deg = np.rad2deg(np.arctan(given.centre_px / inputs.focal_px))
    border_px = given.border_px / inputs.width_px * _REFERENCE_PX
    limits = np.array([_FOCAL, _SIGMA_DEG, _BORDER_PX])
    off = np.array([np.abs(given.focal), centre_deg, border_px])
    ratios = off / limits[:, :1]
    # What matters is the poses: a lens of another calibration, too, differs by more than chance.
    if grade is Grade.GOOD and (len(names) > 1 or ratios.max() <= 1):
        return []
    remedy = "calibrate the lens on these images (leave --intrinsics out), or give that of this camera, zoom and focus"
    found = []
    for c in np.flatnonzero(given.doubtful & (ratios.max(axis=0) > _LENS_TO_WORST * ratios.max())).tolist():
        reasons = (
            f"its focal length seems to be {abs(given.focal[c]):.1%} off what was given",
            f"its principal point seems to be {given.centre_px[c]:.0f} px off what was given",
            f"its distortion seems to be {given.border_px[c]:.1f} px off what was given, at the border of the image",
        )
        own = _worse(Grade.FAILED if (off[:, c] > limits[:, 1]).any() else Grade.COARSE, grade)
        found.append(CalibrationFinding(names[c], own, reasons[int(np.argmax(ratios[:, c]))], remedy))
    if not found and (given.moved_m / inputs.distance_m > _SIGMA[0]).any():
        apart_mm = 1e3 * given.moved_m.max()
        reason = f"with lenses of these images cameras are up to {apart_mm:.0f} mm from where the given ones have them"
        remedy = f"{remedy}; and do not move cameras while you film"
        found.append(CalibrationFinding("", _worse(grade, Grade.COARSE), reason, remedy))
    return found


def _stretched_print(stretch: Float[np.ndarray, " camera"], grade: Grade) -> list[CalibrationFinding]:
    """Two focal lengths, in all cameras alike: of one camera it is its lens, of all what they look at."""
    usual = float(np.median(stretch))
    if len(stretch) < 2 or not np.ptp(stretch) < abs(usual):
        return []
    wide, way = f"{abs(usual):.1%}", "width" if usual > 0 else "height"
    reason = f"images of all cameras seem to be stretched by {wide} in {way}: the squares of the board probably are"
    remedy = "measure the board in both directions, and print it again without fitting it to the page"
    return [CalibrationFinding("", _worse(grade, Grade.COARSE), reason, remedy)]


def _unsure(inputs: VerdictInputs) -> list[CalibrationFinding]:
    """Cameras whose place, direction or focal length is known badly."""
    names, sigmas = inputs.names, inputs.sigmas
    partners = [_partner(c, names, inputs.links) for c in range(len(names))]
    found = []
    for c, name in enumerate(names):
        where = f"hold the board where it and {partners[c]} see it at once" if partners[c] else _NEAR
        position_m, direction_deg = sigmas.position_m[c], sigmas.direction_deg[c]
        criteria = (
            (sigmas.focal[c], _FOCAL, f"focal length is known to ± {100 * sigmas.focal[c]:.1f} %", _NEAR),
            (position_m / inputs.distance_m[c], _SIGMA, f"place is known to ± {1e3 * position_m:.0f} mm", where),
            (direction_deg, _SIGMA_DEG, f"direction is known to ± {direction_deg:.1f} degrees", where),
        )
        found += [
            CalibrationFinding(name, _grade(float(value), limits), f"its {reason} only", remedy)
            for value, limits, reason, remedy in criteria
            if not value <= limits[0]
        ]
    return found


def _weak_links(names: Sequence[str], links: Int[np.ndarray, "camera camera"]) -> list[CalibrationFinding]:
    """Cameras, or groups of them, that few moments tie to the others."""
    found = []
    for part in _parts(links):
        rest = [c for c in range(len(names)) if c not in part]
        n_common = int(links[np.ix_(part, rest)].sum())
        if n_common >= _FEW_LINKS:
            continue
        a, b = max(((a, b) for a in part for b in rest), key=lambda pair: links[pair])
        own, others = (", ".join(names[c] for c in cameras) for cameras in (part, rest))
        subject = names[part[0]] if len(part) == 1 else names[rest[0]] if len(rest) == 1 else ""
        reason = f"the board ties {own} to {others} at {n_common} moments only"
        remedy = f"hold the board where {names[a]} and {names[b]} see it at once, in 10 more places"
        found.append(CalibrationFinding(subject, Grade.COARSE, reason, remedy))
    return found


def _parts(links: Int[np.ndarray, "camera camera"]) -> list[list[int]]:
    """What the tree of the strongest links falls into where one of its links is cut: the smaller of both parts."""
    from scipy.sparse.csgraph import connected_components

    tree = strongest_tree(links).toarray()
    parts = []
    for edge in np.argwhere(tree):
        cut = tree.copy()
        cut[tuple(edge)] = 0.0
        _, labels = connected_components(cut, directed=False)
        sides = [np.flatnonzero(labels == labels[end]).tolist() for end in edge]
        parts.append(min(sides, key=len))
    return parts


def _few_views(names: Sequence[str], n_views: Int[np.ndarray, " camera"]) -> list[CalibrationFinding]:
    reason = "the board is used in {0} of its images only"
    return [
        CalibrationFinding(name, Grade.COARSE, reason.format(n), _NEAR)
        for name, n in zip(names, n_views.tolist(), strict=True)
        if n < _FEW_VIEWS
    ]


def _uncovered(inputs: VerdictInputs) -> list[CalibrationFinding]:
    """Lenses of which the border was not seen, or is not determined."""
    found = []
    border_px = inputs.sigmas.border_px / inputs.width_px * _REFERENCE_PX
    remedy = "hold the board into the corners of its image"
    for c, name in enumerate(inputs.names):
        if inputs.covered[c] < _COVERED:
            share = f"{inputs.covered[c]:.0%}"
            reason = f"the board was within {share} of the way to the corner of its image: its lens is a guess beyond"
            found.append(CalibrationFinding(name, Grade.COARSE, reason, remedy))
        elif border_px[c] > _BORDER_PX[0]:
            reason = f"its lens is known to ± {inputs.sigmas.border_px[c]:.1f} px only at the border of the image"
            found.append(CalibrationFinding(name, Grade.COARSE, reason, remedy))
    return found


def _large_errors(inputs: VerdictInputs) -> list[CalibrationFinding]:
    """Cameras that contradict the others, or whose corners are not where a flat board has them."""
    found = []
    for c, name in enumerate(inputs.names):
        rms_px, alone_px = float(inputs.rms_px[c]), float(inputs.alone_px[c])
        limits_px = _RMS_PX * inputs.width_px[c] / _REFERENCE_PX
        if rms_px > _TOGETHER[0] * alone_px and rms_px - alone_px > _TOGETHER_PX:
            grade = Grade.FAILED if rms_px > min(_TOGETHER[1] * alone_px, limits_px[1]) else Grade.COARSE
            reason = f"it sees the board {rms_px:.1f} px beside where the others do, {alone_px:.1f} px by itself"
            remedy = (
                "check that all cameras took their images at the same moments (if they were started by hand: "
                "--unsynchronised), that none was moved, and hold the board still"
            )
            found.append(CalibrationFinding(name, grade, reason, remedy))
        elif rms_px > limits_px[0]:
            reason = f"its corners are {rms_px:.1f} px beside those of a flat board"
            remedy = "check the sizes of the board, use a flat and stiff one, hold it still"
            found.append(CalibrationFinding(name, _grade(rms_px, limits_px), reason, remedy))
    return found


def _many_left_out(names: Sequence[str], share: Float[np.ndarray, " camera"]) -> list[CalibrationFinding]:
    remedy = "check the sizes of the board, hold it still, and see that all cameras took their images at once"
    return [
        CalibrationFinding(name, Grade.COARSE, f"{own:.0%} of its views were wrong and left out", remedy)
        for name, own in zip(names, share.tolist(), strict=True)
        if own > _MOST_LEFT_OUT
    ]


def _partner(c: int, names: Sequence[str], links: Int[np.ndarray, "camera camera"]) -> str:
    """The camera with which it sees the board most often; empty: there is none."""
    return names[int(np.argmax(links[c]))] if links[c].any() else ""


def _grade(value: float, limits: Float[np.ndarray, " grade=2"]) -> Grade:
    return Grade.FAILED if not value <= limits[1] else Grade.COARSE


def _worse(a: Grade, b: Grade) -> Grade:
    return max(a, b, key=lambda grade: grade.gravity)
