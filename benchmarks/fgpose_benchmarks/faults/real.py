"""Real recordings to be damaged. What all their cameras say together stands for the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.self_calibration import calibrate_cameras
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.io.recordings import load_recording
from fgpose.observations import Observations
from fgpose_benchmarks.calibration.real import WEBCAM, webcam
from fgpose_benchmarks.faults.take import FPS, Take


@dataclass(frozen=True, eq=False)
class RealTake(Take):
    """One person, detected by a network in real images."""

    errors_px: Float[np.ndarray, "frame camera joint 2"]
    """Of the detections against the truth, in distorted images; NaN = missing."""
    claimed_m2: Float[np.ndarray, "frame joint 3 3"]
    """By the estimate from all cameras."""

    @property
    def is_real(self) -> bool:
        return True

    @property
    def truth_covariance_m2(self) -> Float[np.ndarray, "frame joint 3 3"]:
        return self.claimed_m2

    def film(self, rig: CameraRig, truth_m: Float[np.ndarray, "frame joint 3"] | None = None) -> Observations:
        truth_m = self.truth_m if truth_m is None else truth_m
        part = self.observations.frames(slice(0, len(truth_m)))
        points_px = _projected_px(rig, truth_m) + self.errors_px[: len(truth_m)]
        known = np.asarray(np.isfinite(points_px).all(axis=-1))
        return replace(
            part,
            points2d_px=np.where(known[..., None], points_px, np.nan),
            confidence=np.where(known, part.confidence, 0.0),
        )


def real_takes() -> Iterator[Take]:
    """The man on one leg, with the calibration refined, which is off by up to 6 cm; the upper half of a person close to
    four webcams, where the folder of the source code is at hand. Each with the first two, three and all cameras."""
    rig, balance = load_recording("balance_openpose")
    refined = calibrate_cameras(balance, rig, poses=True, clocks=False)
    yield from _takes("balance", refined.observations.frames(slice(None, None, 2)), refined.rig, seed=201)
    if (WEBCAM / "landmarks.npz").is_file():
        rig, seen = webcam()
        yield from _takes("webcams", seen, rig, seed=202)


def _takes(clip: str, seen: Observations, rig: CameraRig, seed: int) -> Iterator[Take]:
    # Damages count frames. Images of one frame are up to 20 ms apart, in which people who stand move millimetres.
    seen = replace(seen, time_s=np.arange(seen.n_frames) / FPS)
    estimated = smooth(seen, rig)
    assert estimated.covariance_m2 is not None
    truth_m, claimed_m2 = _without_gaps(estimated.positions_m), np.nan_to_num(estimated.covariance_m2)
    errors_px = seen.points2d_px - _projected_px(rig, truth_m)
    for n in (2, 3, 4):
        names = list(rig.names[:n])
        part, own = rig.subset(names), seen.subset(names)
        yield RealTake(clip, f"{n} cameras", part, own, truth_m, seed, errors_px[:, :n], claimed_m2)


def _without_gaps(positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame joint 3"]:
    """On the line between frames; joints of which nothing is known in the middle of the others."""
    frame, filled_m = np.arange(len(positions_m)), positions_m.copy()
    for track_m in filled_m.swapaxes(0, 1):
        known = np.isfinite(track_m).all(axis=-1)
        if known.any():
            track_m[:] = np.stack([np.interp(frame, frame[known], axis_m[known]) for axis_m in track_m.T], axis=-1)
    never = np.isnan(filled_m).all(axis=(0, 2))
    filled_m[:, never] = np.nanmean(filled_m, axis=1, keepdims=True)
    return filled_m


def _projected_px(
    rig: CameraRig, points_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint 2"]:
    return np.stack([camera.distort(camera.project(points_m)) for camera in rig.cameras], axis=1)
