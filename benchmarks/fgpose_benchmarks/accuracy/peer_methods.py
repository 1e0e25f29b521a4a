"""aniposelib and the Ensemble Kalman Smoother as methods of the benchmark."""

from __future__ import annotations

import atexit
from contextlib import ExitStack
from functools import cache, partial
from pathlib import Path

import numpy as np

from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.accuracy.peer import ANIPOSELIB, EKS, Peer, PeerProgram, PeerSettings, running_peer
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult

DEFAULT = PeerSettings()
# Out of 43: the best on the tuning clips (150 frames of each; mean error in mm, clean / occluded / occluded_2_cameras /
# industrial). The defaults give 13.3 / 43.5 / 69.4 / 51.0. Tried: n_deriv_smooth 1 to 3, scale_smooth 1 to 1000,
# reproj_error_threshold 0.3 to 15, scale_length 2 and 6, with and without scores; the ranges also cover
# what 15 Hz needs. Not tried: init_ransac, which fails where fewer than two cameras see a joint (0.8.0).
BEST = (
    PeerSettings(  # 12.3 / 32.4 / 61.1 / 40.2
        scores=False, optim={"n_deriv_smooth": 2, "scale_smooth": 10.0, "reproj_error_threshold": 2.0}
    ),
    PeerSettings(  # 14.1 / 22.7 / 45.0 / 29.2
        scores=True, optim={"n_deriv_smooth": 1, "scale_smooth": 2.0, "reproj_error_threshold": 1.0}
    ),
    PeerSettings(  # 19.6 / 22.5 / 41.0 / 33.0
        scores=True, optim={"n_deriv_smooth": 1, "scale_smooth": 2.0, "reproj_error_threshold": 0.3}
    ),
)


def peer_methods(python: Path) -> list[Method]:
    """aniposelib with its defaults and with the best of a few good settings.

    Args:
        python: of an environment that has it.
    """
    return [
        Method("aniposelib, default", "peer", partial(_solve, python, (DEFAULT,))),
        Method("aniposelib, best setting", "peer", partial(_solve, python, BEST)),
    ]


def eks_methods(python: Path) -> list[Method]:
    """The Ensemble Kalman Smoother of several calibrated cameras, with its defaults.

    With inflate_vars it is no better where nothing is occluded, and worse where something is (19.9 in place of 20.0 mm,
    57 in place of 45 mm, the first 100 frames of one test clip).

    Args:
        python: of an environment that has it.
    """
    return [Method("EKS, default", "peer", partial(_smoothed, python, DEFAULT))]


def _smoothed(python: Path, settings: PeerSettings, recording: BenchmarkRecording) -> MethodResult:
    result = _peer(python, EKS).solve(recording.observations, recording.rig, settings)
    assert result.variance_m2 is not None
    return MethodResult(result.positions_m, result.variance_m2[..., None] * np.eye(3), result.wall_s)


def _solve(python: Path, settings: tuple[PeerSettings, ...], recording: BenchmarkRecording) -> MethodResult:
    """The setting with the lowest error on this recording. No user knows the truth, so this favours the peer. The time
    is that of this setting alone."""
    peer = _peer(python, ANIPOSELIB)
    results = [peer.solve(recording.observations, recording.rig, each) for each in settings]
    best = min(results, key=lambda result: mpjpe_m(result.positions_m, recording.truth_m))
    return MethodResult(best.positions_m, None, best.wall_s)


@cache
def _peer(python: Path, program: PeerProgram) -> Peer:
    """One of each for this process, until it ends."""
    stack = ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(running_peer(python, program))
