"""Lenses that are not those of the calibration, by the rays of a whole recording, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fgpose.calibration.changes.breathing import Breathing
from fgpose.calibration.changes.lenses import Lens, LensFit, distortion_of
from fgpose.diagnosis.body.joint_names import in_a_row
from fgpose.diagnosis.changes.in_words import POSES
from fgpose.diagnosis.hypotheses.images import shift_in_words
from fgpose.finding import Code, Finding, Severity

_JUDGED = "with it, cameras agree better on somebody who walks about, in the seconds that were not used to find it"
_OF_LENS = {
    Lens.FOCAL_LENGTH: (
        "The focal length of {who} is not that of the calibration, but about {factor:.2f} times as long",
        "Was the lens zoomed, or a crop or stabilisation of the camera switched on? Calibrate {whose} anew, or "
        "multiply the focal lengths by {factor:.2f}.",
    ),
    Lens.WIDTH: (
        "The horizontal focal length (fx) of {who} is not the calibration's, but about {factor:.2f} times as long",
        "Were images resized in one direction only? Multiply fx by {factor:.2f}, or calibrate {whose} anew.",
    ),
    Lens.HEIGHT: (
        "The vertical focal length (fy) of {who} is not the calibration's, but about {factor:.2f} times as long",
        "Were images resized in one direction only? Multiply fy by {factor:.2f}, or calibrate {whose} anew.",
    ),
    Lens.DISTORTION: (
        "The lens of {who} distorts (k1 is about {k1:+.2f}), and the calibration has no distortion",
        "Were the coefficients left out, or is it a fisheye lens? Give them with the calibration, or calibrate {whose} "
        "anew; {k1:+.2f}, {k2:+.2f}, 0, 0 are nearer to it than none.",
    ),
    Lens.OTHER_DISTORTION: (
        "The lens of {who} distorts otherwise than the calibration says (its k1 is off by about {k1_change:+.2f})",
        "Are the coefficients those of another lens, or of another mode of the camera? Calibrate {whose} anew.",
    ),
    Lens.NONE_LEFT: (
        "The keypoints of {who} have no distortion, and the calibration has",
        "Were the images undistorted before? Then leave the distortion out of the calibration.",
    ),
    Lens.SIGN: (
        "The distortion of {who} has the other sign than the calibration says",
        "Some programs state the coefficients that undistort: give those of OpenCV, or change their signs.",
    ),
    Lens.ORDER: (
        "The distortion of {who} suits if the coefficients are k1 k2 k3 p1 p2 and not k1 k2 p1 p2 k3",
        "Write them in OpenCV's order: k1 k2 p1 p2 k3.",
    ),
    Lens.PINHOLE: (
        "The lens of {who} is no fisheye lens, as the calibration says",
        "Are the coefficients those of OpenCV's pinhole, k1 k2 p1 p2? Say so in the calibration.",
    ),
    Lens.FISHEYE: (
        "The lens of {who} is not the calibration's: as a fisheye lens with the same coefficients it suits better",
        "Are the coefficients those of cv2.fisheye? Then say so in the calibration (lens: fisheye). Are they those of "
        "another lens? Then calibrate {whose} anew.",
    ),
}


def other_lenses(fits: Sequence[LensFit], names: Sequence[str]) -> list[Finding]:
    """One of each, shifts of images together."""
    sure = [each for each in fits if each.or_else is None]
    return [
        *_shifted([each for each in sure if each.lens.is_shift]),
        *(_other_lens(each, names) for each in sure if not each.lens.is_shift),
        *(_either(each, each.or_else, names) for each in fits if each.or_else is not None),
    ]


def _either(fit: LensFit, or_else: LensFit, names: Sequence[str]) -> Finding:
    """Two of which the recording does not tell which it is; whose advice helps nobody if it is the other."""
    one, other = (_shifted([each])[0] if each.lens.is_shift else _other_lens(each, names) for each in (fit, or_else))
    reason = f"{one.reason.removesuffix(f': {_JUDGED}')}. Or: {other.reason.removesuffix(f': {_JUDGED}')}"
    return replace(
        one,
        reason=f"{reason}. This recording does not tell which: {_JUDGED}",
        remedy=f"{one.remedy} Or: {other.remedy} Look which it is.",
        numbers={},
    )


def or_the_other(camera: int, names: Sequence[str]) -> str:
    """Two cameras cannot tell which of them is wrong."""
    return f" (or {names[1 - camera]}: with two cameras it cannot be told which)" if len(names) == 2 else ""


def unsteady_lenses(found: Sequence[Breathing], names: Sequence[str]) -> list[Finding]:
    """Those whose focal length changes to and fro, in one finding."""
    if not found:
        return []
    cameras, most = [names[c] for c in sorted(each.camera for each in found)], max(each.share for each in found)
    alone = cameras[0] if len(found) == 1 else ""
    who = f"{alone}{or_the_other(found[0].camera, names)}" if alone else f"{in_a_row(cameras)}, perhaps of others too,"
    reason = (
        f"The focal length of {who} changes to and fro while the recording lasts, by {100 * most:.1f} % (standard "
        "deviation), as of a lens that is focused anew: arms and legs agree on it, each by themselves"
    )
    left_out = ", or leave it out with --cameras" if alone and len(names) > 2 else ""
    remedy = (
        f"Is the autofocus on, or a zoom? Switch it off, calibrate at that focus, and record again{left_out}. {POSES} "
        "finds poses, which do not change, and does not repair it."
    )
    numbers = {"focal_share": most, "cameras": float(len(found))}
    return [Finding(Code.UNSTEADY_LENS, Severity.DOUBTFUL, reason, remedy, 0.8, camera=alone, numbers=numbers)]


def _other_lens(fit: LensFit, names: Sequence[str]) -> Finding:
    one = len(fit.cameras) == 1
    who = f"{names[fit.cameras[0]]}{or_the_other(fit.cameras[0], names)}" if one else "all cameras"
    whose = "its lens" if one else "the lenses"
    words = {"who": who, "whose": whose, "factor": fit.factor, **_numbers_of_lens(fit)}
    reason, remedy = (text.format(**words) for text in _OF_LENS[fit.lens])
    return Finding(
        Code.WRONG_LENS,
        Severity.WRONG,
        f"{reason}: {_JUDGED}",
        remedy,
        0.9,
        camera=names[fit.cameras[0]] if one else "",
        numbers=_numbers_of_lens(fit),
    )


def _shifted(fits: Sequence[LensFit]) -> list[Finding]:
    """Images of all cameras, in x, y or both."""
    if not fits:
        return []
    by_px = {"cx_px" if each.lens is Lens.CENTRE_X else "cy_px": each.value * each.focal_px for each in fits}
    reason, remedy = shift_in_words(by_px)
    return [Finding(Code.WRONG_LENS, Severity.WRONG, f"{reason}: {_JUDGED}", remedy, 0.9, numbers=by_px)]


def _numbers_of_lens(fit: LensFit) -> dict[str, float]:
    named = {
        Lens.FOCAL_LENGTH: {"focal_factor": fit.factor},
        Lens.WIDTH: {"fx_factor": fit.factor},
        Lens.HEIGHT: {"fy_factor": fit.factor},
        Lens.DISTORTION: dict(zip(("k1", "k2"), distortion_of(fit.value), strict=False)),
        Lens.OTHER_DISTORTION: {"k1_change": fit.value},
        Lens.NONE_LEFT: {"distortion_factor": 0.0},
        Lens.SIGN: {"distortion_factor": -1.0},
    }
    return named.get(fit.lens, {})
