"""What is suspicious of single cameras: calibration, view, and what the network does there."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.calibrated import Grade
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.residuals import USUAL_ERROR_M, errors_m, together_px
from fgpose.diagnosis.series import known_quantile
from fgpose.diagnosis.swapped_sides import swapped_sides
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.changing_rig import of_whole_cameras
from fgpose.sampling import usual_step_s

# A camera at twice the error of the others has a systematic error of sqrt(2^2 - 1) = 1.7 times the random one.
_DISAGREES_RATIO, _MORE_THAN_USUAL = 2.0, 1.5
# It sees less than half of what is usual in this recording.
_BLIND_RATIO = 0.5
# The model of visibility expects some hallucinations everywhere: three times as many as the other cameras have is a
# property of the view. Below a twentieth they do no harm.
_HALLUCINATING_RATIO, _HALLUCINATING_SHARE = 3.0, 0.05
_MUCH_HALLUCINATED = 0.3
# As fgpose.assessment.recording_info: lower, single errors of a good detector are reported.
_SWAPPED_SHARE, _MIN_SWAP_PX = 0.02, 30.0
_LEAST_S = 1.0
_MIN_PAIRS = 3  # that can be judged: one or two may look exchanged by chance
# Hallucinations under occluders look like an exchange of one pair in up to 7 %, hips that a network misplaces in up to
# 14 % (benchmarks/report_checks.py).
_SWAPPED_PAIR_SHARE = 0.15
_SWAP_TO_USUAL = 3.0  # the usual error of the camera is then no more than the tolerance
# Swapped labels leave, at both joints, the distance between the two; to within what detections err usually.
_SWAP_TOLERANCE = 0.25


def few_cameras(recording: FinishedRecording) -> list[Finding]:
    """With two cameras every detection that is wrong along the epipolar line goes unnoticed."""
    n_cameras = len(recording.camera_names)
    if not 0 < n_cameras < 3:
        return []
    return [
        Finding(
            Code.FEW_CAMERAS,
            Severity.NOTE,
            f"{n_cameras} camera{'s' if n_cameras > 1 else ''}: nothing contradicts a detection that is wrong, so "
            "residuals say little about errors",
            "Add cameras: four or more that see the person from different sides.",
            0.8,
        )
    ]


def calibration_findings(recording: FinishedRecording) -> list[Finding]:
    """What the calibration from people said of itself."""
    weight = {Grade.FAILED: 1.0, Grade.COARSE: 0.5}
    return [
        Finding(
            Code.CALIBRATION,
            Severity.DOUBTFUL,
            f"calibration {finding.grade.value}: {finding.reason}",
            finding.remedy,
            weight[grade],
            camera=finding.camera,
        )
        for finding in recording.findings
        if (grade := finding.grade) in weight
    ]


def disagreeing_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera whose reprojection errors are much larger than those of the others and than what networks do; at the
    body, where the rig is known: cameras differ in resolution, and one that is nearer sees more pixels of it."""
    residual_px = together_px(recording)
    if residual_px is None or residual_px.shape[1] < 3:
        return []
    median_px = np.array([known_quantile(of_camera, 0.5) for of_camera in np.moveaxis(residual_px, 1, 0)])
    compared, least = median_px, 0.0
    if recording.rig is not None:
        parts_m = [errors_m(each, recording.rig) for each in recording.people.values()]
        compared = np.array([known_quantile(own, 0.5) for own in np.moveaxis(np.concatenate(parts_m), 1, 0)])
        least = _MORE_THAN_USUAL * USUAL_ERROR_M
    found = []
    for camera, name in enumerate(recording.camera_names):
        usual = known_quantile(np.delete(compared, camera), 0.5)
        if compared[camera] > max(_DISAGREES_RATIO * usual, least):
            constant = _constant_part(recording, camera)
            reason = (
                f"camera {name} disagrees with the others: its median reprojection error is "
                f"{median_px[camera]:.1f} px, {compared[camera] / usual:.1f} times theirs{constant}"
            )
            remedy = (
                "Was it moved since the calibration? Smooth again with --refine-calibration, or calibrate it anew; "
                "with --estimate-time-offsets too if its clock may differ."
            )
            found.append(
                Finding(
                    Code.DISAGREEING_CAMERA,
                    Severity.DOUBTFUL,
                    reason,
                    remedy,
                    0.4 + 0.4 * _share_of(residual_px, camera),
                    camera=name,
                )
            )
    return found


