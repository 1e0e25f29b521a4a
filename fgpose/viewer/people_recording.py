"""The interface through which the rest of fgpose shows several people. Does not import Rerun."""

from __future__ import annotations

from fgpose.association.recording import Association
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
