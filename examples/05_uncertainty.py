"""How sure the estimate is of each joint: all cameras, one camera less, and an arm that no camera sees.

What one learns: reading the covariances as a standard deviation per joint, and telling an observed
joint from a predicted one by its status.

    python examples/05_uncertainty.py --hide cam_02
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import tyro

import fgpose

ARM = ("left_elbow", "left_wrist")


def with_hidden(
    observations: fgpose.Observations, frames: slice, camera: str | None = None, joints: tuple[str, ...] | None = None
) -> fgpose.Observations:
    """The recording without what one camera (or all) saw of some joints (or all)."""
    cameras = slice(None) if camera is None else [observations.camera_names.index(camera)]
    hidden = np.zeros(observations.confidence.shape, dtype=bool)
    columns = slice(None) if joints is None else [observations.skeleton.index(joint) for joint in joints]
    hidden[frames, cameras, columns] = True
    return replace(
        observations,
        points2d_px=np.where(hidden[..., None], np.nan, observations.points2d_px),
        confidence=np.where(hidden, 0.0, observations.confidence),
    )


def sigma_mm(trajectory: fgpose.Trajectory, frames: slice, joint: str) -> float:
    """Standard deviation of a joint (root mean square over the axes and frames), millimetres."""
    assert trajectory.covariance_m2 is not None
    covariance_m2 = trajectory.covariance_m2[frames, trajectory.skeleton.index(joint)]
    return 1000 * float(np.sqrt(np.nanmean(np.trace(covariance_m2, axis1=1, axis2=2) / 3)))


def main(frames: int = 60, hide: str = "cam_02") -> None:
    """Compare standard deviations.

    Args:
        frames: how many of the recording's frames; the middle third is compared.
        hide: the camera that is covered in that time.
    """
    rig, observations = fgpose.files.load_recording("balance_openpose")
    observations = observations.frames(slice(0, frames))
    middle = slice(frames // 3, 2 * frames // 3)

    recordings = {
        "all cameras": observations,
        f"without {hide}": with_hidden(observations, middle, camera=hide),
        "arm hidden": with_hidden(observations, middle, joints=ARM),
    }
    trajectories = {name: fgpose.smooth(recording, rig) for name, recording in recordings.items()}

    print(f"{'sigma, mm':16}" + "".join(f"{name:>16}" for name in trajectories))
    for joint in ("neck", "left_shoulder", *ARM, "right_wrist", "left_ankle"):
        row = [sigma_mm(trajectory, middle, joint) for trajectory in trajectories.values()]
        print(f"{joint:16}" + "".join(f"{value:16.1f}" for value in row))
    for name, trajectory in trajectories.items():
        predicted = trajectory.status[middle] == fgpose.Status.PREDICTED
        print(f"{name}: {100 * predicted.mean():.0f} % of the joints predicted, not observed")


if __name__ == "__main__":
    tyro.cli(main)
