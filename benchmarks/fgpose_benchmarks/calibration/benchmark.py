"""The benchmark of calibration from people, as the runner takes it."""

from __future__ import annotations

from dataclasses import replace

from fgpose_benchmarks.calibration.recording import CalibrationResult, KnownRigRecording
from fgpose_benchmarks.calibration.scores import CalibrationScore, score_calibration
from fgpose_benchmarks.calibration.variants import TUNING_CLIPS, VARIANTS, VERSION, record
from fgpose_benchmarks.comparison.runner import Benchmark

_SHORT_S = 4.0


def _warm_up() -> KnownRigRecording:
    return record(replace(VARIANTS[0], duration_s=_SHORT_S), TUNING_CLIPS[0])


CALIBRATION: Benchmark[KnownRigRecording, CalibrationResult, CalibrationScore] = Benchmark(
    "calibration", VERSION, score_calibration, CalibrationScore, _warm_up, ("calibration",)
)
"""How rigs are found from people, and how good they are."""
