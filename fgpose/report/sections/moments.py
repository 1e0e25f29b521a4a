"""The five worst moments, with pictures where there are images."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import known_quantile, sigma_m
from fgpose.geometry.camera import Camera
from fgpose.monocular.clips import Clip
from fgpose.monocular.sources import open_sources
from fgpose.report.blocks import Block, JpegPicture, Note, PicturedMoment, Section
from fgpose.sampling import nearest
from fgpose.trajectory import Trajectory

_AT_MOST = 5
# Two moments are further apart than this, or than a twentieth of the recording: else all five are one.
_APART_S = 1.0
_WIDTH_PX = 260
_ASPECT = 4 / 3  # height to width: people stand
_QUALITY = 72  # of JPEG: the smallest at which lines of two pixels stay clean
_MARGIN = 0.35  # of the size of the person, around them
_RESULT, _DETECTED, _WORST = (255, 255, 255), (86, 180, 233), (230, 120, 0)  # red, green, blue


@dataclass(frozen=True)
class WorstMoment:
    """A frame in which much is wrong."""

    person: int
    frame: int
    """Of that person's trajectory."""
    time_s: float
    reason: str
    joints: tuple[str, ...]
    """Those that are worst."""


def worst_moments(recording: FinishedRecording) -> list[WorstMoment]:
    """At most five of all people, in the order of time: where uncertainty, reprojection errors and changes of velocity
    are largest, each over its usual value in this recording."""
    found: list[tuple[float, WorstMoment]] = []
    for person, trajectory in recording.people.items():
        ratios = {
            "sigma": _ratio(sigma_m(trajectory)),
            "reprojection error": _ratio(_error_px(trajectory)),
            "change of velocity": _ratio(_change_m(trajectory)),
        }
        together = np.stack(list(ratios.values()))
        # Of the body: one joint of thirty that is off is not the worst that can be. Mean of the worst quarter.
        n_worst = max(trajectory.skeleton.n_joints // 4, 1)
        scores = np.sort(together, axis=-1)[..., -n_worst:].mean(axis=-1)
        # Each kind over what it seldom exceeds: changes of velocity vary by more than sigma does.
        scores /= np.maximum(np.quantile(scores, 0.95, axis=-1, keepdims=True), 1e-12)
        for frame in _peaks(scores.max(axis=0), trajectory.time_s).tolist():
            kind = list(ratios)[int(scores[:, frame].argmax())]
            found.append((scores[:, frame].max(), _described(trajectory, person, frame, kind, ratios[kind][frame])))
    found.sort(key=lambda each: -each[0])
    return sorted((moment for _, moment in found[:_AT_MOST]), key=lambda moment: moment.time_s)


def _described(
    trajectory: Trajectory, person: int, frame: int, kind: str, ratio: Float[np.ndarray, " joint"]
) -> WorstMoment:
    worst = np.argsort(-ratio)[:3].tolist()
    joints = tuple(trajectory.skeleton.joints[j] for j in worst)
    worst_joint = trajectory.skeleton.joints[worst[0]]
    words = f"{kind} of {worst_joint} {ratio[worst[0]]:.1f} times the usual"
    if len(joints) > 1:
        words += f", of {' and '.join(joints[1:])} up to {ratio[worst[1]]:.1f} times"
    if trajectory.residual_px is not None:
        n_views = int(np.isfinite(trajectory.residual_px[frame, :, worst[0]]).sum())
        words += f"; {n_views} of {len(trajectory.camera_names)} cameras see {worst_joint}"
    return WorstMoment(person, frame, float(trajectory.time_s[frame]), words, joints)


def _ratio(values: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, "frame joint"]:
    """Over the median of all; zero where it is not known."""
    usual = known_quantile(values, 0.5)
    return np.nan_to_num(values / usual) if usual > 0 else np.zeros(values.shape)


def _error_px(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """Largest over the cameras of those errors that count: hallucinated detections are left out."""
    if trajectory.residual_px is None:
        return np.full(trajectory.status.shape, np.nan)
    residual_px = np.where(np.isfinite(trajectory.residual_px), trajectory.residual_px, -np.inf)
    if trajectory.visibility is not None:
        residual_px = np.where(trajectory.visibility < 0.5, -np.inf, residual_px)
    largest_px = residual_px.max(axis=1, initial=-np.inf)
    return np.where(np.isfinite(largest_px), largest_px, np.nan)


def _change_m(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    change_m = np.full(trajectory.status.shape, np.nan)
    if trajectory.n_frames > 2:
        change_m[1:-1] = np.linalg.norm(np.diff(trajectory.positions_m, 2, axis=0), axis=-1)
    return change_m


def _peaks(score: Float[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> Int[np.ndarray, " peak"]:
    """Frames of the highest scores, well apart."""
    apart_s = max(_APART_S, (time_s[-1] - time_s[0]) / 20)
    left, peaks = score.copy(), []
    while len(peaks) < _AT_MOST and np.isfinite(left).any() and left.max() > 0:
        peaks.append(int(left.argmax()))
        left[np.abs(time_s - time_s[peaks[-1]]) < apart_s] = -np.inf
    return np.array(peaks, dtype=int)


def moment_section(recording: FinishedRecording) -> Section:
    """In the order of time."""
    moments = worst_moments(recording)
    if not moments:
        return Section("Worst moments", "worst", [Note("Nothing is known by which moments could be judged.", True)])
    blocks: list[Block] = []
    shown = {}
    missing = _why_no_pictures(recording)
    if missing:
        blocks.append(Note(missing, is_missing=True))
    else:
        shown = pictures(recording, moments)
    blocks += [
        PicturedMoment(
            _title(recording, moment), f"{moment.reason[0].upper()}{moment.reason[1:]}.", shown.get(moment, ())
        )
        for moment in moments
    ]
    intro = (
        "Where sigma, reprojection errors or changes of velocity are largest, each over its usual value in this "
        "recording."
    )
    if shown:
        drawn = "blue: detections, " if recording.observations else ""
        intro += f" White: the result; {drawn}orange: the joints that are worst; px: error of the first of them."
    return Section("Worst moments", "worst", blocks, intro)


def _title(recording: FinishedRecording, moment: WorstMoment) -> str:
    called = recording.called(moment.person)
    return f"{moment.time_s:.2f} s (frame {moment.frame}){f', {called}' if called else ''}: {', '.join(moment.joints)}"


def _why_no_pictures(recording: FinishedRecording) -> str:
    if recording.videos is None:
        return "No pictures: the videos were not given (--videos FOLDER)."
    if recording.rig is None:
        return "No pictures: they need the calibration (--rig FILE)."
    return ""


def pictures(
    recording: FinishedRecording, moments: Sequence[WorstMoment]
) -> dict[WorstMoment, tuple[JpegPicture, ...]]:
    """One of each camera and moment; none of a camera whose video has ended.

    Raises:
        ValueError: the videos are not those of the rig, or one is damaged; the message names the file.
        OSError: a file cannot be opened.
    """
    assert recording.rig is not None
    assert recording.videos is not None
    sources = open_sources(recording.videos, recording.rig, fps=recording.images_hz)
    found: dict[WorstMoment, list[JpegPicture]] = {moment: [] for moment in moments}
    for c, (camera, clip) in enumerate(zip(sources.rig.cameras, sources.clips, strict=True)):
        times_s = np.array([moment.time_s + camera.time_offset_s for moment in moments])
        numbers = dict(zip(moments, _image_numbers(clip, times_s), strict=True))
        images = clip.images_at(sorted({number for number in numbers.values() if number is not None}))
        for moment, number in numbers.items():
            if number in images:
                found[moment].append(_picture(recording, moment, camera, c, images[number]))
    return {moment: tuple(of_moment) for moment, of_moment in found.items()}


def _image_numbers(clip: Clip, times_s: Float[np.ndarray, " moment"]) -> list[int | None]:
    """That of the image nearest to each time; none before the first image, and after the last."""
    taken_s = clip.times_s(clip.stamps_s())
    step_s = 1 / clip.fps
    is_there = (times_s > taken_s[0] - step_s) & (times_s < taken_s[-1] + step_s)
    return [n if there else None for n, there in zip(nearest(times_s, taken_s).tolist(), is_there, strict=True)]


def _picture(
    recording: FinishedRecording, moment: WorstMoment, camera: Camera, c: int, image: np.ndarray
) -> JpegPicture:
    trajectory = recording.people[moment.person]
    joints_px = camera.distort(camera.project(trajectory.positions_m[moment.frame]))
    seen = recording.observations.get(moment.person)
    detected_px = None if seen is None else seen.points2d_px[moment.frame, c]
    cut, scale, origin = _cut(image, joints_px, detected_px)
    _draw(
        cut,
        (joints_px - origin) * scale,
        recording,
        moment,
        None if detected_px is None else (detected_px - origin) * scale,
    )
    note = ""
    if trajectory.residual_px is not None:
        worst = trajectory.skeleton.index(moment.joints[0])
        error_px = trajectory.residual_px[moment.frame, c, worst]
        note = f": {error_px:.0f} px" if np.isfinite(error_px) else f": {moment.joints[0]} not seen"
    called = recording.called(moment.person) or "the person"
    alt = f"Image of camera {camera.name} at {moment.time_s:.2f} s: {called}, with the skeleton of the result over it"
    return JpegPicture(_jpeg(cut), f"{camera.name}{note}", alt)


def _cut(
    image: np.ndarray, joints_px: Float[np.ndarray, "joint 2"], detected_px: Float[np.ndarray, "joint 2"] | None
) -> tuple[np.ndarray, float, Float[np.ndarray, " 2"]]:
    """The person with a margin, in the shape of a portrait; its scale, and where it begins in the image."""
    import cv2

    size = np.array(image.shape[1::-1], dtype=float)
    points_px = joints_px if detected_px is None else np.concatenate([joints_px, detected_px])
    known = points_px[
        np.isfinite(points_px).all(axis=1) & (points_px > -size).all(axis=1) & (points_px < 2 * size).all(axis=1)
    ]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2), size)
    middle, side = (low + high) / 2, (high - low) * (1 + _MARGIN)
    width = min(max(side[0], side[1] / _ASPECT, 64.0), size[0], size[1] / _ASPECT)
    wanted = np.array([width, width * _ASPECT])
    origin = np.clip(middle - wanted / 2, 0, np.maximum(size - wanted, 0)).round()
    x, y = origin.astype(int)
    part = image[y : y + int(wanted[1]), x : x + int(wanted[0])]
    scale = _WIDTH_PX / part.shape[1]
    small = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    return np.ascontiguousarray(small), scale, origin


def _draw(
    image: np.ndarray,
    joints_px: Float[np.ndarray, "joint 2"],
    recording: FinishedRecording,
    moment: WorstMoment,
    detected_px: Float[np.ndarray, "joint 2"] | None,
) -> None:
    import cv2

    def at(point_px: np.ndarray) -> tuple[int, int] | None:
        near = np.isfinite(point_px).all() and (np.abs(point_px) < 4 * _WIDTH_PX).all()
        return (round(float(point_px[0])), round(float(point_px[1]))) if near else None

    skeleton = recording.main.skeleton
    for start, end in (*skeleton.bones, *skeleton.lines):
        ends = at(joints_px[start]), at(joints_px[end])
        if ends[0] and ends[1]:
            cv2.line(image, ends[0], ends[1], (40, 40, 40), 3, cv2.LINE_AA)
            cv2.line(image, ends[0], ends[1], _RESULT, 1, cv2.LINE_AA)
    for j, joint in enumerate(skeleton.joints):
        place = at(joints_px[j])
        if detected_px is not None and (detected := at(detected_px[j])):
            if place:
                cv2.line(image, place, detected, _DETECTED, 1, cv2.LINE_AA)
            cv2.circle(image, detected, 2, _DETECTED, -1, cv2.LINE_AA)
        if place and joint in moment.joints:
            cv2.circle(image, place, 6, _WORST, 2, cv2.LINE_AA)


def _jpeg(image: np.ndarray) -> str:
    """As a data: address; the image is red, green, blue."""
    import cv2

    done, content = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    assert done
    return f"data:image/jpeg;base64,{base64.b64encode(content.tobytes()).decode()}"
