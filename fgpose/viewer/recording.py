"""The interface through which the rest of fgpose shows people. Does not import Rerun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from fgpose.association.recording import Association
from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.observations import Observations
from fgpose.people import Detections
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer.session import Session


class Recording(Session):
    """Takes everything that can be shown of a recording; this one shows nothing.

    ``fgpose.viewer.open_recording`` gives one that does: for the results of one person, which are compared
    (log_observations to log_estimate), or for people who come and go (log_association to log_tracked); what is not of
    its kind is a ValueError. All of them are context managers. A person has one colour everywhere, whoever else is
    there.
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

    def log_association(self, association: Association) -> None:
        """Show who is who: every camera's detections in the colours of their people, grey where they are nobody's, the
        lives of the tracks, and every change in them with its reason.

        Args:
            association: of the whole recording, with the recording's skeleton and with its cameras, or some of them.

        Raises:
            ValueError: the skeleton differs, or a camera is unknown.
        """

    def log_person(self, person: int, trajectory: Trajectory, first_frame: int = 0) -> None:
        """Show somebody's motion: skeleton, uncertainty and status of the joints, number, reprojections, errors.

        What is logged of one person is joined; in frames between, and after the last, the person is not there.

        Args:
            person: their number in the association.
            trajectory: in consecutive frames of the recording.
            first_frame: number of the first of these.

        Raises:
            ValueError: a number is negative, the trajectory has no frame, the skeleton differs, or a camera of the
                residuals is unknown.
        """

    def log_tracked(
        self, frame: int, images: Sequence[Detections], people: Sequence[Tracked], events: Sequence[TrackEvent] = ()
    ) -> None:
        """Show one update of fgpose.Tracker as soon as it is made, with all that is shown of a whole recording.

        Whoever is not there any more disappears, as does the former number of somebody who is recognised. Time and
        memory do not grow with the number of updates.

        Args:
            frame: number of the update, larger than that of the one before.
            images: that the tracker was given, at most one of each camera; without any, nothing is shown. They are
                shown at their mean time. One that is given alone joins those of before: the other cameras stay as they
                were.
            people: what the tracker returned.
            events: what has happened since the update before: ``tracker.events()``.

        Raises:
            ValueError: the frame is not later, a camera is unknown or has two images, an image has another number of
                joints, or the skeleton or the cameras of an estimate differ.
        """
