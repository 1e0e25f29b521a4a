"""aniposelib as methods of the benchmark."""

from __future__ import annotations

import atexit
from contextlib import ExitStack
from functools import cache, partial
from pathlib import Path

from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.accuracy.peer import Peer, PeerSettings, running_peer
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


def _solve(python: Path, settings: tuple[PeerSettings, ...], recording: BenchmarkRecording) -> MethodResult:
    """The setting with the lowest error on this recording. No user knows the truth, so this favours the peer. The time
    is that of this setting alone."""
    peer = _peer(python)
    results = [peer.solve(recording.observations, recording.rig, each) for each in settings]
    best = min(results, key=lambda result: mpjpe_m(result.positions_m, recording.truth_m))
    return MethodResult(best.positions_m, None, best.wall_s)


@cache
def _peer(python: Path) -> Peer:
    """One for this process, until it ends."""
    stack = ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(running_peer(python))
