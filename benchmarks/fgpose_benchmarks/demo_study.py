"""A small data set to try a study on: motion capture that comes with fgpose, seen by a simulated rig."""

from __future__ import annotations

from pathlib import Path

from fgpose.io.atomic import write_text
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, embedded_motion, ring_rig, simulate

_CLIPS = {"boxing": "cmu_02_05", "sword": "cmu_02_07_a"}
# Of the person whose motion was captured: subjects of three sizes.
_SIZES = {"S01": 1.0, "S02": 0.94, "S03": 1.06}
_FIRST_S = 2.0  # in the clips: before, little happens
SESSIONS = ("morning", "evening")
_BROKEN = ("S03", "evening", "sword")
"""Its file ends in the middle, as after a copy that was interrupted."""

_STUDY = """# A study of motion capture that comes with fgpose. `fgpose study --init my_study.toml` writes a template.
name = "demo"
output = "results"

[data]
keypoints = "{subject}/{session}/{trial}.parquet"
calibration = "{subject}/{session}/Calib.toml"
skeleton = "h36m_17"
events = "events.tsv"

[steps]
"""


def write_demo_study(
    folder: Path, duration_s: float = 5.0, *, sessions: tuple[str, ...] = SESSIONS, report: bool = True
) -> Path:
    """Three subjects with two sessions of two trials each; calibrations and events. One trial of an evening is damaged.

    Args:
        folder: where it is written.
        duration_s: of each recording.
        sessions: of each subject, among SESSIONS.
        report: whether there will be a page of each recording.

    Returns:
        The study file.

    Raises:
        OSError: a file cannot be written.
    """
    skeleton = load_skeleton("h36m_17")
    events, seed = ["subject\tsession\ttrial\tevent\ttime_s"], 0
    for subject, size in _SIZES.items():
        for session in sessions:
            rig = ring_rig(radius_m=4.5 if session == "morning" else 5.0)
            save_rig(rig, folder / subject / session / "Calib.toml")
            for trial, clip in _CLIPS.items():
                positions_m, fps = embedded_motion(clip)
                first = round((_FIRST_S + 0.5 * seed) * fps) % max(len(positions_m) - round(duration_s * fps), 1)
                part_m = size * positions_m[first : first + round(duration_s * fps)]
                scene = simulate(part_m, skeleton, rig, fps, DetectionNoise(), Occlusion(), seed)
                path = folder / subject / session / f"{trial}.parquet"
                save_observations(scene.observations, path)
                if (subject, session, trial) == _BROKEN:
                    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
                events += [f"{subject}\t{session}\t{trial}\tgo\t{0.5 + 0.1 * seed:g}"]
                seed += 1
    write_text(folder / "events.tsv", "\n".join(events) + "\n")
    write_text(folder / "study.toml", f"{_STUDY}report = {str(report).lower()}\n")
    return folder / "study.toml"
