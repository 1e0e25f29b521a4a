"""The interface through which the rest of fgpose shows several people. Does not import Rerun."""

from __future__ import annotations

from collections.abc import Sequence

from fgpose.association.recording import Association
from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.people import Detections
from fgpose.trajectory import Trajectory
from fgpose.viewer.session import Session


class PeopleRecording(Session):
    """Takes everything that can be shown of a recording of several people; this one shows nothing.

    ``fgpose.viewer.open_people_recording`` gives one that does. All of them are context managers. A person has one
    colour everywhere, whoever else is there.
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
