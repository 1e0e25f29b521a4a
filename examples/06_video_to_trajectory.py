"""From the videos of calibrated cameras to one smooth motion: detect, choose the person, correct flips, smooth.

What one learns: the steps that `fgpose run` takes, each as a function of its own, and what lies between them. Without
arguments it fetches four videos of a man balancing on one leg, and the weights of the network, from the registries.

    python examples/06_video_to_trajectory.py --output out/video.parquet
    python examples/06_video_to_trajectory.py --videos videos/ --calibration Calib.toml
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

import fgpose
from fgpose.assessment.metrics import jitter_mps3
from fgpose.estimation.evidence.image_checks.flips import correct_flips
from fgpose.monocular.detection import detect
from fgpose.monocular.downloads.cache import cache_folder
from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.networks import open_network
from fgpose.monocular.sources import open_sources


def main(
    videos: Path | None = None,
    calibration: Path | None = None,
    model: str = "blazepose-full",
    frames: int | None = None,
    output: Path = Path("out/video.parquet"),
) -> None:
    """From videos to a trajectory.

    Args:
        videos: folder with one video per camera; default: those of the demonstration.
        calibration: file of the cameras; default: that of the demonstration.
        model: blazepose-lite, blazepose-full, blazepose-heavy.
        frames: how many frames; default: all.
        output: where the trajectory goes; the extension is the format.
    """
    if videos is None:
        demo = fetch_demo_videos()
        videos, calibration = demo / "videos", demo / "calibration" / "Calib.qca.txt"
    if calibration is None:
        raise SystemExit("videos of your own need --calibration")

    # The rig may come back changed: a video that was cut belongs to a camera with a smaller image.
    sources = open_sources(videos, fgpose.load_rig(calibration))
    detected = detect(sources, open_network(model), cache=cache_folder() / "detections", frames=frames)
    print(f"{detected.n_images} images, {detected.n_new_images} of them new to the network")

    observations, flipped = correct_flips(detected.observations(), detected.rig)
    for camera, n_flipped in zip(detected.rig.names, flipped.any(axis=2).sum(axis=0).tolist(), strict=True):
        print(f"{camera}: left and right exchanged in {n_flipped} frames, corrected")

    refined = fgpose.calibration.refine_rig(observations, detected.rig)
    alone = fgpose.refine(refined.observations, refined.rig)
    smoothed = fgpose.smooth(refined.observations, refined.rig)
    for name, trajectory in (("each frame alone", alone), ("one motion", smoothed)):
        assert trajectory.residual_px is not None
        print(
            f"{name:18} jitter {jitter_mps3(trajectory.positions_m, trajectory.time_s):8.1f} m/s^3,"
            f" reprojection error {np.nanmedian(trajectory.residual_px):5.1f} px"
        )
    fgpose.save_trajectory(smoothed, output)
    print(f"wrote {output}: {smoothed.n_frames} frames of {smoothed.skeleton.n_joints} joints")


if __name__ == "__main__":
    tyro.cli(main)
