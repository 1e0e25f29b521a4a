"""A marker, a ball, a tool: joints between which there is no bone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose_benchmarks.synthetic import Scene

WRISTS = ("left_wrist", "right_wrist")


@pytest.mark.parametrize("names", [WRISTS[:1], WRISTS])
def test_they_are_smoothed_as_those_of_a_body(
    names: tuple[str, ...], walking_scene: Scene, rig: fgpose.CameraRig
) -> None:
    seen = walking_scene.observations
    joints = [seen.skeleton.index(name) for name in names]
    markers = replace(
        seen,
        skeleton=fgpose.Skeleton("markers", names, [], [0]),
        points2d_px=seen.points2d_px[:, :, joints],
        confidence=seen.confidence[:, :, joints],
        points3d_m=None,
        covariance3d_m2=None,
    )
    trajectory = fgpose.smooth(markers, rig)
    error_m = trajectory.positions_m - walking_scene.truth_m[:, joints]
    # Detections of 5 px at 4.5 m err by 20 mm each; those of a whole body give 10 to 15 mm here.
    assert np.linalg.norm(error_m, axis=-1).mean() < 0.02
    assert trajectory.covariance_m2 is not None
    squared = np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(trajectory.covariance_m2), error_m)
    assert np.mean(squared < 7.815) > 0.8  # the ellipsoid of 95 %; the errors of so few frames are correlated
    assert trajectory.bone_lengths_m is None or not trajectory.bone_lengths_m.size
    online = fgpose.Estimator(rig, markers.skeleton)
    newest_m = np.stack([online.update(frame).positions_m for frame in markers])
    assert np.linalg.norm(newest_m - walking_scene.truth_m[:, joints], axis=-1).mean() < 0.03
