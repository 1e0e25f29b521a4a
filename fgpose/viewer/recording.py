"""The interface through which the rest of fgpose shows its data. Does not import Rerun."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.observations import Observations
from fgpose.trajectory import Estimate, Trajectory

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class Recording:
    """Takes everything that can be shown of one person's recording; this one shows nothing.

    ``fgpose.viewer.open_recording`` gives one that does. All of them are context managers.
    """

    viewer_url: str | None = None
    """Where a viewer connects (``rerun URL``) while a live recording is open."""

    def log_observations(
        self,
        observations: Observations,
        weights: Float[np.ndarray, "frame camera joint"] | None = None,
        undistorted_px: Float[np.ndarray, "frame camera joint 2"] | None = None,
    ) -> None:
        """Show a recording's detections in every camera, the views' own 3D poses and the weight of each view.

        Args:
            observations: the whole recording; its skeleton and cameras are those the recording was opened with.
            weights: of every detection, in any unit (those of eq. 2, say); 0 or NaN where there is none. Colours
                are relative to the best view of the same joint and frame. Without them: the detector's confidence.
            undistorted_px: the same detections in the undistorted images, if they are known already.

        Raises:
            ValueError: the skeleton, the cameras or the shape of the weights differ.
        """

    def log_trajectory(self, name: str, trajectory: Trajectory) -> None:
        """Show a result: skeleton, uncertainty and status of its joints, reprojections, bone lengths, errors.

        Args:
            name: one of the names that the recording was opened with.
            trajectory: the whole recording.

        Raises:
            ValueError: the name is unknown, or the skeleton or the cameras differ.
        """

    def log_residuals(
        self, time_s: Float[np.ndarray, " frame"], residuals: Mapping[str, Float[np.ndarray, "frame joint"]]
    ) -> None:
        """Show how strongly each factor pulls at a joint: the norm of its whitened residual, in sigmas.

        Args:
            time_s: time of each frame.
            residuals: by factor ("projection/cam_01", "motion", ...); NaN where the joint has no such factor.

        Raises:
            ValueError: a shape differs.
        """

    def log_update_times(self, time_s: Float[np.ndarray, " frame"], update_ms: Float[np.ndarray, " frame"]) -> None:
        """Show how long the estimator took for each frame, milliseconds."""

    def wants_image(self, camera: str, frame: int) -> bool:
        """Whether log_image would show the picture of a frame: ask before reading or converting one.

        Raises:
            ValueError: the camera is unknown.
        """
        return False

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        """Show one camera's picture, undistorted as its points are, shrunk and compressed; see open_recording.

        A picture beyond the limit of the recording is left out. The limit is divided among the cameras.

        Args:
            camera: its name in the rig.
            frame: number of the frame, counted from 0.
            time_s: its time.
            image: RGB, as the camera took it.

        Raises:
            ValueError: the camera is unknown, or the size of the picture differs from that of the calibration.
            OSError: the disk is full, or so slow that pictures would pile up in memory.
        """

    def log_estimate(
        self,
        estimate: Estimate,
        observations: Observations | None = None,
        weights: Float[np.ndarray, "camera joint"] | None = None,
        *,
        update_ms: float | None = None,
        residuals: Mapping[str, Float[np.ndarray, " joint"]] | None = None,
    ) -> None:
        """Show one frame as soon as it is estimated, under the same names as a whole recording.

        The estimate goes by the name "online", its lagged part (where there is one) by "smoothed".

        Args:
            estimate: what the online estimator gave.
            observations: what it was given: one frame.
            weights: as in log_observations.
            update_ms: how long the estimator took.
            residuals: as in log_residuals.

        Raises:
            ValueError: as the methods for whole recordings.
        """

    def close(self) -> None:
        """Write the rest and give the file its name. Closing again does nothing.

        Raises:
            OSError: the file could not be written to its end; none is left.
        """

    def discard(self) -> None:
        """Close without leaving a file; an older one of the same name stays as it was."""

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        # Ctrl-C is how a live session ends: its file is kept.
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        else:
            self.discard()


class NullRecording(Recording):
    """Shows nothing, so that callers need not ask whether there is a viewer."""
