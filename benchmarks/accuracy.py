"""fgpose beside aniposelib's triangulate_optim: time on the same frames in the same run, and error against the truth.

Both get the same 2D detections and confidences. The peer runs at its defaults, and at the best setting of a sweep:
best by the truth itself, which no user has, so this favours the peer. fgpose runs at its defaults only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

import fgpose
from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.accuracy.peer import Peer, PeerSettings, running_peer
from fgpose_benchmarks.synthetic import Scene
from metric import Metric
from scenario import POSITIONS_ONLY, scene
from timing import timed

_PEER = Path(__file__).parents[1] / ".venv" / "bench" / "bin" / "python"
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


def _best(peer: Peer, on: Scene, sweep: Sequence[PeerSettings]) -> PeerSettings:
    """The settings that give the lowest error; every one has been run once, so that no compilation is timed later."""

    def error_mm(settings: PeerSettings) -> float:
        return _error_mm(peer.solve(on.observations, on.rig, settings).positions_m, on)

    return min((DEFAULT, *sweep), key=error_mm)


def against_aniposelib(n_frames: int, rounds: int, sweep: Sequence[PeerSettings]) -> list[Metric]:
    """Alternating runs A B A B on a scene without occlusion; the median of their ratios counts.

    Raises:
        FileNotFoundError: the environment of aniposelib is missing.
    """
    on = _without_3d(scene(n_frames))
    if not _PEER.exists():
        raise FileNotFoundError(f"{_PEER} is missing: make benchmark sets it up")
    with running_peer(_PEER) as peer:
        best = _best(peer, on, sweep)
        ours_mm = _error_mm(fgpose.smooth(on.observations, on.rig, POSITIONS_ONLY).positions_m, on)
        metrics = [Metric("fgpose, 2D only: MPJPE", ours_mm, "mm")]
        for name, settings in (("default", DEFAULT), (f"best of sweep ({best})", best)):
            metrics += _duel(peer, on, settings, f"aniposelib {name}", ours_mm, rounds)
    return metrics


def _duel(peer: Peer, on: Scene, settings: PeerSettings, name: str, ours_mm: float, rounds: int) -> list[Metric]:
    # The limits hold at the defaults of both; settings that the truth chose are for information.
    speed_limit, error_limit = (8.0, 1.0) if settings == DEFAULT else (None, None)
    ratios, theirs_ms, theirs_mm = [], [], float("nan")
    for _ in range(rounds):
        ours, _ = timed(lambda: fgpose.smooth(on.observations, on.rig, POSITIONS_ONLY))
        theirs = peer.solve(on.observations, on.rig, settings)
        ratios.append((theirs.wall_s / ours.wall_s, theirs.cpu_s / ours.cpu_s))
        theirs_ms.append(1e3 * np.array([theirs.wall_s, theirs.cpu_s]) / on.observations.n_frames)
        theirs_mm = _error_mm(theirs.positions_m, on)
    wall, cpu = np.median(ratios, axis=0).tolist()
    wall_ms, cpu_ms = np.median(theirs_ms, axis=0).tolist()
    return [
        Metric(f"{name}: time", wall_ms, "ms/frame", cpu=cpu_ms),
        Metric(f"{name}: its time over that of fgpose", wall, "x", "higher", limit=speed_limit, cpu=cpu),
        Metric(f"{name}: MPJPE", theirs_mm, "mm"),
        Metric(f"{name}: MPJPE of fgpose over its", ours_mm / theirs_mm, "x", limit=error_limit, exact=True),
    ]
