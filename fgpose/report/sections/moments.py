"""The worst moments, with pictures where there are images."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.geometry.camera import Camera
from fgpose.monocular.common_times import CommonTimes
from fgpose.monocular.sources import Sources, open_sources
from fgpose.report.blocks import Block, Folded, JpegPicture, Note, PicturedMoment, Section
from fgpose.report.sections.worst_moments import WorstMoment, worst_moments
from fgpose.sampling import nearest

_SHOWN = 2
_WIDTH_PX = 260
_ASPECT = 4 / 3  # height to width: people stand
_QUALITY = 72  # of JPEG: the smallest at which lines of two pixels stay clean
_MARGIN = 0.35  # of the size of the person, around them
_RESULT, _DETECTED, _WORST = (255, 255, 255), (86, 180, 233), (230, 120, 0)  # red, green, blue


def moment_section(recording: FinishedRecording) -> Section:
    """The worst first."""
    moments = worst_moments(recording)
    if not moments:
        return Section("Worst moments", "worst", [Note("Nothing is known by which moments could be judged.", True)])
    blocks: list[Block] = []
    shown = {}
    missing = _why_no_pictures(recording)
    if missing:
        blocks.append(Note(missing, is_missing=True))
    else:
        shown, doubt = _pictures(recording, moments)
        blocks += [Note(doubt, is_missing=True)] if doubt else []
    pictured: list[Block] = [
        PicturedMoment(
            _title(recording, moment), f"{moment.reason[0].upper()}{moment.reason[1:]}.", shown.get(moment, ())
        )
        for moment in moments
    ]
    blocks += pictured[:_SHOWN]
    if pictured[_SHOWN:]:
        times = ", ".join(f"{moment.time_s:.2f} s" for moment in moments[_SHOWN:])
        blocks.append(Folded(f"{len(pictured) - _SHOWN} more, at {times}", tuple(pictured[_SHOWN:])))
    intro = (
        "The worst first: where sigma, reprojection errors, those of one camera in most of its joints, or changes of "
        "velocity are largest, each over its usual value in this recording. Of each kind the largest is here."
    )
    if shown:
        drawn = "blue: detections, " if recording.observations else ""
        intro += f" White: the result; {drawn}orange: the joints that are worst; px: error of the first of them."
    return Section("Worst moments", "worst", blocks, intro)


def _title(recording: FinishedRecording, moment: WorstMoment) -> str:
    called, numbers = recording.called(moment.person), recording.people[moment.person].frame_numbers
    when = f"{moment.time_s:.2f} s" + ("" if numbers is None else f" (frame {numbers[moment.frame]})")
    return f"{when}{f', {called}' if called else ''}: {', '.join(moment.joints)}"


def _why_no_pictures(recording: FinishedRecording) -> str:
    if recording.videos is None:
        return "No pictures: the videos were not given (--videos FOLDER)."
    if recording.rig is None:
        return "No pictures: they need the calibration (--rig FILE)."
    return ""


def _pictures(
    recording: FinishedRecording, moments: Sequence[WorstMoment]
) -> tuple[dict[WorstMoment, tuple[JpegPicture, ...]], str]:
    """Those of pictures, and why there are none, or why they are probably of other moments; empty: they are not.

    Raises as pictures.
    """
    assert recording.rig is not None
    assert recording.videos is not None
    sources = open_sources(recording.videos, recording.rig, fps=recording.images_hz)
    taken_s = sources.taken_s()
    found = pictures(recording, moments, sources, taken_s)
    times = CommonTimes.of(recording.people, taken_s, sources.fps)
    if any(found.values()):
        return found, times.doubt()
    first_s, last_s = times.images_s
    of_others = f"no image is of these moments, all are from {first_s:.10g} s to {last_s:.10g} s."
    return {}, f"No pictures: {times.nothing() or times.doubt() or of_others}"


def pictures(
    recording: FinishedRecording,
    moments: Sequence[WorstMoment],
    sources: Sources,
    taken_s: Sequence[np.ndarray],
) -> dict[WorstMoment, tuple[JpegPicture, ...]]:
    """One of each camera and moment; none of a camera whose video has ended.

    Args:
        recording: whose moments these are.
        moments: the worst.
        sources: what its cameras recorded.
        taken_s: when the images of each camera, (image,), were taken, see Sources.taken_s.

    Raises:
        ValueError: the videos are not those of the rig, or one is damaged; the message names the file.
        OSError: a file cannot be opened.
    """
    times_s = np.array([moment.time_s for moment in moments])
    found: dict[WorstMoment, list[JpegPicture]] = {moment: [] for moment in moments}
    for c, (camera, clip, own_s) in enumerate(zip(sources.rig.cameras, sources.clips, taken_s, strict=True)):
        numbers = dict(zip(moments, _image_numbers(own_s, 1 / clip.fps, times_s), strict=True))
        images = clip.images_at(sorted({number for number in numbers.values() if number is not None}))
        for moment, number in numbers.items():
            if number in images:
                found[moment].append(_picture(recording, moment, camera, c, images[number]))
    return {moment: tuple(of_moment) for moment, of_moment in found.items()}


def _image_numbers(
    taken_s: Float[np.ndarray, " image"], step_s: float, times_s: Float[np.ndarray, " moment"]
) -> list[int | None]:
    """That of the image nearest to each time; none before the first image, and after the last."""
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
