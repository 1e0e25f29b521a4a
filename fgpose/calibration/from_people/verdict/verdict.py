"""The verdict on a calibration: good, coarse or failed, each with the reason and the remedy in words.

Every criterion is a function of plain numbers. Failed means that a camera may be more than 5 degrees off; coarse, that
it is good enough to begin from and not to measure with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.unknowns import Groups
from fgpose.calibration.disagreement import allowed_third_view_mrad
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.rig.focal_check import FocalCheck
from fgpose.calibration.from_people.verdict.coverage import Coverage
from fgpose.calibration.from_people.verdict.inputs import VerdictInputs
from fgpose.calibration.from_people.verdict.moved_cameras import MovedCamera, MovedMidway
from fgpose.calibration.from_people.walk import SHORT_S

# Of good calibrations of simulated walkers the worst camera has 4 mrad in the median and 8 at most; where one is late,
# 25 and more.
_COARSE_MRAD = 10.0
# A network's own 3D is 5 to 15 degrees off; twisted solutions are off by 30 and more. Limits for coarse and failed.
_REFEREE_DEG = np.array([15.0, 25.0])
# Rotation, root of the sum over the axes: 5 degrees off would be three, and one and a
# quarter, standard deviations. Position, as a share of the distance to the person.
_SIGMA_DEG, _SIGMA = np.array([1.5, 4.0]), np.array([0.03, 0.08])
# A focal length that is 3 % off costs 14 mm and 0.8 degrees.
_FOCAL = np.array([0.03, 0.10])
# 5 % off costs 110 mm and 0.4 degrees; K of another resolution is 30 % off and more.
_PROBABLY, _WRONG_FOCAL = 0.5, np.array([0.03, 0.2])
# One wrong focal length changes those of cameras beside it by up to half as much.
_FOCAL_TO_WORST = 0.5
_FOCAL_DEPTH_RATIO = 1.5  # two are needed to be sure
_LEAST_ACROSS_M, _LEAST_ALONG_M = 0.15, 0.3  # standard deviations: a line is 0.5 m wide, a place 1 m
_LEAST_IMAGE_SHARE = 0.25
_LEAST_SEEN_S = 3.0
_LEAST_UPRIGHT = 0.5
_MOST_TILT_DEG = 70.0  # a camera under the ceiling that looks 60 degrees down is tilted by so much
_THROUGH = "walk through its whole view, near and far"
_OWN_HAND = 0.2  # handedness: the sum over frames that say one thing and frames that say the other


def findings(inputs: VerdictInputs) -> tuple[CalibrationFinding, ...]:
    """All reasons against a calibration, the gravest first; none: it is good."""
    names, sigmas, distance_m = inputs.camera_names, inputs.sigmas, inputs.distance_m
    too_short = recording_too_short(inputs.duration_s)
    # What is the cause of others comes before them.
    found = [
        *mirrors(names, inputs.mirrored, inputs.handedness),
        *of_another_size(names, inputs.off_centre),
        *moved_while_filming(names, inputs.moved),
        *moved_in_the_middle(inputs.midway),
        *worst_camera(names, inputs.third_view_mrad),
        *twisted(names, inputs.cross_check_deg, sigmas.direction_deg),
        *halves_disagree(names, inputs.halves_deg, inputs.halves_m / distance_m),
        *uncertain(names, sigmas.direction_deg, sigmas.position_m / distance_m),
        *focal_undetermined(names, inputs.estimated_lenses, sigmas.focal, inputs.coverage.depth_ratio),
        *focal_wrong(names, inputs.focal_check, is_moved=inputs.moved is not None or inputs.midway is not None),
        *start_uncertain(names, inputs.start_certain),
        *poorly_covered(
            names,
            inputs.coverage,
            certain(sigmas.direction_deg, sigmas.position_m / distance_m),
            is_short=bool(too_short),
        ),
        *nobody_checks(len(names)),
        *too_short,
        *nobody_upright(inputs.upright, inputs.camera_tilt_deg),
        *inputs.of_scale,
    ]
    return tuple(sorted(found, key=lambda finding: finding.grade.gravity, reverse=True))


def worst_camera(names: Sequence[str], third_view_mrad: Float[np.ndarray, " camera"]) -> list[CalibrationFinding]:
    """Views that do not see the person where the others do."""
    known = third_view_mrad[np.isfinite(third_view_mrad)]
    typical = float(np.median(known)) if known.size else np.inf
    allowed_mrad = allowed_third_view_mrad(typical)
    found = []
    for name, mrad in zip(names, third_view_mrad.tolist(), strict=True):
        if not np.isfinite(mrad):
            reason, remedy = "no other two cameras see the person when it does", "walk where several cameras see you"
            found.append(CalibrationFinding(name, Grade.COARSE, reason, remedy))
        elif mrad > min(_COARSE_MRAD, allowed_mrad):
            reason = f"it sees the person {mrad:.0f} mrad beside where the others do (median: {typical:.0f} mrad)"
            remedy = (
                "was it moved while it filmed? Check its start, its frame rate and its lens (K of this resolution?), "
                "and that its picture is not mirrored; record longer, and walk through its whole view"
            )
            found.append(
                CalibrationFinding(name, Grade.FAILED if mrad > allowed_mrad else Grade.COARSE, reason, remedy)
            )
    return found


def moved_while_filming(names: Sequence[str], moved: MovedCamera | None) -> list[CalibrationFinding]:
    """A camera that sees the person elsewhere for a part of the recording."""
    if moved is None:
        return []
    beside = f"{moved.mrad:.0f} mrad beside where the others do ({moved.usual_mrad:.0f} mrad in the median of all)"
    when = f"from {moved.from_s:.1f} to {moved.to_s:.1f} s"
    reason = f"{when} {'some camera' if moved.camera is None else 'it'} sees the person {beside}"
    remedy = (
        "was it moved, turned or zoomed while it filmed, or is somebody else in its images? The calibration is of the "
        "other time: if it was moved, it is wrong for what was filmed then, or after it"
    )
    return [CalibrationFinding("" if moved.camera is None else names[moved.camera], Grade.COARSE, reason, remedy)]


def moved_in_the_middle(midway: MovedMidway | None) -> list[CalibrationFinding]:
    """A rig that is right for neither half of the recording."""
    if midway is None:
        return []
    reason = (
        "some camera was probably moved while it filmed, about the middle: the whole recording has them "
        f"{1e3 * midway.whole_m:.0f} mm and {midway.whole_deg:.1f} degrees from where either half has them, which are "
        f"{1e3 * midway.halves_m:.0f} mm and {midway.halves_deg:.1f} degrees apart"
    )
    remedy = "calibrate from what was filmed before or after that, with cameras that stand still"
    return [CalibrationFinding("", Grade.COARSE, reason, remedy)]


def twisted(
    names: Sequence[str], cross_check_deg: Float[np.ndarray, " camera"], direction_deg: Float[np.ndarray, " camera"]
) -> list[CalibrationFinding]:
    """Views in which the network sees another pose than was reconstructed. Of a camera whose direction is not certain
    either (standard deviations), as of one that shows a screen, two checks say the same, and it is failed."""
    reason = "its direction contradicts the 3D of its own images by {0:.0f} degrees"
    remedy = (
        "walk across its view and towards it, so that you are seen from several sides; if it shows a screen, a picture "
        "or a mirror instead, leave it out (--cameras)"
    )
    uncertain = dict(zip(names, (direction_deg > _SIGMA_DEG[0]).tolist(), strict=True))
    return [
        replace(finding, grade=Grade.FAILED) if uncertain[finding.camera] else finding
        for finding in _graded(names, cross_check_deg, _REFEREE_DEG, reason, remedy)
    ]


def in_one_place(coverage: Coverage) -> Bool[np.ndarray, " camera"]:
    """Cameras that saw the person in one place only: both halves of a recording share their errors there."""
    return ~(coverage.along_m >= _LEAST_ALONG_M)


def halves_disagree(
    names: Sequence[str], rotation_deg: Float[np.ndarray, " camera"], position: Float[np.ndarray, " camera"]
) -> list[CalibrationFinding]:
    """Cameras that the first half of the recording has elsewhere than the second. Positions are shares of the distance
    to the person."""
    remedy = "record longer, and walk through its whole view in different directions"
    turned = "the two halves of the recording disagree about its direction by {0:.1f} degrees"
    moved = "the two halves of the recording disagree about its place by {0:.0%} of the distance to the person"
    # The whole recording is off by half of what its halves disagree by, or more if both share an error.
    found = _graded(names, rotation_deg, 2 * _SIGMA_DEG, turned, remedy)
    return _worst_of_each(found + _graded(names, position, 2 * _SIGMA, moved, remedy))


def uncertain(
    names: Sequence[str], direction_deg: Float[np.ndarray, " camera"], position: Float[np.ndarray, " camera"]
) -> list[CalibrationFinding]:
    """Cameras whose stated sigmas are large. Positions are shares of the distance to the person."""
    remedy = "record longer, and walk through its whole view in different directions"
    turned = "its direction is known to {0:.1f} degrees only"
    moved = "its place is known to {0:.0%} of the distance to the person only"
    found = _graded(names, direction_deg, _SIGMA_DEG, turned, remedy)
    return _worst_of_each(found + _graded(names, position, _SIGMA, moved, remedy))


def certain(
    direction_deg: Float[np.ndarray, " camera"], position: Float[np.ndarray, " camera"]
) -> Bool[np.ndarray, " camera"]:
    """Whether the stated sigmas of a camera are less than half of what counts as coarse."""
    return np.asarray((direction_deg < _SIGMA_DEG[0] / 2) & (position < _SIGMA[0] / 2))


def focal_undetermined(
    names: Sequence[str],
    estimated: Groups,
    sigma: Float[np.ndarray, " camera"],
    depth_ratio: Float[np.ndarray, " camera"],
) -> list[CalibrationFinding]:
    """Cameras whose focal length was estimated and is not known well; sigmas are shares of it. Of cameras that share a
    lens it is enough that one saw the person near and far."""
    remedy = "walk towards it and away from it, or give its focal length"
    reason = "its focal length is not determined (known to {0:.0%})"
    own = [c for lens in estimated for c in lens]
    found = _graded([names[c] for c in own], sigma[own], _FOCAL, reason, remedy)
    flagged = {finding.camera for finding in found}
    for lens in estimated:
        ratio = np.max(np.nan_to_num(depth_ratio[list(lens)], nan=1.0))
        unsure = [c for c in lens if names[c] not in flagged and sigma[c] > _FOCAL[0] / 2]
        if unsure and ratio < _FOCAL_DEPTH_RATIO:
            # Said once of cameras that share a lens.
            name, whose = ("", "the focal length") if len(lens) > 1 else (names[unsure[0]], "its focal length")
            reason = f"{whose} hardly shows: the person was {ratio:.2f} times as far away at most as at least"
            found.append(CalibrationFinding(name, Grade.COARSE, reason, remedy))
    return found


def focal_wrong(names: Sequence[str], check: FocalCheck | None, *, is_moved: bool = False) -> list[CalibrationFinding]:
    """Cameras whose given focal length the images contradict, as K of another resolution. Where a camera was moved
    while it filmed, lenses make up for it."""
    if check is None:
        return []
    change = np.where(check.wrong > _PROBABLY, np.abs(check.change), 0.0)
    change = np.where(change > _FOCAL_TO_WORST * change.max(), change, 0.0)
    reason = "its focal length seems to be {0:.0%} off what was given"
    remedy = "check that K belongs to this camera and this resolution, or let the focal length be estimated"
    found = _graded(names, change, _WRONG_FOCAL, reason, remedy)
    return [finding for finding in found if finding.grade is Grade.FAILED or not is_moved]


def of_another_size(names: Sequence[str], off_centre: Bool[np.ndarray, " camera"] | None) -> list[CalibrationFinding]:
    """Cameras whose principal point is far from the middle of the image."""
    reason = "the principal point of its K is far from the middle of its image, as of images of another size"
    remedy = "check that K belongs to this camera and this resolution"
    flags = [] if off_centre is None else off_centre.tolist()
    return [
        CalibrationFinding(name, Grade.COARSE, reason, remedy)
        for name, is_off in zip(names, flags, strict=False)
        if is_off
    ]


def start_uncertain(names: Sequence[str], is_certain: Bool[np.ndarray, " camera"]) -> list[CalibrationFinding]:
    """Cameras that may have been put at the wrong time."""
    remedy = "walk fast with turns and stops in between, or give synchronised videos (--synchronised)"
    return [
        CalibrationFinding(name, Grade.COARSE, "its start is not certain", remedy)
        for name, known in zip(names, is_certain.tolist(), strict=True)
        if not known
    ]


def poorly_covered(
    names: Sequence[str], coverage: Coverage, is_certain: Bool[np.ndarray, " camera"], *, is_short: bool = False
) -> list[CalibrationFinding]:
    """Cameras that saw the person in one place, on one line, in a corner of the image, or hardly at all.

    A line or a corner only matter where the camera is not certain all the same. In one place both halves of a recording
    share their errors, so that nothing shows how certain it is. Of a recording that is short as a whole, that is all
    that is to be said.
    """
    if is_short:
        return []
    never = np.zeros(len(names), dtype=bool)
    criteria = (
        (coverage.seen_s, _LEAST_SEEN_S, never, "saw the person for {0:.1f} s only", "walk longer where it sees you"),
        (coverage.along_m, _LEAST_ALONG_M, never, "saw the person in one place only", _THROUGH),
        (
            coverage.across_m,
            _LEAST_ACROSS_M,
            is_certain,
            "saw the person on one line only",
            "walk across its view as well",
        ),
        (coverage.image_share, _LEAST_IMAGE_SHARE, is_certain, "saw the person in {0:.0%} of its image only", _THROUGH),
    )
    found = []
    for c, name in enumerate(names):
        # The first that holds says it all: who was in one place was on one line as well.
        held = (row for row in criteria if not row[0][c] >= row[1] and not row[2][c])
        for values, _, _, reason, remedy in held:
            found.append(CalibrationFinding(name, Grade.COARSE, "it " + reason.format(float(values[c])), remedy))
            break
    return _once(found, names)


def _once(found: list[CalibrationFinding], names: Sequence[str]) -> list[CalibrationFinding]:
    """What holds for every camera is said once."""
    if len(names) < 2 or [finding.camera for finding in found] != list(names) or len({f.reason for f in found}) > 1:
        return found
    return [replace(found[0], camera="", reason=found[0].reason.replace("it saw", "every camera saw"))]


def mirrors(names: Sequence[str], mirrored: Bool[np.ndarray, " camera"], handedness: float) -> list[CalibrationFinding]:
    """Views in which left is right, and a reconstruction that is turned inside out."""
    found = [
        CalibrationFinding(
            name,
            Grade.FAILED,
            "it sees the person mirrored",
            "switch the mirroring of the camera off, or cover the mirror in its view",
        )
        for name, is_mirrored in zip(names, mirrored.tolist(), strict=True)
        if is_mirrored
    ]
    if handedness < -_OWN_HAND and not found:
        reason = "the reconstructed body is turned inside out: its knees bend backwards"
        found.append(
            CalibrationFinding("", Grade.FAILED, reason, "walk nearer to the cameras, and in several directions")
        )
    return found


def nobody_checks(n_cameras: int) -> list[CalibrationFinding]:
    """Of two cameras, simulated ones were off by two degrees that neither the halves nor the epipolar planes show."""
    if n_cameras > 2:
        return []
    reason = "two cameras have no third one that checks them"
    remedy = "add a third camera that sees the walk, if only for the calibration"
    return [CalibrationFinding("", Grade.COARSE, reason, remedy)]


def recording_too_short(duration_s: float) -> list[CalibrationFinding]:
    if duration_s >= SHORT_S:
        return []
    reason = f"two cameras saw the person for {duration_s:.1f} s only"
    return [CalibrationFinding("", Grade.COARSE, reason, "record somebody who walks around for half a minute")]


def nobody_upright(upright: float, camera_tilt_deg: float) -> list[CalibrationFinding]:
    """A vertical that is not one: of somebody who bends, sits or lies."""
    if camera_tilt_deg > _MOST_TILT_DEG:
        reason = f"the person lies, or the cameras do: up differs by {camera_tilt_deg:.0f} degrees between them"
        return [CalibrationFinding("", Grade.COARSE, reason, "walk upright, and turn the videos so that up is up")]
    if upright >= _LEAST_UPRIGHT:
        return []
    reason = f"the vertical is not certain: the person is upright in {upright:.0%} of the frames only"
    return [CalibrationFinding("", Grade.COARSE, reason, "walk upright through the room")]


def _graded(
    names: Sequence[str],
    values: Float[np.ndarray, " camera"],
    limits: Float[np.ndarray, "grade=2"],
    reason: str,
    remedy: str,
) -> list[CalibrationFinding]:
    """Of values above the limits for coarse and failed; NaN is none."""
    found = []
    for name, value in zip(names, values.tolist(), strict=True):
        if value > limits[0]:
            grade = Grade.FAILED if value > limits[1] else Grade.COARSE
            found.append(CalibrationFinding(name, grade, reason.format(value), remedy))
    return found


def _worst_of_each(found: list[CalibrationFinding]) -> list[CalibrationFinding]:
    """One finding a camera, its gravest."""
    worst: dict[str, CalibrationFinding] = {}
    for finding in sorted(found, key=lambda finding: finding.grade.gravity):
        worst[finding.camera] = finding
    return list(worst.values())
