"""What is suspicious of single cameras: calibration, view, and what the network does there."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.calibrated import Grade, by_remedy
from fgpose.diagnosis.body.joint_names import in_a_row, in_words_by_part, limb_of
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import SAMPLES, USUAL_ERROR_M, camera_medians, errors_m, together_px
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.changing_rig import of_whole_cameras
from fgpose.geometry.triangulation import parallaxes_deg
from fgpose.sampling import spread_evenly, usual_step_s
from fgpose_factors.robust_statistics import known_quantile

# A camera at twice the error of the others has a systematic error of sqrt(2^2 - 1) = 1.7 times the random one.
_DISAGREES_RATIO, _MORE_THAN_USUAL = 2.0, 1.5
# It sees less than half of what is usual in this recording.
_BLIND_RATIO = 0.5
# The model of visibility expects some hallucinations everywhere: three times as many as the other cameras have is a
# property of the view. Below a twentieth they do no harm.
_HALLUCINATING_RATIO, _HALLUCINATING_SHARE = 3.0, 0.05
_MUCH_HALLUCINATED = 0.3
_LEFT_OUT_RATIO = 2.0  # of limbs
# One joint that a view shows elsewhere more often than not, and hardly any other.
_OFTEN, _HARDLY = 0.5, 0.1
_LIMBS_NAMED = 4
_LEAST_S = 1.0
# Of cameras on a bar of 0.9 m at 4.5 m errors are 60 to 80 mm, three to four times those of a ring.
_NARROW_DEG = 15.0
# Somebody who comes near to them is seen along lines that are further apart, and then goes away again.
_OFTEN_NARROW, _MOSTLY = 0.25, 0.9


def few_cameras(recording: FinishedRecording) -> list[Finding]:
    """With two cameras every detection that is wrong along the epipolar line goes unnoticed; the more side by side all
    cameras stand, the more the distance errs by it."""
    n_cameras, apart_deg = len(recording.camera_names), _apart_deg(recording)
    narrow = apart_deg[apart_deg < _NARROW_DEG]
    if len(narrow) > _OFTEN_NARROW * len(apart_deg):
        return [_side_by_side(n_cameras, float(np.median(narrow)), len(narrow) / len(apart_deg))]
    if not 0 < n_cameras < 3:
        return []
    return [
        Finding(
            Code.FEW_CAMERAS,
            Severity.NOTE,
            f"{n_cameras} camera{'s' if n_cameras > 1 else ''}: nothing contradicts a detection that is wrong, or a "
            "camera that was turned to the side since it was calibrated, so residuals say little about errors",
            "Add cameras: four or more that see the person from different sides.",
            0.8,
        )
    ]


def _side_by_side(n_cameras: int, apart_deg: float, share: float) -> Finding:
    larger = 1 / np.tan(np.deg2rad(max(apart_deg, 0.1)) / 2)  # 1 where the lines are at right angles
    where = "" if share > _MOSTLY else f" in {100 * share:.0f} % of the places where the person is"
    return Finding(
        Code.FEW_CAMERAS,
        Severity.DOUBTFUL,
        f"{n_cameras} cameras that look at the person along lines only {apart_deg:.2g} degrees apart{where}: how far "
        f"away somebody is errs {larger:.0f} times as much as where they are in the image"
        + (", and nothing contradicts it" if n_cameras == 2 else ""),
        "Let them look from directions that differ by 30 to 150 degrees, or add a camera.",
        0.8,
        numbers={"apart_deg": apart_deg, "share": share},
    )


def _apart_deg(recording: FinishedRecording) -> Float[np.ndarray, " place"]:
    """Largest angle between the lines along which cameras look at people, in some places; none if it is not known."""
    if recording.rig is None or len(recording.camera_names) < 2:
        return np.zeros(0)
    some = [
        each.positions_m[spread_evenly(each.n_frames, SAMPLES)] for each in recording.people.values() if each.n_frames
    ]
    positions_m = np.concatenate([np.zeros((0, 3)), *(each.reshape(-1, 3) for each in some)])
    return parallaxes_deg(positions_m, recording.rig.subset(recording.camera_names))


def calibration_findings(recording: FinishedRecording) -> list[Finding]:
    """What the calibration from people or with a board said of itself; what the same helps against together."""
    weight = {Grade.FAILED: 1.0, Grade.COARSE: 0.5}
    return [
        Finding(
            Code.CALIBRATION,
            Severity.DOUBTFUL,
            f"calibration {grade.value}, {'; '.join(each.text for each in together)}",
            _as_sentence(together[0].remedy),
            weight[grade],
            camera=together[0].camera if len(together) == 1 else "",
        )
        for together in by_remedy(recording.findings)
        if (grade := together[0].grade) in weight
    ]


def _as_sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}." if words else ""


def disagreeing_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera whose reprojection errors are much larger than those of the others and than what networks do; at the
    body, where the rig is known: cameras differ in resolution, and one that is nearer sees more pixels of it."""
    residual_px = together_px(recording)
    if residual_px is None or residual_px.shape[1] < 3:
        return []
    median_px = camera_medians(residual_px)
    compared, least = median_px, 0.0
    if recording.rig is not None:
        compared = camera_medians(np.concatenate([errors_m(each, recording.rig) for each in recording.people.values()]))
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
    shares = _hallucinated_share(np.concatenate(judged), (0, 2))
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