def _constant_part(recording: FinishedRecording, camera: int) -> str:
    """What a turned camera leaves, where the detections are known."""
    if recording.rig is None or not recording.observations:
        return ""
    parts = [
        recording.rig.cameras[camera].undistort(seen.points2d_px[:, camera])
        - recording.rig.cameras[camera].project(recording.people[person].positions_m)
        for person, seen in recording.observations.items()
    ]
    errors_px = np.concatenate([part.reshape(-1, 2) for part in parts])
    x_px, y_px = (known_quantile(errors_px[:, axis], 0.5) for axis in range(2))
    return f", ({x_px:+.1f}, {y_px:+.1f}) px of it the same everywhere"


def blind_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera that sees far less than the others."""
    residual_px = together_px(recording)
    if residual_px is None or residual_px.shape[1] < 2:
        return []
    whole = of_whole_cameras(recording.camera_names, np.isfinite(residual_px).mean(axis=(0, 2)).tolist())
    shares = np.array(list(whole.values()))
    found = []
    for name, share, usual in zip(whole, shares, _median_of_others(shares), strict=True):
        if share < _BLIND_RATIO * usual:
            reason = f"camera {name} sees {100 * share:.0f} % of the joints, the others {100 * usual:.0f} % (median)"
            remedy = "Look at its images: is the person in them, sharp, and not hidden? Turn or move the camera."
            found.append(
                Finding(Code.BLIND_CAMERA, Severity.DOUBTFUL, reason, remedy, 0.5 * (usual - share), camera=name)
            )
    return found


def hallucinating_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera many of whose detections are more probably hallucinated than not."""
    judged = [each.visibility for each in recording.people.values() if each.visibility is not None]
    if not judged:
        return []
    visibility = np.concatenate(judged)
    known = np.isfinite(visibility)
    shares = ((visibility < 0.5) & known).sum(axis=(0, 2)) / np.maximum(known.sum(axis=(0, 2)), 1)
    found = []
    for name, share, usual in zip(recording.camera_names, shares, _median_of_others(shares), strict=True):
        if share > max(_HALLUCINATING_RATIO * usual, _HALLUCINATING_SHARE):
            reason = (
                f"{100 * share:.0f} % of the detections of camera {name} are probably hallucinated, "
                f"{100 * usual:.0f} % of the others'"
            )
            remedy = "Something hides the person there, or the camera disagrees: look at its images first."
            # What a few occluders do is put right by the others; that a third is hallucinated is no occluder.
            severity = Severity.DOUBTFUL if share > _MUCH_HALLUCINATED else Severity.NOTE
            found.append(Finding(Code.HALLUCINATING_CAMERA, severity, reason, remedy, 0.5 * share, camera=name))
    return found


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
    left, right = recording.main.skeleton.left_right[worst]
    return float(shares[worst]), " and ".join(recording.main.skeleton.joints[each] for each in (left, right))


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
    projected_px = recording.rig.project(positions_m)
    apart_px = np.linalg.norm(projected_px[:, :, left] - projected_px[:, :, right], axis=-1)
    errors_px = np.stack([residual_px[:, :, left], residual_px[:, :, right]])
    # A camera that was turned has errors everywhere that are as large as small pairs are apart.
    usual_px = np.array([known_quantile(residual_px[:, c], 0.5) for c in range(residual_px.shape[1])])
    least_px = np.fmax(_MIN_SWAP_PX, _SWAP_TO_USUAL * usual_px)
    judged = np.isfinite(errors_px).all(axis=0) & (apart_px > least_px[:, None])
    like = (np.abs(errors_px - apart_px) < _SWAP_TOLERANCE * apart_px).all(axis=0)
    return np.asarray(judged & like), np.asarray(judged)


def _share_of(residual_px: Float[np.ndarray, "frame camera joint"], camera: int) -> float:
    """Of the detections, those of a camera."""
    known = np.isfinite(residual_px)
    return float(known[:, camera].sum() / max(known.sum(), 1))


def _median_of_others(values: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " camera"]:
    """NaN with one camera."""
    return np.array([known_quantile(np.delete(values, camera), 0.5) for camera in range(len(values))])
