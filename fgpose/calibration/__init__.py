"""The cameras: where they stand, what their lenses are, and what their clocks say, from recordings of people.

- From nothing but people who walk: calibrate_from_people, with guessed_intrinsics or fgpose.files.load_intrinsics. It
  gives CalibratedFromPeople: the rig, CameraSigmas, and a Grade with each CalibrationFinding. GivenStart is what is
  known of the start of a video, Walk what was used of the recording, Parts what of the chain can be turned off.
- With a board: find_boards in videos or images (a Board, which load_board reads from text or a file), which gives
  BoardSightings (LeftOut says what is not used), then calibrate_from_boards. It gives CalibratedFromBoards: the rig,
  BoardSigmas, and the verdict. WorldOrigin says where the world is, and level_from_walker turns it level
  from somebody who walks in it; save_board draws a board on a Sheet.
- A rig that was calibrated, on the recording itself: refine_rig (RigRefinement) for the poses, estimate_time_offsets
  (TimeOffsets) for the clocks, self_calibrate (SelfCalibration) for both at once. Ending says why one was stopped.
- A rig of which a camera was moved: refine_bumped (BumpedRig).
- Cameras that began at different moments: synchronise (Synchronised), and on_common_clock for what they recorded.
- Keypoints of images that are turned: turn_images.
- Clocks as they are learned live: RunningOffsets (Tracker.offsets), from OffsetEvidence.
"""

from fgpose.association.common_clock import on_common_clock
from fgpose.calibration.board.board import Board, load_board
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.drawing import Sheet, save_board
from fgpose.calibration.board.filmed import find_boards
from fgpose.calibration.board.sightings import BoardSightings, LeftOut
from fgpose.calibration.board.verdict.sigmas import BoardSigmas
from fgpose.calibration.board.walker import level_from_walker
from fgpose.calibration.board.world import WorldOrigin
from fgpose.calibration.bumped import BumpedRig, refine_bumped
from fgpose.calibration.from_people.calibrate import Parts, calibrate_from_people
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, CameraSigmas, Grade
from fgpose.calibration.from_people.starts.starts import GivenStart
from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.rig_refinement import RigRefinement, refine_rig
from fgpose.calibration.self_calibration import SelfCalibration, self_calibrate
from fgpose.calibration.synchronisation import Synchronised, synchronise
from fgpose.calibration.time_offsets import TimeOffsets, estimate_time_offsets
from fgpose.calibration.used_parts import Ending
from fgpose.estimation.online.clock_offsets import OffsetEvidence, RunningOffsets
from fgpose.geometry.intrinsics import guessed_intrinsics
from fgpose.geometry.turned_images import turn_images

__all__ = [
    "Board",
    "BoardSightings",
    "BoardSigmas",
    "BumpedRig",
    "CalibratedFromBoards",
    "CalibratedFromPeople",
    "CalibrationFinding",
    "CameraSigmas",
    "Ending",
    "GivenStart",
    "Grade",
    "LeftOut",
    "OffsetEvidence",
    "Parts",
    "RigRefinement",
    "RunningOffsets",
    "SelfCalibration",
    "Sheet",
    "Synchronised",
    "TimeOffsets",
    "Walk",
    "WorldOrigin",
    "calibrate_from_boards",
    "calibrate_from_people",
    "estimate_time_offsets",
    "find_boards",
    "guessed_intrinsics",
    "level_from_walker",
    "load_board",
    "on_common_clock",
    "refine_bumped",
    "refine_rig",
    "save_board",
    "self_calibrate",
    "synchronise",
    "turn_images",
]
