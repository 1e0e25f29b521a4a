"""The recording of a live system in Rerun."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import ClassVar

import numpy as np
import rerun as rr
from jaxtyping import Float, UInt8

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.skeleton import Skeleton
from fgpose.viewer.pictures import CameraPictures, PictureOptions
from fgpose.viewer.recording import CameraSaid, SystemPicture, SystemRecording, SystemState
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.blueprint import people_blueprint
from fgpose.viewer.rerun.people import absent_rows, picture_rows
from fgpose.viewer.rerun.recording import RerunRecording
from fgpose.viewer.rerun.rows import Rows, TimeKind, change_rows, log_rows, scalar_rows
from fgpose.viewer.rerun.scene import log_line
from fgpose.viewer.rerun.session import Target

_UNKNOWN = CameraSaid("")
# A camera without a new picture for longer shows its points without one.
_PICTURE_LASTS_S = 3.0
_N_MOMENTS = 200


class RerunSystemRecording(RerunRecording, SystemRecording):
    """See SystemRecording and open_system_recording."""

    time_kind: ClassVar[TimeKind] = "timestamp"

    def __init__(
        self, target: Target, rig: CameraRig, skeleton: Skeleton, up: UpAxis, pictures: PictureOptions
    ) -> None:
        layout = people_blueprint(rig, up, following=target.port is not None, of_system=True)
        super().__init__(target, (rig, skeleton, ()), up, pictures, layout)
        self._options = pictures
        self._said: dict[str, CameraSaid] = {}
        self._n_moments = 0
        self._moments: deque[tuple[int, float]] = deque(maxlen=_N_MOMENTS)
        """Frame and time of the last ones: a picture comes after its moment."""
        self._pictured_s: dict[str, float] = {}
        """When the last picture came, of the cameras in whose images there is one."""
        self._pictured: dict[str, set[int]] = {}
        """Who is in it."""
        lanes = rr.StateConfiguration(values=list(palette.CAMERA_STATES), colors=list(palette.CAMERA_STATES.values()))
        for name in rig.names:
            self._open_stream.log(paths.join(paths.CAMERA_STATES, name), lanes, static=True)
        log_line(self._open_stream, paths.DELAY_MS, "delay", palette.PLAIN)
        log_line(self._open_stream, paths.OBSERVED, "observed", palette.PLAIN)

    def log_moment(self, moment: SystemState) -> None:
        self._rig.subset(moment.cameras)
        self._check_images(self._n_moments, moment.images)
        frame, self._n_moments = self._n_moments, self._n_moments + 1
        # Reasons may count seconds.
        changed = {
            name: said for name, said in moment.cameras.items() if said.state != self._said.get(name, _UNKNOWN).state
        }
        self._moments.append((frame, moment.time_s))
        pictured_s = self._pictured_s | dict.fromkeys(moment.pictures, moment.time_s)
        silent = [name for name, said in changed.items() if said.is_silent and not self._is_silent(name)]
        self._pictured_s = {
            name: last_s
            for name, last_s in pictured_s.items()
            if moment.time_s < last_s + _PICTURE_LASTS_S
            and not moment.cameras.get(name, self._said.get(name, _UNKNOWN)).is_silent
        }
        images = [image for image in moment.images if image.camera not in silent]
        self._show_update(frame, moment.time_s, images, moment.people, moment.events, silent)
        self._send(_system_rows(moment, changed, self._said), np.array([moment.time_s]), frame)
        self._end_pictures(frame, moment)
        for name in silent:
            self.log_no_image(name, frame, moment.time_s)
        self._said |= moment.cameras
        for name, picture in moment.pictures.items():
            if not self._is_silent(name):
                self._log_picture(name, picture)

    def _log_picture(self, camera: str, picture: SystemPicture) -> None:
        """With the points in it, in the moment that is nearest to it."""
        (calibrated,) = self._rig.subset([camera]).cameras
        frame, time_s = min(self._moments, key=lambda moment: abs(moment[1] - picture.time_s))
        self.log_image(camera, frame, time_s, picture.image_rgb)
        here = {each.person for each in picture.people}
        gone = self._pictured.get(camera, set()) - here
        self._pictured[camera] = here
        super()._send(picture_rows(picture.detections, picture.people, calibrated, gone), np.array([time_s]), frame)

    def _end_pictures(self, frame: int, moment: SystemState) -> None:
        """Of cameras from which none has come for long: it is taken away, and the points move on."""
        here = {each.person for each in moment.people}
        for name in self._pictured.keys() - self._pictured_s.keys():
            rows = absent_rows(self._pictured.pop(name) - here, name)
            self._send(rows, np.array([moment.time_s]), frame)
            self.log_no_image(name, frame, moment.time_s)

    def _send(
        self, rows: Iterable[Rows], time_s: Float[np.ndarray, " frame"], first_frame: int = 0, step: int = 1
    ) -> None:
        super()._send((each for each in rows if not self._is_of_picture(each)), time_s, first_frame, step)

    def _is_of_picture(self, rows: Rows) -> bool:
        """Points that would move on while a picture stays. Who has gone is taken out of all images at once."""
        for name in self._pictured_s:
            if rows.path == paths.detections(name):
                return True
            if rows.path.startswith(paths.reprojections(name, "")):
                return bool(rows.lengths.any())
        return False

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        size_px = image.shape[1], image.shape[0]
        if self._pictures_of(camera).size_px != size_px:
            (calibrated,) = self._rig.subset([camera]).cameras
            self._pictures[camera] = CameraPictures(calibrated, self._options, self._rig.n_cameras, size_px)
            self._shown.discard(camera)
        super().log_image(camera, frame, time_s, image)

    def _is_silent(self, camera: str) -> bool:
        return self._said.get(camera, _UNKNOWN).is_silent


def _system_rows(
    moment: SystemState, changed: Mapping[str, CameraSaid], before: Mapping[str, CameraSaid]
) -> Iterator[Rows]:
    """States of cameras that have changed, and plots."""
    for name, said in changed.items():
        state = before.get(name, _UNKNOWN).state
        yield change_rows(paths.join(paths.CAMERA_STATES, name), np.array([said.state]), state)
    news = {name: said for name, said in changed.items() if name in before or said.state != "ok"}
    texts = [f"camera {name} {said.state}{': ' if said.reason else ''}{said.reason}" for name, said in news.items()]
    levels = [said.state for said in news.values()]
    colours = [palette.CAMERA_STATES.get(level, palette.PLAIN) for level in levels]
    yield log_rows(paths.CAMERA_EVENTS, texts, levels, colours, np.zeros(len(texts), dtype=int))
    if moment.note:
        yield log_rows(paths.RECORDING_EVENTS, [moment.note], ["WARN"], [palette.PLAIN], np.zeros(1, dtype=int))
    if moment.found:
        n = len(moment.found)
        yield log_rows(
            paths.DIAGNOSIS_EVENTS, list(moment.found), n * ["WARN"], n * [palette.PLAIN], np.zeros(n, dtype=int)
        )
    if moment.delay_s is not None:
        yield scalar_rows(paths.DELAY_MS, np.array([1e3 * moment.delay_s]))
    if moment.observed_share is not None:
        yield scalar_rows(paths.OBSERVED, np.array([100 * moment.observed_share]))
