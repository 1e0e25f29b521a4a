"""Cameras whose network exchanges left and right now and then, by the keypoints and by a result."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.body.joint_names import in_words
from fgpose.diagnosis.body.sides import exchanged_limbs
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import camera_medians, together_px
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import parts_of, usual_step_s

_CORRECTED = "Bodies, arms and legs that are exchanged are corrected; if errors stay, use another network."
_NOT_CORRECTED = (
    "No two other cameras tell which side is which, so not all of it is corrected: use a network that looks at more of "
    "the image."
)
# Exchanges of few frames come at other times in each camera: the others are right then. Hallucinations under occluders
# look like an exchange of one pair in up to 7 %; the estimator leaves them out.
_OFTEN = 0.1
# With fewer the median error of a camera is still that of the right sides, and something else makes it disagree.
_DISAGREES = 0.3
# As fgpose.assessment.recording_info: lower, single errors of a good detector are reported.
_SWAPPED_SHARE, _MIN_SWAP_PX = 0.02, 30.0
_LEAST_S = 1.0
_MIN_PAIRS = 3  # that can be judged: one or two may look exchanged by chance
# Of one pair: hips that a network misplaces look exchanged in up to 14 % (benchmarks/report_checks.py).
_SWAPPED_PAIR_SHARE = 0.15
_SWAP_TO_USUAL = 3.0  # the usual error of the camera is then no more than the tolerance
# Swapped labels leave, at both joints, the distance between the two; to within what detections err usually.
_SWAP_TOLERANCE = 0.25


def exchanged_sides(examined: Examined) -> list[Finding]:
    """Cameras that exchange left and right, of arms or legs throughout, or in some frames."""
    throughout = exchanged_limbs(examined)
    if throughout:
        return throughout
    info = examined.info
    shares = {each.name: each.share_swapped for each in info.cameras if each.name in info.suspected_swaps}
    severities = {name: Severity.DOUBTFUL if share > _OFTEN else Severity.NOTE for name, share in shares.items()}
    return swapped_sides(shares, len(info.cameras), of="the pairs that can be judged", severities=severities)


def exchanged_in_images(examined: Examined, camera: str) -> Finding | None:
    """Of a camera that does not agree with the others: as it exchanges left and right in about half of its images."""
    share = next(each.share_swapped for each in examined.info.cameras if each.name == camera)
    if not share > _DISAGREES:
        return None
    own = {camera: Severity.DOUBTFUL}
    return swapped_sides({camera: share}, examined.rig.n_cameras, of="the pairs that can be judged", severities=own)[0]


def swapping_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera in which the network exchanges left and right, of the body or of one pair of joints."""
    if recording.rig is None or together_px(recording) is None:
        return []
    judged_people = [swapped_pairs(recording, each.positions_m, each.residual_px) for each in recording.people.values()]
    swapped, judged = (np.concatenate(each) for each in zip(*judged_people, strict=True))
    shares: dict[str, dict[str, float]] = {}
    for c, name in enumerate(recording.camera_names):
        share, what = _swapped_share(recording, swapped[:, c], judged[:, c])
        if share > 0:
            shares.setdefault(what, {})[name] = share
    severities = dict.fromkeys(recording.camera_names, Severity.DOUBTFUL)
    return [
        finding
        for what, own in shares.items()
        for finding in swapped_sides(
            own, len(recording.camera_names), what=f"of {what}", of="the frames", severities=severities
        )
    ]


def _swapped_share(
    recording: FinishedRecording, swapped: Bool[np.ndarray, "frame pair"], judged: Bool[np.ndarray, "frame pair"]
) -> tuple[float, str]:
    """In which share of the frames that can be judged a camera exchanges the sides of what; 0 where it is too few."""
    whole = judged.sum(axis=1) >= _MIN_PAIRS
    poses = float(np.mean((2 * swapped.sum(axis=1) > judged.sum(axis=1))[whole])) if whole.any() else 0.0
    if poses > _SWAPPED_SHARE:
        return poses, "the body"
    enough = judged.sum(axis=0) * usual_step_s(recording.main.time_s) > _LEAST_S
    shares = np.where(enough, swapped.sum(axis=0) / np.maximum(judged.sum(axis=0), 1), 0.0)
    worst = int(np.argmax(shares)) if len(shares) else 0
    if len(shares) == 0 or shares[worst] <= _SWAPPED_PAIR_SHARE:
        return 0.0, ""
    skeleton = recording.main.skeleton
    return float(shares[worst]), f"the {in_words(skeleton.joints[each] for each in skeleton.left_right[worst])}"


def swapped_pairs(
    recording: FinishedRecording,
    positions_m: Float[np.ndarray, "frame joint 3"],
    residual_px: Float[np.ndarray, "frame camera joint"] | None,
) -> tuple[Bool[np.ndarray, "frame camera pair"], Bool[np.ndarray, "frame camera pair"]]:
    """Which pairs of left and right look exchanged, and which could be judged: both errors are the distance between the
    two joints in the image."""
    assert recording.rig is not None
    assert residual_px is not None
    left, right = np.array(recording.main.skeleton.left_right, dtype=int).reshape(-1, 2).T
    # A camera that was turned has errors everywhere that are as large as small pairs are apart.
    least_px = np.fmax(_MIN_SWAP_PX, _SWAP_TO_USUAL * camera_medians(residual_px))
    swapped, judged = np.zeros((2, *residual_px.shape[:2], len(left)), dtype=bool)
    for part in parts_of(len(positions_m)):
        projected_px = recording.rig.project(positions_m[part])
        apart_px = np.linalg.norm(projected_px[:, :, left] - projected_px[:, :, right], axis=-1)
        errors_px = np.stack([residual_px[part][:, :, left], residual_px[part][:, :, right]])
        judged[part] = np.isfinite(errors_px).all(axis=0) & (apart_px > least_px[:, None])
        like = (np.abs(errors_px - apart_px) < _SWAP_TOLERANCE * apart_px).all(axis=0)
        swapped[part] = judged[part] & like
    return swapped, judged


def swapped_sides(
    shares: Mapping[str, float], n_cameras: int, *, what: str = "", of: str, severities: Mapping[str, Severity]
) -> list[Finding]:
    """One finding for each camera that exchanges sides or, where most of all cameras do, one for these together.

    Args:
        shares: how often each does.
        n_cameras: how many there are.
        what: which sides, as "of the body".
        of: what it is a share of.
        severities: of each camera.
    """
    most = len(shares) > 1 and 2 * len(shares) > n_cameras
    often = sum(share > _OFTEN for share in shares.values())
    remedy = _CORRECTED if n_cameras - often >= 2 or not often else _NOT_CORRECTED
    if not most:
        return [
            _swaps(name, f"camera {name} exchanges", (share, share), what, of, remedy, severities[name])
            for name, share in shares.items()
        ]
    who = "all cameras exchange" if len(shares) == n_cameras else f"cameras {', '.join(shares)} exchange"
    span = min(shares.values()), max(shares.values())
    return [_swaps("", who, span, what, of, remedy, min(severities.values(), key=list(Severity).index))]


def _swaps(
    camera: str, who: str, span: tuple[float, float], what: str, of: str, remedy: str, severity: Severity
) -> Finding:
    low, high = (f"{100 * share:.{0 if share > 0.1 else 1}f}" for share in span)
    share = high if low == high else f"{low} to {high}"
    return Finding(
        Code.EXCHANGED_SIDES,
        severity,
        f"{who} left and right {what + ' ' if what else ''}in {share} % of {of}",
        remedy,
        0.5 * span[1],
        camera=camera,
        numbers={"share": span[1]},
    )
