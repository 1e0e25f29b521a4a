"""The static part of the recording of several people, to which every person adds theirs."""

from __future__ import annotations

import numpy as np
import rerun as rr
from jaxtyping import Int, UInt16

from fgpose.geometry.camera import CameraRig
from fgpose.people import NOBODY
from fgpose.skeleton import Skeleton
from fgpose.viewer import palette, paths
from fgpose.viewer.presence import Presence
from fgpose.viewer.scene import annotation_class, log_body_styles, log_cameras, log_line
from fgpose.viewer.session import UpAxis

# Smaller than those of one person: people are smaller in the images, and may hide each other.
_DETECTION_RADIUS = rr.Radius.ui_points(2.5)
_LABEL_RADIUS = rr.Radius.ui_points(0.5)  # the text is to be seen, not its point


def detection_class(person: Int[np.ndarray, " point"]) -> UInt16[np.ndarray, " point"]:
    """Annotation of the detections of these people, by their colours, or of nobody: 0."""
    return np.where(person == NOBODY, 0, 1 + 2 * (person % len(palette.PEOPLE))).astype(np.uint16)


def _body_class(person: int) -> int:
    """Annotation of what was estimated of somebody: the same colour, and bones."""
    return 2 + 2 * (person % len(palette.PEOPLE))


def log_people_scene(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, up: UpAxis) -> None:
    """Everything static before there is anybody."""
    _log_annotations(stream, skeleton)
    log_cameras(stream, rig, up, [palette.PLAIN] * rig.n_cameras)
    for c, name in enumerate(rig.names):
        stream.log(paths.detections(name), rr.Points2D.from_fields(radii=_DETECTION_RADIUS), static=True)
        _log_count(stream, paths.join(paths.UNUSED, name), name, palette.camera_colour(c))
    _log_count(stream, paths.N_PEOPLE, "people", palette.PLAIN)


def _log_count(stream: rr.RecordingStream, path: str, name: str, colour: palette.Colour) -> None:
    """Name and appearance of a line that shows whole numbers."""
    steps = rr.components.InterpolationMode.StepAfter
    stream.log(path, rr.SeriesLines(names=name, colors=[colour], widths=[1.5], interpolation_mode=steps), static=True)


def _log_annotations(stream: rr.RecordingStream, skeleton: Skeleton) -> None:
    """One class for each colour: however many people come, nothing is added."""
    classes = [annotation_class(0, "nobody", palette.NOBODY, skeleton)]
    bones = (*skeleton.bones, *skeleton.lines)
    first = np.arange(len(palette.PEOPLE))
    for person, number in zip(first.tolist(), detection_class(first).tolist(), strict=True):
        name, colour = f"person {person}, {person + len(first)}, ...", palette.person_colour(person)
        classes.append(annotation_class(number, name, colour, skeleton))
        classes.append(annotation_class(_body_class(person), name, colour, skeleton, bones))
    stream.log("/", rr.AnnotationContext(classes), static=True)


def log_person_styles(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, person: int) -> None:
    """How somebody looks, wherever they are shown."""
    name, colour = paths.person(person), palette.person_colour(person)
    log_body_styles(stream, rig, skeleton, name, _body_class(person), colour)
    label = rr.Points3D.from_fields(show_labels=True, colors=[colour], radii=_LABEL_RADIUS)
    stream.log(paths.label(person), label, static=True)
    log_line(stream, paths.join(paths.REPROJECTION_PX, name), f"person {person}", colour)
    looks = {Presence.SEEN: colour, Presence.PREDICTED: palette.faded(colour), Presence.AWAY: palette.AWAY}
    lanes = rr.StateConfiguration(values=[state.name.lower() for state in looks], colors=list(looks.values()))
    stream.log(paths.join(paths.TRACKS, name), lanes, static=True)
