from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_rig, save_rig
from fgpose.io.keypoints import load_people, save_people_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.synthetic import embedded_motion, ring_rig
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, film


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CameraRig]:
    """Folder of a take before three cameras that were started by hand, and the true rig."""
    folder = tmp_path_factory.mktemp("take")
    motion_m, fps = embedded_motion("cmu_02_05")
    motion = CrowdMotion(load_skeleton("h36m_17"), motion_m[None, : round(15 * fps)], fps)
    scene = film(motion, ring_rig(3), 1, SimulatedNetwork(in_3d=False), SimulatedClocks((30.0, 25.0), 2.0))
    save_rig(scene.rig.with_time_offsets(np.zeros(3)), folder / "Calib.toml")
    save_people_observations(scene.observations, folder / "take.parquet")
    return folder, scene.rig


def arguments(folder: Path, *more: str) -> list[str]:
    return [str(folder / "take.parquet"), "--rig", str(folder / "Calib.toml"), "--skeleton", "h36m_17", *more]


def test_the_starts_are_printed_and_written(
    take: tuple[Path, CameraRig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, true = take
    assert main(["synchronise", *arguments(folder), "-o", str(tmp_path / "take.toml")]) == 0
    printed = capsys.readouterr().out
    assert "began later than the first [s]" in printed
    assert f"wrote {tmp_path / 'take.toml'}" in printed
    found = load_rig(tmp_path / "take.toml")
    offsets_s = found.time_offsets_s
    assert not found.after_recording().time_offsets_s.any()
    # Half an image; sigmas are 5 ms.
    np.testing.assert_allclose(offsets_s, true.time_offsets_s - true.time_offsets_s[0], atol=15e-3)


@pytest.mark.slow
def test_some_cameras_are_enough(take: tuple[Path, CameraRig], tmp_path: Path) -> None:
    folder, _ = take
    assert (
        main(["synchronise", *arguments(folder, "--cameras", "ring_0", "ring_1", "-o", str(tmp_path / "2.toml"))]) == 0
    )
    assert load_rig(tmp_path / "2.toml").names == ("ring_0", "ring_1")


def test_an_input_is_not_replaced(take: tuple[Path, CameraRig], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = take
    assert main(["synchronise", *arguments(folder), "-o", str(folder / "Calib.toml")]) == 2
    assert "would replace an input" in capsys.readouterr().err


@pytest.mark.slow
def test_a_camera_that_sees_nobody_is_said(
    take: tuple[Path, CameraRig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, true = take
    people = load_people(folder / "take.parquet", true, "h36m_17")
    empty = PeopleObservations(
        people.skeleton,
        people.camera_names,
        tuple(each for each in people.images if each.camera != "ring_2" or each.time_s < 0.3),
    )
    save_people_observations(empty, tmp_path / "take.parquet")
    given = [str(tmp_path / "take.parquet"), *arguments(folder)[1:], "-o", str(tmp_path / "take.toml")]
    assert main(["synchronise", *given]) == 0
    printed = capsys.readouterr().out
    assert "ring_2: the person is seen for 0.3 s only" in printed
    assert "Walk about where all cameras see you" in printed
    assert "Left out, as their starts are not known: ring_2. Use the others: --cameras ring_0 ring_1" in printed
    of_two = ["--cameras", "ring_0", "ring_1", "--rig", str(tmp_path / "take.toml"), "--skeleton", "h36m_17"]
    assert main(["smooth", given[0], *of_two, "--formats", "npz", "-o", str(tmp_path / "out"), "--frames", "45"]) == 0
