"""From videos to the smoothed trajectory in one command."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from fgpose.cli.calibration import calibrated
from fgpose.cli.detect import VideoOptions
from fgpose.cli.options import ParameterOptions, new_console, progress_bar
from fgpose.monocular.frame_matching import NO_IMAGE

if TYPE_CHECKING:
    from fgpose.monocular.detected import Detected
    from fgpose.pipeline import Outputs, Result
    from fgpose.viewer import Recording


@dataclass(frozen=True, kw_only=True)
class Run(ParameterOptions, VideoOptions):
    """From the videos of calibrated cameras to the smoothed 3D motion of one person: detect, fuse, smooth, save.

    Writes NAME.parquet, NAME.trc and NAME.rrd, which shows the images, into the output folder. What the network finds
    is kept: another run with other parameters, or one that goes on after Ctrl-C, does not need it again. The first run
    fetches the weights (fgpose models pull).

    Example: fgpose run videos/ --rig Calib.qca.txt -o out
    """

    images: bool = True
    """Show the images in the .rrd file and with --live."""
    image_width: Annotated[int, arg(metavar="PX")] = 640
    """To how many pixels at most the width of the images in the .rrd file is reduced."""

    def run(self) -> None:
        from fgpose.pipeline import Source, run_smooth

        if self.image_width < 1:
            raise ValueError(f"--image-width must be at least 1, got {self.image_width}")
        outputs, console = self.outputs(self.videos), new_console()
        outputs.check(("smoothed",), (self.rig,))
        detected = self.detect(console)
        source = Source(detected.rig, self.wanted(detected, console).observations)
        wanted = {"poses": self.refine_calibration, "clocks": self.estimate_time_offsets}
        source = calibrated(source, self.parameters, outputs, console, **wanted)
        shown = "rrd" in self.formats or self.live
        with progress_bar("smoothing") as progress:
            result = run_smooth(source, self.parameters, progress, compare=shown)
        self._finish(result, outputs, detected)

    def _finish(self, result: Result, outputs: Outputs, detected: Detected) -> None:
        """Write and show the result."""
        from fgpose.cli.live import wait_for_viewers
        from fgpose.cli.tables import print_result
        from fgpose.pipeline import save_trajectories, show

        paths = save_trajectories(result, outputs)
        with self._recording(result, outputs) as recording:
            try:
                show(result, recording)
                if self.images:
                    show_images(detected, result, recording)
            except KeyboardInterrupt:
                recording.discard()  # closing would leave half a file
                raise
            rrd = (outputs.path("rrd"),) if "rrd" in outputs.formats else ()
            print_result(new_console(), result, (*paths, *rrd))
            if self.live:
                wait_for_viewers(outputs)

    def _recording(self, result: Result, outputs: Outputs) -> AbstractContextManager[Recording]:
        from fgpose.cli.live import live_recording
        from fgpose.pipeline import up_axis
        from fgpose.viewer import open_recording

        source, names = result.source, tuple(result.trajectories)
        if self.live:
            return live_recording(source, names, outputs, self.port, image_width_px=self.image_width)
        path = outputs.path("rrd") if "rrd" in outputs.formats else None
        up = up_axis(outputs.world_up)
        skeleton, n_frames = source.observations.skeleton, source.observations.n_frames
        return open_recording(
            path, source.rig, skeleton, names, up=up, image_width_px=self.image_width, n_frames=n_frames
        )


def show_images(detected: Detected, result: Result, recording: Recording) -> None:
    """Show the images of every camera in the frames that they belong to; they are decoded again for it."""
    time_s = result.source.observations.frame_time_s
    image = detected.frames.image[: len(time_s)]
    if not any(recording.wants_image(name, 0) for name in detected.rig.names):
        return
    with progress_bar("adding images", "images") as progress:
        for c, (name, clip) in enumerate(zip(detected.rig.names, detected.sources.clips, strict=True)):
            frame_of = {number: frame for frame, number in enumerate(image[:, c].tolist()) if number != NO_IMAGE}
            for picture in islice(clip.pictures(), max(frame_of, default=-1) + 1):
                frame = frame_of.get(picture.number)
                if frame is not None and recording.wants_image(name, frame):
                    recording.log_image(name, frame, float(time_s[frame]), picture.image)
                progress(c * len(image) + (frame or 0), image.size)
        progress(image.size, image.size)
