"""How detections are weighted: fusion, confidence, uniform. ``python benchmarks/weights.py`` prints a Markdown table.

Mean absolute error of the batch smoother over the clips in tests/data/mocap_cmu, on simulated detections.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import fgpose
from fgpose.config import config_from_dict
from fgpose.synthetic import NO_OCCLUSION, DetectionNoise, Occlusion, motion_from_npz, ring_rig, simulate

_CLIPS = sorted((Path(__file__).parents[1] / "tests" / "data" / "mocap_cmu").glob("*.npz"))
_N_FRAMES = 150
_SCENES = {
    "clean": (4, NO_OCCLUSION),
    "3 of 4 views occluded": (4, Occlusion()),
    "2 views, 1 occluded": (2, replace(Occlusion(), n_views=1)),
}


def mean_error_mm(weighting: str, n_cameras: int, occlusion: Occlusion) -> float:
    config = config_from_dict({"projection": {"weighting": weighting}})
    skeleton, errors_m = fgpose.load_skeleton("h36m_17"), []
    rig = ring_rig()
    rig = rig.subset(rig.names[:n_cameras])
    for seed, clip in enumerate(_CLIPS):
        truth_m, fps = motion_from_npz(clip)
        truth_m = truth_m[:_N_FRAMES]
        scene = simulate(truth_m, skeleton, rig, fps, DetectionNoise(), occlusion, seed)
        trajectory = fgpose.smooth(scene.observations, rig, config)
        errors_m.append(np.nanmean(np.linalg.norm(trajectory.positions_m - truth_m, axis=-1)))
    return 1000 * float(np.mean(errors_m))


def main() -> None:
    print("| weighting |", " | ".join(_SCENES), "|")
    print("|---|" + "---|" * len(_SCENES))
    for weighting in ("fusion", "confidence", "uniform"):
        errors = [f"{mean_error_mm(weighting, *scene):.1f}" for scene in _SCENES.values()]
        print(f"| {weighting} |", " | ".join(errors), "|", flush=True)


if __name__ == "__main__":
    main()