def _share_of(residual_px: Float[np.ndarray, "frame camera joint"], camera: int) -> float:
    """Of the detections, those of a camera."""
    known = np.isfinite(residual_px)
    return float(known[:, camera].sum() / max(known.sum(), 1))


def _hallucinated_share(visibility: Float[np.ndarray, "frame camera joint"], axes: tuple[int, ...]) -> np.ndarray:
    """Of the detections along some axes, how many are more probably hallucinated than not."""
    return (visibility < 0.5).sum(axis=axes) / np.maximum(np.isfinite(visibility).sum(axis=axes), 1)


def _median_of_others(values: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " camera"]:
    """NaN with one camera."""
    return np.array([known_quantile(np.delete(values, camera), 0.5) for camera in range(len(values))])


def misplaced_joints(recording: FinishedRecording) -> list[Finding]:
    """A joint that one view shows in another place than the others: its network takes something else for it. Where
    no two views agree, none is right: it is the joint that is not to be seen."""
    found = []
    for person, trajectory in recording.people.items():
        if trajectory.visibility is None or trajectory.n_frames < 2:
            continue
        known = np.isfinite(trajectory.visibility)
        judged = known.sum(axis=0) * usual_step_s(trajectory.time_s) > _LEAST_S
        shares = _hallucinated_share(trajectory.visibility, (0,))
        elsewhere = (shares > _OFTEN) & judged
        wrong = elsewhere & (np.median(shares, axis=1, keepdims=True) < _HARDLY)
        wrong |= judged & _limbs_left_out(shares)
        nowhere = (wrong.sum(axis=0) >= 2) & ((judged & ~elsewhere).sum(axis=0) < 2)
        if nowhere.any():
            found.append(_seen_by_nobody(recording, person, np.flatnonzero(nowhere).tolist(), shares))
        for c in np.flatnonzero((wrong & ~nowhere).any(axis=1)).tolist():
            limbs: dict[str, list[int]] = {}
            for j in np.flatnonzero(wrong[c] & ~nowhere).tolist():
                limbs.setdefault(
                    trajectory.skeleton.part_names[j] or limb_of(trajectory.skeleton.joints[j]), []
                ).append(j)
            found.append(_misplaced(recording, person, c, list(limbs.values()), shares[c]))
    return found


