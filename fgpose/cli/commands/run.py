"""From videos to the smoothed trajectory in one command."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import FlagCreatePairsOff, arg

from fgpose.cli.calibration import calibrated
from fgpose.cli.commands.calibrate import FAILED
from fgpose.cli.commands.detect import VideoOptions
from fgpose.cli.commands.view import Overlay
from fgpose.cli.console import new_console
from fgpose.cli.from_people import FromPeopleOptions, print_calibrated
from fgpose.cli.options import ParameterOptions
from fgpose.cli.pictures import show_images, show_walk_images

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
    from fgpose.io.origin import Origin
    from fgpose.monocular.detected import Detected
    from fgpose.monocular.networks.devices import Device
    from fgpose.monocular.sources import Sources
    from fgpose.pipeline import Outputs, Result
    from fgpose.viewer import Recording


@dataclass(frozen=True, kw_only=True)
class CameraOptions(FromPeopleOptions):
    """Cameras that are calibrated, or that are calibrated from the videos themselves."""

    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(this or --calibrate)")] = None
    """Calibration of the cameras: Pose2Sim, aniposelib or caliscope TOML, Qualisys .qca.txt, Vicon .xcp, OpenCV YAML,
    OpenCap pickles, bioCV .calib, JSON, fgpose npz."""
    calibrate: Annotated[bool, FlagCreatePairsOff] = False
    """There is no calibration: first calibrate the cameras from the people in the videos, which need not begin at the
    same time (fgpose calibrate). Writes NAME_calibration.toml, and NAME_calibration.rrd with the verdict."""

    def check_cameras(self) -> None:
        """Raise ValueError unless exactly one of the two is asked for, and what goes with it."""
        if (self.rig is None) != self.calibrate:
            raise ValueError("give either --rig FILE, or --calibrate if the cameras are not calibrated")
        if not self.calibrate and self.says_anything:
            raise ValueError("--intrinsics, --focal-px, --height, --distance and such go with --calibrate, not --rig")
        self.check_options()


@dataclass(frozen=True, kw_only=True)
class Run(ParameterOptions, VideoOptions, CameraOptions):
    """From videos of several cameras to the smoothed 3D motion.

    Detects, fuses, smooths and saves: writes NAME.parquet, NAME.trc and NAME.rrd, which shows the images, into the
    output folder. Detections are cached: a run with other parameters, or after Ctrl-C, does not repeat them. The first
    run fetches the weights (fgpose models pull).

    Example: fgpose run videos/ --rig Calib.qca.txt -o out; or, without a calibration, fgpose run videos/ --calibrate
    --height 1.78 -o out
    """

    step: ClassVar[str] = "run"

    images: bool = True
    """Show the images in the .rrd file and with --live."""
    image_width: Annotated[int, arg(metavar="PX")] = 640
    """Largest width of the images in the .rrd file, pixels; larger ones are shrunk."""
    image_fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: of every frame shown)")] = None
    """Images per second of each camera in the .rrd file. All together take at most 1 GB."""
    overlay: Annotated[bool, FlagCreatePairsOff] = False
    """Also draw the result into the videos: NAME_overlay.mp4, all cameras in one film. fgpose overlay draws others."""

    @property
    def usual_device(self) -> Device:
        return self.parameters.monocular.device

    def sources(self) -> Sources:
        if self.rig is not None:
            return self.with_rig(self.rig)
        from fgpose.monocular.sources import find_clips

        return self.sources_of(find_clips(self.videos, fps=self.fps, cameras=self.cameras), self.frames)

    def run(self) -> int:
        from fgpose.cli.delivery import deliver, smoothed, windows_kept
        from fgpose.cli.viewers import live_viewer
        from fgpose.pipeline import show

        self.check_cameras()
        if self.calibrate and self.world_up not in ("auto", "z", "+z"):
            raise ValueError("the world of --calibrate has z up: leave --world-up out")
        if self.image_width < 1:
            raise ValueError(f"--image-width must be at least 1, got {self.image_width}")
        console, outputs = new_console(), self.outputs(self.videos)
        outputs = replace(outputs, image_width_px=self.image_width, image_fps=self.image_fps)
        wanted = {"poses": self.refine_calibration, "clocks": self.estimate_time_offsets}
        inputs = tuple(path for path in (self.rig, self.intrinsics) if path is not None)
        outputs.check(("smoothed",), inputs, calibration=self.calibrate or any(wanted.values()))
        self._check_overlay(outputs)
        detected = self.detect(console)
        found = self._calibrated(detected, outputs, console) if self.calibrate else None
        if self.calibrate and found is None:
            return FAILED
        detected = detected.recalibrated(found.rig) if found is not None else detected
        source, origin = self.wanted(detected, console), self._origin(detected, found)
        if source.chosen is not None:
            origin = replace(origin, chosen=str(source.chosen))
        source = calibrated(replace(source, origin=origin), self.parameters, outputs, console, **wanted)

        def show_all(result: Result, recording: Recording) -> None:
            show(result, recording)
            if self.images and result.origin is not None and result.origin.rig is not None:
                show_images(detected, result.origin.rig, result.frame_time_s, recording)

        with windows_kept(outputs), live_viewer(outputs, source, ("fused", "refined", "smoothed")) as viewer:
            result = smoothed(source, self.parameters, outputs)
            finish = partial(self._draw_overlay, result, outputs) if self.overlay else lambda: None
            return deliver(result, outputs, viewer, show_all, strict=self.strict, finish=finish)

    def _check_overlay(self, outputs: Outputs) -> None:
        """Raise, before any work, ImportError or OSError if no film can be made, ValueError if there is nothing to make
        it from."""
        from fgpose.io.made_by import check_result
        from fgpose.overlay.film import check_films

        if not self.overlay:
            return
        check_films()
        check_result(_film_of(outputs), "overlay", remedy="give another --name or --output, or remove it")
        if "parquet" not in outputs.formats:
            raise ValueError("--overlay is drawn from the parquet file: let --formats have parquet")

    def _draw_overlay(self, result: Result, outputs: Outputs) -> None:
        """Of the time that was estimated."""
        Overlay(
            file=outputs.path("parquet"),
            videos=self.videos,
            output=_film_of(outputs),
            fps=self.fps,
            to_s=None if self.frames is None else float(result.frame_time_s[-1]),
        ).run()

    def _calibrated(self, detected: Detected, outputs: Outputs, console: Console) -> CalibratedFromPeople | None:
        """The cameras; None if the calibration has failed."""
        from fgpose.pipeline import write_calibration

        starts = self.heard(detected.sources.clips, console)
        result = self.calibrated(detected.people, detected.rig, outputs.calibration, console, starts)
        scene = outputs.calibration.with_suffix(".rrd") if "rrd" in outputs.formats else None
        display = partial(show_walk_images, detected) if self.images else None
        written = write_calibration(result, outputs.calibration, rrd=scene, display=display, step=self.step)
        return result if print_calibrated(console, result, written, outputs.calibration) else None

    def _origin(self, detected: Detected, found: CalibratedFromPeople | None) -> Origin:
        """Cameras that were given have the clocks of their file: the images were put together by them."""
        from fgpose.io.calibration import load_rig
        from fgpose.pipeline.origin import from_people, origin_of, video_files

        rig, inputs = detected.rig, {"Videos": self.videos}
        if self.rig is not None:
            given = load_rig(self.rig, self.unit).subset(rig.names)
            rig, inputs = rig.with_time_offsets(given.time_offsets_s), inputs | {"Calibration": self.rig}
        origin = origin_of(rig, self.fps, **inputs).with_inputs(*video_files(detected.sources.clips))
        return origin if found is None else from_people(origin, found)


def _film_of(outputs: Outputs) -> Path:
    return outputs.folder / f"{outputs.name}_overlay.mp4"
