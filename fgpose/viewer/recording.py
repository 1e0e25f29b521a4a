"""The interface through which the rest of fgpose shows one person. Does not import Rerun."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fgpose.observations import Observations
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer.session import Session


class Recording(Session):
    """Takes everything that can be shown of one person's recording; this one shows nothing.

    ``fgpose.viewer.open_recording`` gives one that does. All of them are context managers.
    """

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


class NullRecording(Recording):
    """Shows nothing, so that callers need not ask whether there is a viewer."""
