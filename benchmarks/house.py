"""How large the house is: files and lines of each package, and what one update and one command walk through.

    python benchmarks/house.py

Functions are those of fgpose and fgpose_factors that a profiler sees in a second call; no lambdas and comprehensions.
"""

from __future__ import annotations

import cProfile
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import fgpose
from fgpose.cli import main as run_command
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, ring_rig, simulate, walking

ROOT = Path(__file__).parents[1]
_PACKAGES = ("fgpose", "factors/fgpose_factors", "benchmarks/fgpose_benchmarks", "tests")
_OWN = (str(ROOT / "fgpose"), str(ROOT / "factors"))


def walked(action: Callable[[], object]) -> tuple[int, int]:
    """Functions and files of ours that an action calls the second time: the first one imports."""
    action()
    profile = cProfile.Profile()
    profile.runcall(action)
    codes = [entry.code for entry in profile.getstats() if not isinstance(entry.code, str)]
    seen = {(code.co_filename, code.co_firstlineno) for code in codes if code.co_name[0] != "<"}
    seen = {(file, line) for file, line in seen if file.startswith(_OWN)}
    return len(seen), len({file for file, _ in seen})


def main() -> None:
    for package in _PACKAGES:
        files = sorted((ROOT / package).rglob("*.py"))
        n_lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        folder, n_most = Counter(file.parent for file in files).most_common(1)[0]
        print(f"{package}: {n_lines} lines, {len(files)} files, {n_most} in {folder.relative_to(ROOT)}")
    rig, skeleton = ring_rig(), fgpose.load_skeleton("h36m_17")
    scene = simulate(walking(100, 50.0), skeleton, rig, 50.0, DetectionNoise(), Occlusion(), seed=0)
    frames = [scene.observations.frames(slice(t, t + 1)) for t in range(scene.observations.n_frames)]
    estimator = fgpose.Estimator(rig, skeleton)
    coming = iter(frames)
    for _ in frames[2:]:
        estimator.update(next(coming))
    print("Estimator.update: {} functions in {} files".format(*walked(lambda: estimator.update(next(coming)))))
    with tempfile.TemporaryDirectory() as folder:
        fgpose.files.save_observations(scene.observations, f"{folder}/seen.npz")
        fgpose.save_rig(rig, f"{folder}/Calib.toml")
        command = f"smooth {folder}/seen.npz --rig {folder}/Calib.toml --skeleton h36m_17 -o {folder}/out".split()
        print("fgpose smooth: {} functions in {} files".format(*walked(lambda: run_command(command))))


if __name__ == "__main__":
    main()
