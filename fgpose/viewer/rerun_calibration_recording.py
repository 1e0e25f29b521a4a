"""The recording of a calibration in Rerun."""

from __future__ import annotations

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.viewer.calibration_blueprint import calibration_blueprint
from fgpose.viewer.calibration_content import epipolar_rows, log_calibration_scene
from fgpose.viewer.calibration_recording import WALK, CalibrationRecording, CalibrationScene
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.rerun_recording import RerunRecording
from fgpose.viewer.rerun_session import Target
from fgpose.viewer.session import UpAxis


class RerunCalibrationRecording(RerunRecording, CalibrationRecording):
    """See CalibrationRecording and open_calibration_recording."""

    def __init__(
        self, target: Target, rig: CameraRig, skeleton: Skeleton, up: UpAxis, pictures: PictureOptions
    ) -> None:
        super().__init__(target, (rig, skeleton, (WALK,)), up, pictures, calibration_blueprint(rig, up))

    def log_calibration(self, scene: CalibrationScene) -> None:
        n_frames, n_cameras = len(scene.time_s), self._rig.n_cameras
        shapes = {
            "position_sigma_m": (n_cameras,),
            "path_m": (n_frames, 3),
            "epipolar_px": (n_frames, n_cameras, n_cameras),
        }
        for name, shape in shapes.items():
            if getattr(scene, name).shape != shape:
                raise ValueError(f"{name} must be {shape}, got {getattr(scene, name).shape}")
        if scene.before is not None and scene.before.names != self._rig.names:
            raise ValueError(
                f"the cameras before are {', '.join(scene.before.names)}, not {', '.join(self._rig.names)}"
            )
        log_calibration_scene(self._open_stream, self._rig, scene, self._up)
        self._send(epipolar_rows(self._rig, scene.epipolar_px), scene.time_s)
