"""fgpose beside aniposelib's triangulate_optim: time on the same frames in the same run, and error against the truth.

Both get the same 2D detections and confidences. The peer runs at its defaults, and at the best setting of a sweep:
best by the truth itself, which no user has, so this favours the peer. fgpose runs at its defaults only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from metric import Metric
from peer import Peer, PeerResult, PeerSettings, running_peer
from scenario import scene
from timing import timed

import fgpose
from fgpose.metrics import mpjpe_m
from fgpose.synthetic import Occlusion, Scene
from fgpose.triangulation import triangulate_robust

DEFAULT = PeerSettings()
QUICK_SWEEP = (PeerSettings(scores=True, optim={"n_deriv_smooth": 2, "scale_smooth": 20.0}),)
FULL_SWEEP = tuple(
    PeerSettings(scores, {"n_deriv_smooth": n_deriv_smooth, "scale_smooth": scale_smooth})
    for scores in (False, True)
    for n_deriv_smooth, scales in (
        (1, (1.0, 2.0, 4.0, 8.0)),
        (2, (4.0, 10.0, 20.0, 40.0)),
        (3, (20.0, 60.0, 150.0, 400.0)),
    )
    for scale_smooth in scales
)


def _error_mm(positions_m: Float[np.ndarray, "frame joint 3"], truth: Scene) -> float:
    return 1e3 * mpjpe_m(positions_m, truth.truth_m)


def _without_3d(full: Scene) -> Scene:
    """The scene with 2D detections only: all that the peer can use."""
    return dataclasses.replace(full, observations=dataclasses.replace(full.observations, points3d_m=None))


def _default_and_best(peer: Peer, on: Scene, sweep: Sequence[PeerSettings]) -> tuple[PeerResult, PeerResult]:
    results = [peer.solve(on, settings) for settings in (DEFAULT, *sweep)]
    return results[0], min(results, key=lambda result: _error_mm(result.positions_m, on))


def against_aniposelib(n_frames: int, rounds: int, sweep: Sequence[PeerSettings]) -> list[Metric]:
    """Alternating runs A B A B on a scene without occlusion; the median of their ratios counts."""
    on = _without_3d(scene(n_frames))
    with running_peer() as peer:
        _, best = _default_and_best(peer, on, sweep)
        ours_mm = _error_mm(fgpose.smooth(on.observations, on.rig).positions_m, on)
        metrics = [Metric("fgpose, 2D only: MPJPE", ours_mm, "mm")]
        for name, settings in (("default", DEFAULT), (f"best of sweep ({best.settings})", best.settings)):
            metrics += _duel(peer, on, settings, f"aniposelib {name}", ours_mm, rounds)
    return metrics


def _duel(peer: Peer, on: Scene, settings: PeerSettings, name: str, ours_mm: float, rounds: int) -> list[Metric]:
    # The limits hold at the defaults of both; settings that the truth chose are for information.
    speed_limit, error_limit = (8.0, 1.0) if settings == DEFAULT else (None, None)
    ratios, theirs_ms, theirs_mm = [], [], float("nan")
    for _ in range(rounds):
        ours, _ = timed(lambda: fgpose.smooth(on.observations, on.rig))
        theirs = peer.solve(on, settings)
        ratios.append((theirs.timing.wall_s / ours.wall_s, theirs.timing.cpu_s / ours.cpu_s))
        theirs_ms.append(1e3 * np.array([theirs.timing.wall_s, theirs.timing.cpu_s]) / on.observations.n_frames)
        theirs_mm = _error_mm(theirs.positions_m, on)
    wall, cpu = np.median(ratios, axis=0).tolist()
    wall_ms, cpu_ms = np.median(theirs_ms, axis=0).tolist()
    return [
        Metric(f"{name}: time", wall_ms, "ms/frame", cpu=cpu_ms),
        Metric(f"{name}: its time over that of fgpose", wall, "x", "higher", limit=speed_limit, cpu=cpu),
        Metric(f"{name}: MPJPE", theirs_mm, "mm"),
        Metric(f"{name}: MPJPE of fgpose over its", ours_mm / theirs_mm, "x", limit=error_limit, exact=True),
    ]


def occluded(n_frames: int, sweep: Sequence[PeerSettings]) -> list[Metric]:
    """Error of every method where three of four views are occluded at any time; for information."""
    full = scene(n_frames, Occlusion())
    flat = _without_3d(full)
    errors_mm = _online_errors_mm(full) | {
        "robust triangulation": _error_mm(
            triangulate_robust(full.observations.points2d_px, full.observations.confidence, full.rig).positions_m, full
        ),
        "refine (each frame alone)": _error_mm(fgpose.refine(full.observations, full.rig).positions_m, full),
        "smooth": _error_mm(fgpose.smooth(full.observations, full.rig).positions_m, full),
        "smooth, 2D only": _error_mm(fgpose.smooth(flat.observations, flat.rig).positions_m, full),
    }
    with running_peer() as peer:
        default, best = _default_and_best(peer, flat, sweep)
    errors_mm["aniposelib default, 2D only"] = _error_mm(default.positions_m, full)
    errors_mm[f"aniposelib best of sweep ({best.settings}), 2D only"] = _error_mm(best.positions_m, full)
    return [
        Metric(f"occluded, {name}: MPJPE", value, "mm") for name, value in sorted(errors_mm.items(), key=_worst_first)
    ]


def _worst_first(item: tuple[str, float]) -> float:
    return -item[1]


def _online_errors_mm(on: Scene) -> dict[str, float]:
    """Error of the newest estimates, and of those one lag old, each against the truth of its own frame."""
    estimator = fgpose.Estimator(on.rig, on.observations.skeleton)
    newest_m = np.full(on.truth_m.shape, np.nan)
    lagged_m = np.full(on.truth_m.shape, np.nan)
    for index in range(on.observations.n_frames):
        estimate = estimator.update(on.observations.frames(slice(index, index + 1)))
        newest_m[estimate.frame] = estimate.positions_m
        if estimate.smoothed is not None:
            lagged_m[estimate.smoothed.frame] = estimate.smoothed.positions_m
    return {"online newest": _error_mm(newest_m, on), "online one lag old": _error_mm(lagged_m, on)}