def _limbs_left_out(shares: Float[np.ndarray, "camera joint"]) -> Bool[np.ndarray, "camera joint"]:
    """Joints that are hallucinated in a camera as often as no occluder makes them, some times as often as they are in
    the others and as its other joints are: two at least, as of a limb. What all others take for it is believed."""
    usual = np.maximum(
        np.median(shares, axis=1)[:, None], np.stack([_median_of_others(own) for own in shares.T], axis=1)
    )
    much = (shares > _MUCH_HALLUCINATED) & (shares > _LEFT_OUT_RATIO * usual)
    return much & (much.sum(axis=1, keepdims=True) >= 2)


def _seen_by_nobody(
    recording: FinishedRecording, person: int, joints: list[int], shares: Float[np.ndarray, "camera joint"]
) -> Finding:
    """Of joints of which no two views agree."""
    skeleton = recording.people[person].skeleton
    named = in_words_by_part(skeleton, [skeleton.joints[joint] for joint in joints])
    low, high = np.quantile(shares[:, joints][shares[:, joints] > _OFTEN], (0.0, 1.0))
    return Finding(
        Code.MISPLACED_JOINT,
        Severity.DOUBTFUL,
        f"{recording.prefix(person)}no two cameras agree where {named} "
        f"{'are' if len(joints) > 1 else 'is'}: they contradict each other in {100 * low:.0f} to {100 * high:.0f} % of "
        "the detections",
        "Look at the images: hidden from all, guessed by the network, or not there? Leave such detections out with "
        "--min-confidence, or use a skeleton without these joints.",
        0.3 * float(high),
        joint=skeleton.joints[joints[0]],
        person=recording.number(person),
    )


def _misplaced(
    recording: FinishedRecording, person: int, camera: int, limbs: list[list[int]], shares: Float[np.ndarray, " joint"]
) -> Finding:
    """Of joints of limbs, hands or the face in one view."""
    skeleton, name = recording.people[person].skeleton, recording.camera_names[camera]
    limbs = sorted(limbs, key=lambda joints: -float(shares[joints].max()))
    words = [in_words_by_part(skeleton, [skeleton.joints[joint] for joint in joints]) for joints in limbs]
    worst = max(limbs[0], key=lambda joint: float(shares[joint]))
    if len(limbs) == 1:
        where = _displacement(recording, person, camera, worst)
        said = f"{words[0]} elsewhere than the others do in {100 * shares[worst]:.0f} % of its detections{where}"
        cause = "what does the network take for this? A coat, a chair, the other side?"
    else:
        each = [f"{own} ({100 * shares[joints].max():.0f} %)" for own, joints in zip(words, limbs, strict=True)]
        named = [*each[:_LIMBS_NAMED], f"{len(each) - _LIMBS_NAMED} more"] if len(each) > _LIMBS_NAMED else each
        said = f"{in_a_row(named)} elsewhere than the others do, in so many of its detections"
        cause = "what hides the person there, or what does the network take for it?"
    return Finding(
        Code.MISPLACED_JOINT,
        Severity.DOUBTFUL,
        f"{recording.prefix(person)}camera {name} shows {said}",
        f"Look at its images: {cause} Or do the others: which of them are right is not told.",
        0.3 * float(shares[worst]),
        camera=name,
        joint=skeleton.joints[worst],
        person=recording.number(person),
    )


def _displacement(recording: FinishedRecording, person: int, camera: int, joint: int) -> str:
    """By how far on the body, where the detections are known."""
    seen = recording.observations.get(person)
    if seen is None or recording.rig is None:
        return ""
    joint_m = recording.people[person].positions_m[:, [joint]]
    pinhole = recording.rig.cameras[camera]
    error_px = pinhole.undistort(seen.points2d_px[:, camera, [joint]]) - pinhole.project(joint_m)
    error_m = error_px[:, 0] / recording.rig.px_per_m(joint_m)[:, camera]
    distance_m = float(np.linalg.norm([known_quantile(axis_m, 0.5) for axis_m in error_m.T]))
    return f", by {100 * distance_m:.0f} cm (median)" if np.isfinite(distance_m) else ""
