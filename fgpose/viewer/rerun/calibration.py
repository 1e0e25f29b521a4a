"""The recording of a calibration in Rerun."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, up_vector
from fgpose.skeleton import Skeleton
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.recording import WALK, CalibrationRecording, CalibrationScene
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.blueprint import calibration_blueprint
from fgpose.viewer.rerun.recording import RerunRecording
from fgpose.viewer.rerun.rows import SIGMAS_90, Rows, scalar_rows
from fgpose.viewer.rerun.scene import TEXT_LOOK, frustum_m, log_camera_names, log_cameras, log_line, pose_and_pinhole
from fgpose.viewer.rerun.session import Target

_LINE = rr.Radius.ui_points(1.2)
_VERTICAL_M = 1.0
_COVERED, _COVERED_ORDER = rr.Radius.ui_points(1.0), 5.0  # below detections
# A convex hull needs three points that are not on a line; a step to the side makes them.
_MIN_WIDTH_M = 0.05


def log_calibration_scene(
    stream: rr.RecordingStream,
    rig: CameraRig,
    scene: CalibrationScene,
    up: UpAxis,
    around_m: Float[np.ndarray, " 3"] | None,
) -> None:
    """Static: the cameras, their covariances and former poses, the way of the hips and the floor under it, the
    vertical, the report; around_m as of viewing_target_m."""
    log_cameras(stream, rig, up, [palette.camera_colour(c) for c in range(rig.n_cameras)], around_m)
    _log_sigmas(stream, rig, scene.position_sigma_m)
    if scene.before is not None:
        _log_before(stream, scene.before, rig, frustum_m(rig, around_m))
    _log_coverage(stream, rig, scene)
    strips = _strips(scene.path_m)
    stream.log(paths.WALKED, rr.LineStrips3D(strips, radii=_LINE, colors=palette.PATH), static=True)
    outline_m = walked_outline_m(scene.path_m, up)
    if len(outline_m):
        closed = rr.LineStrips3D([np.vstack([outline_m, outline_m[:1]])], radii=_LINE, colors=palette.FLOOR)
        stream.log(paths.FLOOR, closed, static=True)
    vertical = rr.Arrows3D(
        origins=[np.zeros(3)], vectors=[_VERTICAL_M * up_vector(up)], labels=["up, 1 m"], colors=palette.TEXT
    )
    stream.log(paths.VERTICAL, vertical, static=True)
    stream.log(paths.REPORT, rr.TextDocument(scene.report, media_type=rr.MediaType.MARKDOWN), static=True)
    for camera in rig.names:
        for o, other in enumerate(rig.names):
            if other != camera:
                log_line(stream, paths.join(paths.EPIPOLAR_PX, camera, other), other, palette.camera_colour(o))


def _log_sigmas(stream: rr.RecordingStream, rig: CameraRig, position_sigma_m: Float[np.ndarray, " camera"]) -> None:
    """A ball around every camera that holds its place with a probability of 90 %."""
    known = np.flatnonzero(np.isfinite(position_sigma_m)).tolist()
    if not known:
        return
    # The sigma is the root of the sum over three axes.
    radii_m = SIGMAS_90 * position_sigma_m[known] / np.sqrt(3)
    balls = rr.Ellipsoids3D(
        centers=[rig.cameras[c].position_m for c in known],
        half_sizes=np.repeat(radii_m[:, None], 3, axis=1),
        colors=[[*palette.camera_colour(c), 140] for c in known],
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
    )
    stream.log(paths.CAMERA_SIGMAS, balls, static=True)
    texts = [
        f"{name} ± {np.format_float_positional(1000 * sigma_m, 2, fractional=False, trim='-')} mm"
        if np.isfinite(sigma_m)
        else name
        for name, sigma_m in zip(rig.names, position_sigma_m.tolist(), strict=True)
    ]
    log_camera_names(stream, rig, texts)


def _log_coverage(stream: rr.RecordingStream, rig: CameraRig, scene: CalibrationScene) -> None:
    """All that was seen of a board, under what is seen of it now, in the frame of the image."""
    for camera in rig.cameras:
        if camera.name in scene.covered_px:
            path = paths.coverage(camera.name)
            look = {"radii": _COVERED, "draw_order": _COVERED_ORDER}
            stream.log(path, rr.Points2D(scene.covered_px[camera.name], colors=palette.PATH, **look), static=True)
            frame = rr.Boxes2D(mins=[(-0.5, -0.5)], sizes=[camera.size_px], colors=palette.FLOOR, **look)
            stream.log(f"{path}/frame", frame, static=True)


def _log_before(stream: rr.RecordingStream, before: CameraRig, rig: CameraRig, reach_m: float) -> None:
    """The cameras that have moved, as they were, each with an arrow to where it is now."""
    pairs = zip(before.cameras, rig.cameras, strict=True)
    moved = [(old, new) for old, new in pairs if not np.allclose(old.world_T_camera, new.world_T_camera, atol=1e-9)]
    for old, _ in moved:
        entity = paths.join(paths.CAMERAS_BEFORE, old.name)
        stream.log(entity, *pose_and_pinhole(old, palette.BEFORE, reach_m), static=True)
    if moved:
        # Of points before the cameras: a camera that was only turned stays in its place.
        ends = [[camera.position_m + reach_m * camera.world_T_camera[:3, 2] for camera in pair] for pair in moved]
        arrows = rr.Arrows3D(
            origins=[start for start, _ in ends],
            vectors=[end - start for start, end in ends],
            colors=palette.BEFORE,
        )
        stream.log(paths.CAMERA_MOVES, arrows, static=True)
        names = rr.Points3D(
            [start for start, _ in ends], labels=[f"{old.name}, before" for old, _ in moved], **TEXT_LOOK
        )
        stream.log(paths.join(paths.CAMERA_MOVES, "names"), names, static=True)


def _middle_m(path_m: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, " 3"] | None:
    """Where the walker mostly was; None: never known."""
    known_m = path_m[np.isfinite(path_m).all(axis=1)]
    return np.median(known_m, axis=0) if len(known_m) else None


def _strips(path_m: Float[np.ndarray, "frame 3"]) -> list[np.ndarray]:
    """The parts of the way between frames in which it is not known."""
    known = np.asarray(np.isfinite(path_m).all(axis=1))
    parts = np.split(np.arange(len(path_m)), np.flatnonzero(np.diff(known)) + 1)
    return [path_m[part] for part in parts if len(part) > 1 and known[part[0]]]


def walked_outline_m(path_m: Float[np.ndarray, "frame 3"], up: UpAxis) -> Float[np.ndarray, "corner 3"]:
    """The convex hull of the way, on the floor (height zero); empty for a way along one line."""
    from scipy.spatial import ConvexHull

    vertical = up_vector(up)
    known = path_m[np.isfinite(path_m).all(axis=1)]
    on_floor_m = known - (known @ vertical)[:, None] * vertical
    across = [axis for axis in range(3) if not vertical[axis]]
    flat_m = on_floor_m[:, across]
    if len(flat_m) < 3 or np.linalg.svd(flat_m - flat_m.mean(axis=0))[1][-1] / np.sqrt(len(flat_m)) < _MIN_WIDTH_M:
        return np.zeros((0, 3))
    return on_floor_m[ConvexHull(flat_m).vertices]


def epipolar_rows(rig: CameraRig, epipolar_px: Float[np.ndarray, "frame camera other"]) -> Iterator[Rows]:
    """For each camera a plot with a line for each other one."""
    for c, camera in enumerate(rig.names):
        for o, other in enumerate(rig.names):
            if o != c:
                yield scalar_rows(paths.join(paths.EPIPOLAR_PX, camera, other), epipolar_px[:, c, o])


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
        # Cameras side by side do not tell how far away they look: a board may be at arm's length.
        around_m = _middle_m(scene.path_m)
        log_calibration_scene(self._open_stream, self._rig, scene, self._up, around_m)
        self._open_stream.send_blueprint(calibration_blueprint(self._rig, self._up, around_m))
        self._send(epipolar_rows(self._rig, scene.epipolar_px), scene.time_s)
