"""Sessions whose cameras nobody has calibrated and nobody has started at once: one trial calibrates, all get starts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_calibration_origin, load_rig, save_rig
from fgpose.io.keypoints import save_people_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory
from fgpose.study import Plan, StudyDescription, load_study, run_study
from fgpose.study.process import due, process
from fgpose_benchmarks.synthetic import embedded_motion, ring_rig
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.crowd.walkers import walkers
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film

STUDY = """
output = "results"
[data]
keypoints = "{subject}/{session}/{trial}.parquet"
skeleton = "h36m_17"
[steps]
angles = false
formats = []
calibrate = "people"
[from_people]
trial = "walk*"
intrinsics = "Lens.toml"
stature_m = 1.75
"""
CLOCKS = SimulatedClocks((30.0, 25.0), 2.0)
RIG = ring_rig(3, 4.5, 1.9)


def boxing() -> WalkScene:
    motion_m, fps = embedded_motion("cmu_02_05")
    motion = CrowdMotion(load_skeleton("h36m_17"), motion_m[None, : round(12 * fps)], fps)
    return film(motion, RIG, 1, SimulatedNetwork(in_3d=False), CLOCKS)


@pytest.fixture(scope="module")
def scenes() -> dict[str, WalkScene]:
    return {"boxing": boxing(), "walk_1": film(walkers((4.0, 4.0), 13.0, 3), RIG, 3, SimulatedNetwork(), CLOCKS)}


@pytest.fixture
def study(scenes: dict[str, WalkScene], tmp_path: Path) -> StudyDescription:
    """A session of two trials, and one that has nobody who walks."""
    for subject, trial in (("S01", "boxing"), ("S01", "walk_1"), ("S02", "boxing")):
        (tmp_path / subject / "A").mkdir(parents=True, exist_ok=True)
        save_people_observations(scenes[trial].observations, tmp_path / subject / "A" / f"{trial}.parquet")
    save_rig(scenes["walk_1"].intrinsics, tmp_path / "Lens.toml")
    (tmp_path / "study.toml").write_text(STUDY)
    return load_study(tmp_path / "study.toml")


def offset_errors_s(found: CameraRig, scene: WalkScene) -> np.ndarray:
    true_s = scene.rig.subset(found.names).time_offsets_s
    errors_s = found.time_offsets_s - true_s
    return errors_s - errors_s[0]


def test_the_trial_that_calibrates_comes_first(study: StudyDescription) -> None:
    walk, boxing, lost = Plan(study)
    assert walk.key == "S01/A/walk_1"
    assert walk.calibrated_on == ""
    assert boxing.key == "S01/A/boxing"
    assert boxing.calibrated_on == walk.key
    assert lost.problem == "its session has no trial 'walk*' to calibrate the cameras on"
    assert due(study, boxing) == ("synchronise", "estimate", "judge")
    assert due(study, walk) == ("calibrate", "estimate", "judge")


def test_there_may_be_others_of_its_name_and_it_twice(study: StudyDescription) -> None:
    source = study.root / "S01" / "A" / "walk_1.parquet"
    (source.parent / "walk_2.parquet").write_bytes(source.read_bytes())
    again = replace(study.data, keypoints=(*study.data.keypoints, "{subject}/{session}/{trial}.parquet"))
    recordings = [each for each in Plan(replace(study, data=again)) if each.subject == "S01"]
    assert [each.key for each in recordings if not each.problem] == ["S01/A/walk_1", "S01/A/boxing", "S01/A/walk_2"]
    assert sorted(each.key for each in recordings if "there twice" in each.problem) == ["S01/A/boxing", "S01/A/walk_2"]


def test_without_the_calibration_of_its_session_a_trial_fails(study: StudyDescription) -> None:
    _, boxing, _ = Plan(study)
    outcome = process(study, boxing)
    assert outcome.status == "failed"
    assert (
        outcome.reason == "the cameras of its session are calibrated on S01/A/walk_1, which has failed or is not done"
    )


@pytest.mark.slow  # a calibration from people
def test_one_trial_calibrates_a_session(study: StudyDescription, scenes: dict[str, WalkScene]) -> None:
    result = run_study(study, n_workers=1)
    assert result.counts == {"done": 2, "failed": 1}
    walk, boxing = (study.output / "recordings" / "S01" / "A" / name for name in ("walk_1", "boxing"))
    calibrated, synchronised = load_rig(walk / "calibration.toml"), load_rig(boxing / "synchronised.toml")
    for one, other in zip(calibrated.cameras, synchronised.cameras, strict=True):
        np.testing.assert_allclose(one.world_T_camera, other.world_T_camera, atol=1e-9)
    # Half an image.
    assert np.abs(offset_errors_s(calibrated, scenes["walk_1"])).max() < 15e-3
    assert np.abs(offset_errors_s(synchronised, scenes["boxing"])).max() < 15e-3
    known = load_calibration_origin(boxing / "synchronised.toml")
    assert known.grade == load_calibration_origin(walk / "calibration.toml").grade != ""
    assert set(known.offset_sigma_s) == set(RIG.names[1:])
    # The boxer's thigh has the length that it has: the rig is metric, and its cameras are put together in time.
    trajectory = load_trajectory(boxing / "motion.parquet")
    lengths_m = np.nanmedian(trajectory.skeleton.bone_lengths(trajectory.positions_m), axis=0)
    true_m = np.nanmedian(trajectory.skeleton.bone_lengths(scenes["boxing"].motion.truth_m[0]), axis=0)
    # The biases of the network, 20 to 40 mm, and a stature that is off by some centimetres.
    assert np.median(np.abs(lengths_m - true_m)) < 0.03
    assert not any(due(study, each) for each in Plan(study) if not each.problem)


def test_what_cannot_be_is_said(study: StudyDescription) -> None:
    file = study.base / "study.toml"
    file.write_text(STUDY.replace("[from_people]", "synchronise = true\n[from_people]"))
    with pytest.raises(ValueError, match=r"steps\.synchronise: where people calibrate"):
        load_study(file)
    file.write_text(
        STUDY.replace('calibrate = "people"', 'calibrate = "given"').replace(
            "[steps]", 'calibration = "C.toml"\n[steps]'
        )
    )
    with pytest.raises(ValueError, match=r"from_people\.trial goes with"):
        load_study(file)


@pytest.mark.slow  # shifts of three pairs of cameras
def test_a_given_rig_is_synchronised(study: StudyDescription, scenes: dict[str, WalkScene]) -> None:
    save_rig(scenes["boxing"].rig.with_time_offsets(np.zeros(3)), study.root / "Calib.toml")
    text = STUDY[: STUDY.index("[from_people]")].replace('calibrate = "people"', "synchronise = true")
    (study.base / "study.toml").write_text(text.replace("[steps]", 'calibration = "Calib.toml"\n[steps]'))
    given = load_study(study.base / "study.toml")
    (boxing,) = Plan(given, "S02/A/boxing")
    outcome = process(given, boxing)
    assert outcome.ran == ("synchronise", "estimate", "judge"), outcome.reason
    found = load_rig(boxing.folder(given.output) / "synchronised.toml")
    assert np.abs(offset_errors_s(found, scenes["boxing"])).max() < 15e-3
