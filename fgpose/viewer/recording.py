"""The interface through which the rest of fgpose shows recordings, calibrations, live systems; without Rerun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import TypeVar

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.association.recording import Association
from fgpose.association.track import Tracked, TrackEvent
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Trajectory

# typing.Self is refused by the checks of the tests.
_Opened = TypeVar("_Opened", bound="Session")
WALK = "walk"
"""The name of the walker's trajectory in the recording."""


class Session:
    """An open recording; this one shows nothing."""

    viewer_url: str | None = None
    """Where a viewer connects (``rerun URL``) while a live recording is open."""

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

    def log_no_image(self, camera: str, frame: int, time_s: float) -> None:
        """Show no picture of a camera from a frame on: the last one would stay under the points of all later frames.
        Arguments as of log_image."""

    def flush(self) -> None:
        """Bring what was logged into the file. Raises OSError if that is not possible."""

    def close(self) -> None:
        """Write the rest and give the file its name. Closing again does nothing.

        Raises:
            OSError: the file could not be written to its end. None is left; of an endless recording, what could be
                written, as NAME_incomplete.rrd.
        """

    def discard(self) -> None:
        """Close without leaving a file; an older one of the same name stays as it was."""

    def __enter__(self: _Opened) -> _Opened:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        # Ctrl-C is how a live session ends: its file is kept.
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        else:
            self.discard()


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
        every: int = 1,
    ) -> None:
        """Show a recording's detections in every camera, the views' own 3D poses and the weight of each view.

        Args:
            observations: the recording; its skeleton and cameras are those the recording was opened with.
            weights: of every detection, in any unit (those of eq. 2, say); 0 or NaN where there is none. Colours
                are relative to the best view of the same joint and frame. Without them: the detector's confidence.
            undistorted_px: the same detections in the undistorted images, if they are known already.
            every: all these have one frame in so many, from the first on.

        Raises:
            ValueError: the skeleton, the cameras or the shape of the weights differ, or frames that are shown are
                missing.
        """

    def log_trajectory(self, name: str, trajectory: Trajectory, every: int = 1) -> None:
        """Show a result: skeleton, uncertainty and status of its joints, reprojections, bone lengths, errors.

        Args:
            name: one of the names that the recording was opened with.
            trajectory: the recording.
            every: it has one frame in so many, from the first on.

        Raises:
            ValueError: the name is unknown, the skeleton or the cameras differ, or it lacks frames that are shown.
        """

    def log_residuals(
        self,
        time_s: Float[np.ndarray, " frame"],
        residuals: Mapping[str, Float[np.ndarray, "frame joint"]],
        every: int = 1,
    ) -> None:
        """Show how strongly each factor pulls at a joint: the norm of its whitened residual, in sigmas.

        Args:
            time_s: time of each frame.
            residuals: by factor ("projection/cam_01", "motion", ...); NaN where the joint has no such factor.
            every: both have one frame in so many, from the first on.

        Raises:
            ValueError: a shape differs, or frames that are shown are missing.
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


@dataclass(frozen=True, eq=False)
class CalibrationScene:
    """What is shown of a calibration besides the cameras, the detections and the walker."""

    time_s: Float[np.ndarray, " frame"]
    position_sigma_m: Float[np.ndarray, " camera"]
    """Of the place of each camera, root of the sum over the axes; NaN: not known."""
    path_m: Float[np.ndarray, "frame 3"]
    """Where the walker's hips were, world frame; NaN: not known."""
    epipolar_px: Float[np.ndarray, "frame camera other"]
    """How far the joints in each camera are from the epipolar lines of each other one; NaN: not seen by both."""
    report: str
    """Markdown: the verdict, and a table of the cameras."""
    before: CameraRig | None = None
    """The same cameras as they were before; those that have moved since are shown there too."""
    covered_px: Mapping[str, Float[np.ndarray, "point 2"]] = field(default_factory=dict)
    """By camera: where in its image, undistorted, a board was seen."""


class CalibrationRecording(Recording):
    """A recording of one person who walked through the scene, and of how well the cameras are calibrated by it."""

    def log_calibration(self, scene: CalibrationScene) -> None:
        """Show the covariances of the cameras, the way of the hips, what of the floor was covered, how well every pair
        of cameras agrees in each frame, and the verdict.

        Raises:
            ValueError: a shape differs from the number of frames or of cameras, or the cameras before are others.
        """


@dataclass(frozen=True)
class CameraSaid:
    """What is said of a camera."""

    state: str
    """A key of palette.CAMERA_STATES, or another word."""
    reason: str = ""
    is_silent: bool = False
    """No images come from it: what it showed last is taken away."""


@dataclass(frozen=True, eq=False)
class SystemPicture:
    """A picture of a camera, with who was in it."""

    image_rgb: np.ndarray
    """(H, W, 3) uint8, perhaps scaled down."""
    time_s: float
    """When it was taken, Unix time; it is not newer than the moment with which it comes."""
    people: Sequence[Tracked]
    """At that time."""
    detections: Detections | None = None
    """What was found in it; None: it was not used."""


@dataclass(frozen=True, eq=False)
class SystemState:
    """What a live system says at one time."""

    time_s: float
    """Unix time at which the people are there."""
    people: Sequence[Tracked]
    images: Sequence[Detections] = ()
    """That are new; at most one of each camera. Cameras without one stay as they were."""
    pictures: Mapping[str, SystemPicture] = field(default_factory=dict)
    """That are new, by the camera. As long as a camera has pictures, the points in its image are those of its last
    one."""
    events: Sequence[TrackEvent] = ()
    """Since the moment before."""
    cameras: Mapping[str, CameraSaid] = field(default_factory=dict)
    """By name; of those that are not here nothing is known."""
    delay_s: float | None = None
    """From the newest image to its frame; None: there was no new image."""
    observed_share: float | None = None
    """Of the volume."""
    note: str = ""
    """Of the recording itself; empty: there is none."""
    found: Sequence[str] = ()
    """What a diagnosis has found since the moment before, or finds no longer."""


class SystemRecording(Recording):
    """Takes what a live system says, moment by moment; this one shows nothing.

    ``fgpose.viewer.open_system_recording`` gives one that does. Its memory does not grow with time.
    """

    def log_moment(self, moment: SystemState) -> None:
        """Show people, detections, pictures, the states of the cameras and the delay.

        Raises:
            ValueError: a camera is unknown or has two images, an image has another number of joints, or the skeleton or
                the cameras of an estimate differ.
            OSError: the disk is full, or so slow that memory would fill.
        """
