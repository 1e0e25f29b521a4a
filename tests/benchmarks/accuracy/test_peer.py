from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.accuracy import peer_methods as lines
from fgpose_benchmarks.accuracy.peer import PeerSettings, find_peer, running_peer
from fgpose_benchmarks.accuracy.peer_methods import BEST, DEFAULT, peer_methods
from fgpose_benchmarks.accuracy.variants import find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import NO_NOISE

REAL = find_peer()
# Answers like peer_server.py; its result is scale_smooth everywhere, and it dies at 13.
STAND_IN = """
import json, sys
import numpy as np
print(json.dumps({"version": "0.0"}), flush=True)
for line in sys.stdin:
    request = json.loads(line)
    recording = np.load(request["recording"])
    assert set(recording) == {"undistorted_px", "confidence", "bones", "K", "camera_T_world"}
    value = request["settings"].get("scale_smooth", 0.0) + request["scores"]
    if value == 13:
        sys.exit("out of luck")
    frames, cameras, joints, _ = recording["undistorted_px"].shape
    solved = {"positions_m": np.full((frames, joints, 3), value)}
    if "inflate_vars" in request["settings"]:
        solved["variance_m2"] = np.full((frames, joints, 3), 4.0)
    np.savez(request["output"], **solved)
    print(json.dumps({"wall_s": 1.0 + value, "cpu_s": 2.0}), flush=True)
"""


@pytest.fixture(scope="module")
def recording() -> BenchmarkRecording:
    return record(find_variant("clean"), "cmu_02_05", 8)


@pytest.fixture
def stand_in(tmp_path: Path) -> Path:
    """A program that is called as a Python and answers as the server."""
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN, encoding="utf-8")
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}"\n', encoding="utf-8")
    python.chmod(0o755)
    return python


def settings(scale_smooth: float, *, scores: bool = False) -> PeerSettings:
    return PeerSettings(scores, {"scale_smooth": scale_smooth})


def test_requests_and_answers(stand_in, recording):
    with running_peer(stand_in) as peer:
        assert peer.version == "0.0"
        for given, value in ((PeerSettings(), 0.0), (settings(3.0), 3.0), (settings(3.0, scores=True), 4.0)):
            result = peer.solve(recording.observations, recording.rig, given)
            np.testing.assert_array_equal(result.positions_m, np.full(recording.truth_m.shape, value))
            assert (result.wall_s, result.cpu_s) == (1.0 + value, 2.0)


def test_variances_that_it_states_are_taken(stand_in, recording):
    result = lines._smoothed(stand_in, PeerSettings(optim={"inflate_vars": True}), recording)
    lines._peer.cache_clear()
    assert result.covariance_m2 is not None
    np.testing.assert_array_equal(result.covariance_m2, np.broadcast_to(4.0 * np.eye(3), result.covariance_m2.shape))


def test_its_death_tells_what_it_wrote(stand_in, recording):
    with running_peer(stand_in) as peer:
        with pytest.raises(OSError, match="aniposelib ended: out of luck"):
            peer.solve(recording.observations, recording.rig, settings(13.0))
        with pytest.raises(OSError, match="aniposelib ended"):
            peer.solve(recording.observations, recording.rig, settings(1.0))


def test_an_environment_without_it_is_refused():
    # The tests' own environment lacks it: its OpenCV would overwrite ours.
    own = Path(sys.executable)
    with pytest.raises(OSError, match="No module named 'aniposelib'"), running_peer(own):
        pass


def test_the_truth_chooses_the_best_setting(stand_in, recording):
    truth_m = np.full_like(recording.truth_m, 5.0)
    choices = (settings(2.0), settings(6.0), settings(9.0))
    result = lines._solve(stand_in, choices, replace(recording, truth_m=truth_m))
    lines._peer.cache_clear()
    np.testing.assert_array_equal(result.positions_m, np.full_like(truth_m, 6.0))
    assert result.time_s == 7.0  # of that setting alone


def test_where_it_is_looked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_peer() is None
    default = tmp_path / ".venv" / "bench" / "bin" / "python"
    default.parent.mkdir(parents=True)
    default.symlink_to(sys.executable)
    assert find_peer() == default  # not what it links to, which knows nothing of the environment
    with pytest.raises(OSError, match=r"no Python for aniposelib at .*nowhere"):
        find_peer(tmp_path / "nowhere")


def test_settings_have_names():
    assert str(DEFAULT) == "default"
    assert str(settings(20.0, scores=True)) == "scale_smooth 20.0, scores"
    assert len({str(each) for each in (DEFAULT, *BEST)}) == len(BEST) + 1


@pytest.mark.slow
@pytest.mark.skipif(REAL is None, reason="aniposelib is not installed in .venv/bench")
def test_aniposelib_itself_finds_the_truth():
    assert REAL is not None
    perfect = record(replace(find_variant("clean"), noise=NO_NOISE), "cmu_02_05", 15)
    default, best = (method.solve(perfect) for method in peer_methods(REAL))
    errors_mm = [1000 * mpjpe_m(result.positions_m, perfect.truth_m) for result in (default, best)]
    lines._peer.cache_clear()
    # Its smoothing costs some millimetres in punches.
    assert max(errors_mm) < 15.0
    assert min(default.time_s, best.time_s) > 0
