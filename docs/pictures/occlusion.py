"""A wrist that no camera sees for half a second: what is estimated meanwhile, and how sure that is.

python docs/pictures/occlusion.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from drawing import BLUE, GREY, PALE, VERMILLION, make_plain, new_figure, save

import fgpose

JOINT = "left_wrist"
HIDDEN = slice(40, 70)
N_FRAMES = 100


def without(observations: fgpose.Observations, joint: str, frames: slice) -> fgpose.Observations:
    """The recording as if no camera had detected a joint in these frames."""
    hidden = np.zeros(observations.confidence.shape, dtype=bool)
    hidden[frames, :, observations.skeleton.index(joint)] = True
    return replace(
        observations,
        points2d_px=np.where(hidden[..., None], np.nan, observations.points2d_px),
        confidence=np.where(hidden, 0.0, observations.confidence),
    )


def main(folder: Path | None = None) -> None:
    """Draw occlusion.svg.

    Args:
        folder: where it goes; default: docs/concepts.
    """
    rig, observations = fgpose.files.load_recording("balance_openpose")
    observations = observations.frames(slice(0, N_FRAMES))
    seen = fgpose.smooth(observations, rig)
    hidden = fgpose.smooth(without(observations, JOINT, HIDDEN), rig)
    index = observations.skeleton.index(JOINT)
    time_s = seen.time_s - seen.time_s[0]

    figure = new_figure(
        8.0, 4.6, f"The {JOINT.replace('_', ' ')} of a real recording, hidden from all cameras for 0.5 s"
    )
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    assert hidden.covariance_m2 is not None
    assert seen.covariance_m2 is not None
    axis = int(np.argmax(np.ptp(seen.positions_m[HIDDEN, index], axis=0)))
    for trajectory, colour, label in (
        (seen, GREY, "with all detections"),
        (hidden, BLUE, "without those in the grey part"),
    ):
        assert trajectory.covariance_m2 is not None
        position_m = trajectory.positions_m[:, index, axis]
        sigma_m = np.sqrt(trajectory.covariance_m2[:, index, axis, axis])
        band = (100 * (position_m - 2 * sigma_m), 100 * (position_m + 2 * sigma_m))
        upper.fill_between(time_s, *band, color=colour, alpha=0.25, linewidth=0)
        upper.plot(time_s, 100 * position_m, color=colour, linewidth=1.8, label=label)
        lower.plot(time_s, 1000 * sigma_m, color=colour, linewidth=1.8)
    error_mm = 1000 * np.abs(hidden.positions_m - seen.positions_m)[:, index, axis]
    lower.plot(time_s, error_mm, color=VERMILLION, linewidth=1.2, label="difference of the two")
    for axes in (upper, lower):
        axes.axvspan(time_s[HIDDEN.start], time_s[HIDDEN.stop - 1], color=PALE, linewidth=0, zorder=0)
    make_plain(upper, f"Position along {'xyz'[axis]} (cm), with two standard deviations", "y")
    make_plain(lower, "Standard deviation (mm)", "y")
    lower.set(xlabel="Time (s)", xlim=time_s[[0, -1]], ylim=(0, None))
    upper.legend(fontsize=9, frameon=False, loc="best")
    lower.legend(fontsize=9, frameon=False, loc="upper left")
    sigma_mm = 1000 * np.sqrt(hidden.covariance_m2[HIDDEN, index, axis, axis])
    print(
        f"wrote {save(figure, 'occlusion', folder)}: sigma up to {sigma_mm.max():.0f} mm, difference up to "
        f"{error_mm[HIDDEN].max():.0f} mm"
    )


if __name__ == "__main__":
    tyro.cli(main)
