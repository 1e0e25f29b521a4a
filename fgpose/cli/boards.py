"""Boards on the command line: drawing one, and calibrating cameras with it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.cli.console import new_console, new_table, print_written, progress_bar

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration.board.board import Board as BoardOfPoints
    from fgpose.calibration.board.calibrate import CalibratedFromBoards
    from fgpose.geometry.camera import CameraRig
    from fgpose.monocular.clips import Clip

_DESCRIBED = (
    "charuco:7x5:30mm:22mm:DICT_5X5_100 (squares, side, side of the markers, dictionary), chessboard:9x6:25mm (inner "
    "corners, side), circles:4x11:20mm (staggered; in a row, rows, distance of the rows), each with :inverted at its "
    "end if it is white on black, or a file that describes one (board.toml; Pose2Sim, anipose, caliscope, OpenCV)."
)
_BOARD = f"Calibrate with a board that is carried before the cameras, instead of people: {_DESCRIBED}"
_LENS = "Of --board: the model of the lenses. auto: pinhole, or fisheye where that explains the views clearly better."
_ORIGIN = (
    "Of --board: where the world is. board: the board at the first moment, or at another with board@12.5, as it lies "
    "on the floor. camera: the first camera. level: at the first camera, z up as far as the cameras stand level. "
    "people: under the first camera, level from whoever walks in the images, with the board or without it."
)
_LENSES_ONLY = (
    "Of --board: the lens of each camera by itself, for --intrinsics of a calibration from people. The cameras need "
    "not see the board at once, nor stand where they will; poses are not written."
)
_UNSYNCHRONISED = (
    "Of --board: the videos began at different moments. The motion of the board tells when each did; that is said, "
    "and not written into the rig."
)


@dataclass(frozen=True, kw_only=True)
class Board:
    """Draw a board for calibration as a PDF in its true size.

    It is drawn as lines, so that it is exact. Print it at 100 %, not fitted to the page, and measure the line of 100 mm
    below it.

    Example: fgpose board charuco:7x5:30mm:22mm:DICT_5X5_100 -o board.pdf
    """

    board: Annotated[Positional[str], arg(metavar="BOARD", help=_DESCRIBED)]
    output: Annotated[Path, arg(metavar="FILE", aliases=("-o",))] = Path("board.pdf")
    """The PDF."""

    def run(self) -> None:
        from fgpose.calibration.board.board import load_board
        from fgpose.calibration.board.drawing import PAPERS, largest_square_m, save_board
        from fgpose.io.made_by import check_result

        if self.output.suffix.lower() != ".pdf":
            raise ValueError(f"{self.output}: a board is written as .pdf")
        board = load_board(self.board)
        check_result(self.output, "board")
        try:
            board.check_unambiguous()
        except ValueError as error:
            warnings.warn(f"{error}. As it is, it only tells lenses (--lenses-only)", stacklevel=2)
        sheet = save_board(board, self.output)
        if sheet.name not in PAPERS:
            a4_mm, a0_mm = (int(1e3 * largest_square_m(board, paper)) for paper in ("A4", "A0"))
            warnings.warn(
                f"{board.text} needs a sheet of {sheet.width_m:.2f} x {sheet.height_m:.2f} m, larger than A0. On A4 "
                f"fit lengths of {a4_mm} mm in place of {1e3 * board.square_m:.6g} mm, on A0 of {a0_mm} mm",
                stacklevel=2,
            )
        console = new_console()
        size = f"{1e3 * sheet.width_m:.0f} x {1e3 * sheet.height_m:.0f} mm"
        console.print(f"{board.text} on {sheet.name} ({size}). Print it at 100 %.", soft_wrap=True)
        print_written(console, self.output)


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """How cameras are calibrated with a board."""

    board: Annotated[str | None, arg(metavar="BOARD", help=_BOARD, help_behavior_hint="(default: none)")] = None
    lens: Annotated[Literal["auto", "pinhole", "fisheye"], arg(help=_LENS)] = "auto"
    origin: Annotated[str, arg(metavar="board|camera|level|people", help=_ORIGIN)] = "board"
    lenses_only: Annotated[bool, FlagCreatePairsOff, arg(help=_LENSES_ONLY)] = False
    unsynchronised: Annotated[bool, FlagCreatePairsOff, arg(help=_UNSYNCHRONISED)] = False

    def check_board(self) -> None:
        """Raise ValueError, before any work, for what cannot be."""
        from fgpose.calibration.board.board import load_board
        from fgpose.calibration.board.world import parse_origin

        if self.board is None:
            if self.lens != "auto" or self.origin != "board" or self.unsynchronised or self.lenses_only:
                raise ValueError(
                    "--lens, --origin, --unsynchronised and --lenses-only are of a calibration with --board"
                )
            return
        if self.lenses_only and (self.origin != "board" or self.unsynchronised):
            raise ValueError("--lenses-only has no world and no common clock: leave --origin and --unsynchronised out")
        load_board(self.board)
        parse_origin(self.origin)

    def calibrated_with_board(self, clips: Sequence[Clip], intrinsics: Path | None) -> CalibratedFromBoards:
        """The result, with progress bars."""
        from fgpose.calibration.board.board import load_board
        from fgpose.calibration.board.calibrate import calibrate_from_boards
        from fgpose.calibration.board.filmed import boards_in
        from fgpose.calibration.board.world import parse_origin
        from fgpose.io.calibration import load_intrinsics

        assert self.board is not None
        board, known = load_board(self.board), None
        if len(clips) > 1:
            board.check_unambiguous()
        if intrinsics is not None:
            known = load_intrinsics(intrinsics, [clip.name for clip in clips], [clip.size_px for clip in clips])
        if self.unsynchronised:
            return self._carried(clips, board, known)
        with progress_bar("looking for boards", "images") as progress:
            sightings = boards_in(clips, board, progress=progress)
        with progress_bar("calibrating", "steps") as progress:
            return calibrate_from_boards(
                sightings, intrinsics=known, lens=self.lens, origin=parse_origin(self.origin), progress=progress
            )

    def lenses_with_board(self, clips: Sequence[Clip]) -> tuple[CalibratedFromBoards, ...]:
        """The lens of each camera by itself, with progress bars."""
        from fgpose.calibration.board.board import load_board
        from fgpose.calibration.board.calibrate import calibrate_lenses
        from fgpose.calibration.board.filmed import boards_in

        assert self.board is not None
        sightings, board = [], load_board(self.board)
        for clip in clips:
            with progress_bar(f"looking for boards, {clip.name}", "images") as progress:
                sightings.append(boards_in([clip], board, progress=progress))
        with progress_bar("calibrating", "cameras") as progress:
            return calibrate_lenses(sightings, lens=self.lens, progress=progress)

    def _carried(self, clips: Sequence[Clip], board: BoardOfPoints, known: CameraRig | None) -> CalibratedFromBoards:
        """Of cameras that were started by hand."""
        from fgpose.calibration.board.starts.carried import calibrate_carried, carried_in
        from fgpose.calibration.board.world import parse_origin

        with progress_bar("looking for boards", "images") as progress:
            carried = carried_in(clips, board, known, progress=progress)
        with progress_bar("calibrating", "steps") as progress:
            return calibrate_carried(
                carried, intrinsics=known, lens=self.lens, origin=parse_origin(self.origin), progress=progress
            )


def print_board_calibration(console: Console, result: CalibratedFromBoards, written: Sequence[Path]) -> None:
    """A table of the cameras, how well all is known, the verdict with its reasons, and the files."""
    from fgpose.pipeline.board_report import board_rows, board_summary
    from fgpose.pipeline.calibration_report import verdict

    console.print(new_table("", *result.rig.names, rows=board_rows(result)))
    for line in (*board_summary(result), *verdict(result.findings, result.grade)):
        console.print(line)
    print_written(console, *written)


def print_board_lenses(console: Console, results: Sequence[CalibratedFromBoards], written: Sequence[Path]) -> None:
    """The same of lenses alone."""
    from fgpose.calibration.from_people.calibrated import worst_grade
    from fgpose.pipeline.board_report import lens_rows
    from fgpose.pipeline.calibration_report import verdict

    findings = tuple(finding for result in results for finding in result.findings)
    console.print(new_table("", *(name for result in results for name in result.rig.names), rows=lens_rows(results)))
    for line in verdict(findings, worst_grade(findings)):
        console.print(line)
    print_written(console, *written)
