"""Coordinates for OpenSim, against the model that they are for (rajagopal.py)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from built_body import built, random_angles, trajectory
from mot_files import read_mot
from rajagopal import RANGES, directions, middle_of_the_hips_m

from fgpose.geometry.up_axis import y_up
from fgpose.io.trajectories.kinematics import write_mot
from fgpose.kinematics.opensim import opensim_coordinates
from fgpose.trajectory import Trajectory

ENDS = {
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
}


def coordinates_of(body: Trajectory, frame: int = 0) -> dict[str, float]:
    return {name: float(values[frame]) for name, values in opensim_coordinates(body).items()}


def test_all_coordinates_are_the_model_s_and_within_its_ranges() -> None:
    # A person who stands almost straight and faces the ground's x axis.
    bent = {f"{side}_{joint}_flexion": 5.0 for side in ("left", "right") for joint in ("knee", "elbow")}
    found = coordinates_of(trajectory(built(bent | {"trunk_heading": 90.0})[None]))
    assert len(found) == 6 + 2 * 9 + 3
    for name, value in found.items():
        lowest, highest = RANGES[name.removesuffix("_r").removesuffix("_l")]
        assert np.isnan(value) or lowest <= value <= highest, name


@pytest.mark.parametrize("side", [pytest.param("left", marks=pytest.mark.slow), "right"])
def test_the_model_takes_the_posture_of_the_joints(side: str) -> None:
    rng = np.random.default_rng(5)
    body = trajectory(np.stack([built(random_angles(rng)) for _ in range(50)]))
    compared = 0
    for frame in range(50):
        coordinates = coordinates_of(body, frame)
        if not all(np.isfinite(value) for name, value in coordinates.items() if name.endswith(f"_{side[0]}")):
            continue  # an arm or thigh that points to the side has no flexion of its own
        compared += 1
        for bone, along in directions(coordinates, side[0]).items():
            start, end = (body[f"{side}_{joint}"][frame] for joint in ENDS[bone])
            seen = y_up((end - start) / np.linalg.norm(end - start), "z")
            # Both are exact; what remains is rounding.
            np.testing.assert_allclose(along, seen, atol=1e-9, err_msg=f"{bone} {frame}")
    assert compared > 40


def test_the_model_s_hips_are_where_ours_are() -> None:
    rng = np.random.default_rng(6)
    body = trajectory(np.stack([built(random_angles(rng)) for _ in range(20)]))
    ours_m = y_up((body["left_hip"] + body["right_hip"]) / 2, "z")
    for frame in range(20):
        np.testing.assert_allclose(middle_of_the_hips_m(coordinates_of(body, frame)), ours_m[frame], atol=1e-9)


def test_somebody_who_turns_round_does_not_jump() -> None:
    body = trajectory(np.stack([built({"trunk_heading": heading}) for heading in np.arange(0.0, 720.0, 30.0)]))
    np.testing.assert_allclose(np.diff(opensim_coordinates(body)["pelvis_rotation"]), 30.0, atol=1e-6)


def test_gaps_are_bridged_for_opensim_reads_up_to_the_first_one(tmp_path: Path) -> None:
    nan = np.nan
    values = {
        "pelvis_tx": np.array([nan, 0.5, nan, 0.7, nan, 1.1]),
        "arm_flex_r": np.array([170.0, nan, nan, -160.0, nan, -150.0]),
        "hip_rotation_l": np.full(6, nan),
    }
    write_mot(values, np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0]), tmp_path / "gaps.mot")
    assert "nan" not in (tmp_path / "gaps.mot").read_text().lower()
    found, time_s = read_mot(tmp_path / "gaps.mot")
    assert list(found) == ["pelvis_tx", "arm_flex_r"]  # the model keeps its value of what is never known
    assert len(time_s) == 6
    np.testing.assert_allclose(found["pelvis_tx"], [0.5, 0.5, 0.6, 0.7, 0.9, 1.1])
    np.testing.assert_allclose(found["arm_flex_r"], [170.0, 180.0, 190.0, -160.0, -155.0, -150.0])


def test_nobody_is_no_motion(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nobody\.mot: no coordinate is known in any frame"):
        write_mot({"knee_angle_r": np.full(3, np.nan)}, np.arange(3.0), tmp_path / "nobody.mot")
    assert not list(tmp_path.iterdir())
