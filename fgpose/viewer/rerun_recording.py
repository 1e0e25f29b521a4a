"""A recording in Rerun: to a .rrd file, to live viewers, or both."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float, UInt8

from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import replacing
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer import palette, paths
from fgpose.viewer.blueprint import blueprint
from fgpose.viewer.content import observation_rows, residual_rows, trajectory_rows
from fgpose.viewer.pictures import CameraPictures, PictureOptions
from fgpose.viewer.recording import Recording, UpAxis
from fgpose.viewer.rows import Rows, scalar_rows
from fgpose.viewer.scene import log_picture_style, log_residual_styles, log_scene

_HOST = "127.0.0.1"
_MAX_PORT = 65535  # of TCP
# Memory for data other than pictures that is kept for viewers who connect late; the oldest frames are dropped first.
_SERVER_MB = 256.0
# This many bytes of pictures may wait for a slow disk; beyond that, logging waits, so that memory does not fill.
_UNFLUSHED_BYTES = 8e6
_FLUSH_TIMEOUT_S = 10.0  # a disk that takes longer counts as failed
# A viewer that hangs blocks the server for 25 s, until it is dropped.
_LIVE_FLUSH_TIMEOUT_S = 60.0
# Magic bytes of a file, and of its footer with a checksum behind them (Rerun 0.41).
_FILE_START, _FILE_END, _FILE_END_BYTES = b"RRF2", b"RRF2FOOT", 12
_JPEG = "image/jpeg"
_EARLIER_THICKNESS = 0.5  # of all results but the last, which shall stand out


class RerunRecording(Recording):
    """See Recording and open_recording."""

    def __init__(
        self,
        path: Path | None,
        scene: tuple[CameraRig, Skeleton, tuple[str, ...]],
        *,
        port: int | None,
        endless: bool,
        up: UpAxis,
        pictures: PictureOptions,
    ) -> None:
        self._path = path
        self._rig, self._skeleton, self._trajectories = scene
        self._last_status: dict[str, np.ndarray] = {}
        self._factors: tuple[str, ...] = ()
        cameras = self._rig.cameras
        self._pictures = {camera.name: CameraPictures(camera, pictures, len(cameras)) for camera in cameras}
        self._shown: set[str] = set()
        self._unflushed_bytes = 0
        self._flush_timeout_s = _FLUSH_TIMEOUT_S if port is None else _LIVE_FLUSH_TIMEOUT_S
        self._file = ExitStack()
        self._stream: rr.RecordingStream | None = rr.RecordingStream("fgpose")
        # Exactly two timelines: frame and time.
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        layout = blueprint(self._rig, self._skeleton, self._trajectories, up, following=port is not None)
        server_mb = _SERVER_MB + (pictures.image_limit_mb or 0.0)
        try:
            self._stream.set_sinks(*self._sinks(path, port, endless, server_mb), default_blueprint=layout)
        except RuntimeError as error:
            self.discard()
            raise self._unwritable(error) from None
        if path is not None:
            self._stream.send_recording_name(path.stem)
        log_scene(self._stream, self._rig, self._skeleton, self._trajectories, up)

    def _sinks(
        self, path: Path | None, port: int | None, endless: bool, server_mb: float
    ) -> Iterable[rr.FileSink | rr.GrpcServerSink]:
        sinks = []
        if port is not None:
            server = rr.GrpcServerSink(_HOST, _free_port(port), server_memory_limit=f"{server_mb:.0f}MB")
            self.viewer_url = server.uri
            sinks.append(server)
        if path is not None:
            temporary = self._file.enter_context(replacing(path, partial(_check_whole, with_footer=not endless)))
            sinks.append(rr.FileSink(temporary, write_footer=not endless))
        return sinks

    def log_observations(
        self,
        observations: Observations,
        weights: Float[np.ndarray, "frame camera joint"] | None = None,
        undistorted_px: Float[np.ndarray, "frame camera joint 2"] | None = None,
    ) -> None:
        self._check_observations(observations, weights)
        self._send(observation_rows(observations, self._rig, weights, undistorted_px), observations.frame_time_s)

    def log_trajectory(self, name: str, trajectory: Trajectory) -> None:
        self._check_trajectory(name, trajectory)
        self._send(trajectory_rows(name, trajectory, self._rig, *self._look(name)), trajectory.time_s)

    def log_residuals(
        self, time_s: Float[np.ndarray, " frame"], residuals: Mapping[str, Float[np.ndarray, "frame joint"]]
    ) -> None:
        self._check_residuals(len(time_s), residuals)
        if residuals:
            self._name_factors(tuple(residuals))
            self._send(residual_rows(self._skeleton, residuals), time_s)

    def log_update_times(self, time_s: Float[np.ndarray, " frame"], update_ms: Float[np.ndarray, " frame"]) -> None:
        self._send([scalar_rows(paths.UPDATE_MS, update_ms)], time_s)

    def wants_image(self, camera: str, frame: int) -> bool:
        return self._pictures_of(camera).wants(frame)

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        pictures = self._pictures_of(camera)
        pictures.check(frame, image)
        if not pictures.wants(frame):
            return
        if camera not in self._shown:
            log_picture_style(self._open_stream, camera, pictures.shrink)
            self._shown.add(camera)
        jpeg = pictures.jpeg(image)
        # Otherwise the last picture would stay under the points of all later frames.
        picture = rr.Clear(recursive=False) if pictures.full else rr.EncodedImage(contents=jpeg, media_type=_JPEG)
        self._set_time(frame, time_s)
        self._open_stream.log(paths.picture(camera), picture)
        self._unflushed_bytes += len(jpeg)
        if self._unflushed_bytes > _UNFLUSHED_BYTES:
            self._flush(self._open_stream)

    def log_estimate(
        self,
        estimate: Estimate,
        observations: Observations | None = None,
        weights: Float[np.ndarray, "camera joint"] | None = None,
        *,
        update_ms: float | None = None,
        residuals: Mapping[str, Float[np.ndarray, " joint"]] | None = None,
    ) -> None:
        self._set_time(estimate.frame, estimate.time_s)
        if observations is not None:
            of_frame = None if weights is None else weights[None]
            self._check_observations(observations, of_frame)
            self._log(observation_rows(observations, self._rig, of_frame))
        if update_ms is not None:
            self._log([scalar_rows(paths.UPDATE_MS, np.array([update_ms]))])
        if residuals:
            by_factor = {factor: np.asarray(values)[None] for factor, values in residuals.items()}
            self._check_residuals(1, by_factor)
            self._name_factors(tuple(residuals))
            self._log(residual_rows(self._skeleton, by_factor))
        self._log_frame("online", estimate)
        if estimate.smoothed is not None and "smoothed" in self._trajectories:
            self._set_time(estimate.smoothed.frame, estimate.smoothed.time_s)
            self._log_frame("smoothed", estimate.smoothed)

    def _log_frame(self, name: str, estimate: Estimate) -> None:
        trajectory = _one_frame(estimate, self._rig)
        self._check_trajectory(name, trajectory)
        before = self._last_status.get(name)
        self._log(trajectory_rows(name, trajectory, self._rig, *self._look(name), before))
        self._last_status[name] = trajectory.status[0]

    def close(self) -> None:
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        with self._file:
            try:
                self._flush(stream)
            finally:
                stream.disconnect()
        self.viewer_url = None

    def discard(self) -> None:
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        stream.disconnect()
        self.viewer_url = None
        # An exception makes replacing delete its temporary file.
        discarded = RuntimeError("discarded")
        try:
            self._file.__exit__(RuntimeError, discarded, None)
        except RuntimeError as error:
            if error is not discarded:
                raise

    @property
    def _open_stream(self) -> rr.RecordingStream:
        if self._stream is None:
            raise ValueError("the recording is closed")
        return self._stream

    def _flush(self, stream: rr.RecordingStream) -> None:
        try:
            stream.flush(timeout_sec=self._flush_timeout_s)
        except RuntimeError as error:
            raise self._unwritable(error) from None
        self._unflushed_bytes = 0

    def _unwritable(self, error: RuntimeError) -> OSError:
        return OSError(f"cannot write {self._path or self.viewer_url}: {error}; is the disk full?")

    def _send(self, rows: Iterable[Rows], time_s: Float[np.ndarray, " frame"]) -> None:
        frame = np.arange(len(time_s))
        for of_entity in rows:
            of_entity.send(self._open_stream, frame, time_s)

    def _log(self, rows: Iterable[Rows]) -> None:
        for of_entity in rows:
            of_entity.log(self._open_stream)

    def _set_time(self, frame: int, time_s: float) -> None:
        self._open_stream.set_time("frame", sequence=frame)
        self._open_stream.set_time("time", duration=time_s)

    def _look(self, name: str) -> tuple[palette.Colour, float]:
        """Colour and thickness of a result; the last one stands out."""
        index = self._trajectories.index(name)
        return palette.trajectory_colour(name, index), 1.0 if name == self._trajectories[-1] else _EARLIER_THICKNESS

    def _name_factors(self, factors: tuple[str, ...]) -> None:
        if factors != self._factors:
            log_residual_styles(self._open_stream, self._rig, self._skeleton, factors)
            self._factors = factors

    def _pictures_of(self, camera: str) -> CameraPictures:
        (known,) = self._rig.subset([camera]).names
        return self._pictures[known]

    def _check_skeleton(self, what: str, skeleton: Skeleton) -> None:
        if skeleton.joints != self._skeleton.joints:
            raise ValueError(
                f"{what} has the joints of skeleton {skeleton.name}, "
                f"the recording was opened with {self._skeleton.name}"
            )

    def _check_observations(self, observations: Observations, weights: np.ndarray | None) -> None:
        self._check_skeleton("the observations", observations.skeleton)
        observations.check_cameras(self._rig.names)
        if weights is not None and weights.shape != observations.seen.shape:
            raise ValueError(f"weights must be {observations.seen.shape} as the points are, got {weights.shape}")

    def _check_trajectory(self, name: str, trajectory: Trajectory) -> None:
        if name not in self._trajectories:
            raise ValueError(f"the recording was opened for {', '.join(self._trajectories)}, not for {name!r}")
        self._check_skeleton(f"trajectory {name}", trajectory.skeleton)
        if trajectory.residual_px is not None and trajectory.residual_px.shape[1] != self._rig.n_cameras:
            raise ValueError(
                f"trajectory {name} has residuals in {trajectory.residual_px.shape[1]} cameras, "
                f"the recording has {self._rig.n_cameras}"
            )

    def _check_residuals(self, n_frames: int, residuals: Mapping[str, np.ndarray]) -> None:
        expected = (n_frames, self._skeleton.n_joints)
        for factor, values in residuals.items():
            if values.shape != expected:
                raise ValueError(f"residuals of {factor} must be {expected} (frames, joints), got {values.shape}")


def _check_whole(path: Path, with_footer: bool) -> None:
    """The footer is written when the recording is closed, and Rerun says nothing if that fails."""
    with path.open("rb") as file:
        start = file.read(len(_FILE_START))
        file.seek(-min(_FILE_END_BYTES, path.stat().st_size), os.SEEK_END)
        end = file.read()
    if start != _FILE_START or (with_footer and not end.startswith(_FILE_END)):
        raise ValueError("its beginning or its footer is missing")


def _one_frame(estimate: Estimate, rig: CameraRig) -> Trajectory:
    return Trajectory(
        skeleton=estimate.skeleton,
        time_s=np.array([estimate.time_s]),
        positions_m=estimate.positions_m[None],
        status=np.asarray(estimate.status)[None],
        covariance_m2=None if estimate.covariance_m2 is None else estimate.covariance_m2[None],
        residual_px=None if estimate.residual_px is None else estimate.residual_px[None],
        visibility=None if estimate.visibility is None else estimate.visibility[None],
        camera_names=rig.names,
    )


def _free_port(port: int) -> int:
    """The port, or a free one for 0. Rerun itself notices a taken port only after the first data."""
    if not 0 <= port <= _MAX_PORT:
        raise ValueError(f"a port is a number from 0 to {_MAX_PORT}, got {port}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise OSError(f"cannot serve viewers on {_HOST}:{port}: {error.strerror}; choose another port") from None
        return probe.getsockname()[1]
