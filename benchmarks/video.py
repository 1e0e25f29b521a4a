"""From real videos: fused against triangulated, smoothed against frame by frame, occluders over the person."""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

import fgpose
from fgpose.assessment.metrics import jitter_mps3
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.config import FusionConfig
from fgpose.estimation.evidence.image_checks.flips import correct_flips
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect
from fgpose.monocular.downloads.cache import cache_folder
from fgpose.monocular.networks import open_network
from fgpose_benchmarks.synthetic import Occlusion
from metric import Metric
from occluders import load_cutouts, occluded
from scenario import demo_sources

_SEED = 42
_FPS = 60.0
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FUSED_LIMITS_MM = {"blazepose-heavy": 20.0, "blazepose-full": 30.0}
# Of Human3.6M-Occluded: every frame draws its views and occluders anew. Harder, and what a table or a robot does: they
# stay for one to two seconds.
EACH_FRAME = Occlusion(min_duration_s=1 / _FPS, max_duration_s=1 / _FPS)
STAYING = Occlusion()
_MOVED_LIMITS_MM = (25.0, 100.0)
_RULES = {EACH_FRAME: "drawn anew in each frame", STAYING: "staying for 1 to 2 s"}


@cache
def _detected(model: str) -> Detected:
    return detect(demo_sources(), open_network(model), cache=cache_folder() / "detections")


def _observations(detected: Detected) -> fgpose.Observations:
    return correct_flips(detected.observations(), detected.rig)[0]


def _limbs(skeleton: fgpose.Skeleton) -> list[int]:
    return [index for index, joint in enumerate(skeleton.joints) if any(part in joint for part in _LIMBS)]


def fused_against_triangulated(models: tuple[str, ...]) -> list[Metric]:
    """Mean distance of the fused per-view 3D from robust triangulation of the same 2D, joints of the limbs."""
    metrics = []
    for model in models:
        detected = _detected(model)
        observations, rig = _observations(detected), detected.rig
        triangulated_m = _robust_m(observations, rig)
        by_covariance, by_reprojection = FusionConfig(mean="covariance"), FusionConfig(mean="reprojection")
        for fusion, limit in ((by_covariance, _FUSED_LIMITS_MM.get(model)), (by_reprojection, None)):
            fused_m = fgpose.fuse(observations, rig, fgpose.Config(fusion=fusion)).positions_m
            apart_m = np.linalg.norm(fused_m - triangulated_m, axis=-1)[:, _limbs(observations.skeleton)]
            name = f"{model}: per-view 3D fused by {fusion.mean}, from robust triangulation, mean"
            metrics.append(Metric(name, 1e3 * float(np.nanmean(apart_m)), "mm", limit=limit, exact=True))
    return metrics


def smoothness(model: str) -> list[Metric]:
    """Jitter of the smoothed result over that of each frame alone."""
    detected = _detected(model)
    observations, rig = _observations(detected), detected.rig
    smoothed = fgpose.smooth(observations, rig)
    jitter = jitter_mps3(smoothed.positions_m, smoothed.time_s)
    alone = {"refine": fgpose.refine(observations, rig).positions_m, "triangulation": _robust_m(observations, rig)}
    return [
        Metric(
            f"{model}: jitter, smoothed over {name}",
            jitter / jitter_mps3(positions_m, smoothed.time_s),
            "x",
            limit=0.1,
            exact=True,
        )
        for name, positions_m in alone.items()
    ]


def occluders_pasted(models: tuple[str, ...], rules: tuple[Occlusion, ...]) -> list[Metric]:
    """How far occluders on three of the four views move the joints of the limbs, for every method."""
    metrics = []
    for model in models:
        detected, cutouts = _detected(model), load_cutouts()
        clean, rig = _observations(detected), detected.rig
        refined = fgpose.calibration.refine_rig(clean, rig)
        for rule in rules:
            hidden = _observations(detect(occluded(detected, _SEED, cutouts, rule), open_network(model)))
            metrics += _moved(f"{model}, occluders {_RULES[rule]}", clean, hidden, rig, _MOVED_LIMITS_MM)
            pair = refined.observations, moved_with_cameras(hidden, rig, refined.rig)
            name = f"{model}, occluders {_RULES[rule]}, calibration refined"
            metrics += _moved(name, *pair, refined.rig, (None, None))
    return metrics


def _moved(
    name: str,
    clean: fgpose.Observations,
    hidden: fgpose.Observations,
    rig: fgpose.CameraRig,
    limits_mm: tuple[float | None, float | None],
) -> list[Metric]:
    metrics, limbs = [], _limbs(clean.skeleton)
    before_m, after_m = _all_methods(clean, rig), _all_methods(hidden, rig)
    for method in before_m:
        moved_mm = 1e3 * np.linalg.norm(after_m[method] - before_m[method], axis=-1)[:, limbs]
        limits = limits_mm if method == "smooth" else (None, None)
        for what, percent, limit in (("median", 50, limits[0]), ("95 %", 95, limits[1])):
            value_mm = float(np.nanpercentile(moved_mm, percent))
            metrics.append(Metric(f"{name}: {method} moves by, {what}", value_mm, "mm", limit=limit, exact=True))
        lost = 100 * float(np.isnan(after_m[method][:, limbs]).any(axis=-1).mean())
        metrics.append(Metric(f"{name}: {method} loses", lost, "% of the joints"))
    return metrics


def _all_methods(
    observations: fgpose.Observations, rig: fgpose.CameraRig
) -> dict[str, Float[np.ndarray, "frame joint 3"]]:
    undistorted_px = rig.undistort(observations.points2d_px)
    estimator = fgpose.Estimator(rig, observations.skeleton)
    seen = np.moveaxis(observations.confidence > 0, 1, 2).astype(float)
    return {
        "smooth": fgpose.smooth(observations, rig).positions_m,
        "online": np.stack([estimator.update(frame).positions_m for frame in observations]),
        "refine": fgpose.refine(observations, rig).positions_m,
        "robust DLT": _robust_m(observations, rig),
        "DLT": triangulate(np.moveaxis(undistorted_px, 1, 2), seen, rig.projection_matrices),
    }


def _robust_m(observations: fgpose.Observations, rig: fgpose.CameraRig) -> Float[np.ndarray, "frame joint 3"]:
    undistorted_px = rig.undistort(observations.points2d_px)
    return triangulate_robust(undistorted_px, observations.confidence, rig).positions_m
