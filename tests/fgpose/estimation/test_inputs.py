"""What estimators cannot take is one clear error. Called through check_inputs: the tests check types before."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import pytest

from fgpose.estimation.evidence.inputs import check_inputs
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.synthetic import Scene


def test_observations_of_others_and_exchanged_arguments_are_named(walking_scene: Scene, rig: CameraRig) -> None:
    one = walking_scene.observations.frames(slice(0, 2))
    people = PeopleObservations.of_one(one)
    check_inputs("smooth", one, rig)
    check_inputs("smooth_people", people, rig, PeopleObservations)
    several = "smooth takes Observations, of one person; PeopleObservations is of several people: use smooth_people"
    wrong: dict[str, Any] = {
        several: ("smooth", people, rig, Observations),
        "smooth takes the observations first, then the rig: smooth(observations, rig)": ("smooth", rig, one),
        "PeopleObservations; Observations is of one person: use smooth, or": (
            "smooth_people", one, rig, PeopleObservations,
        ),
        "smooth: rig must be CameraRig, got str": ("smooth", one, "Calib.toml"),
        "refine: observations must be Observations, got str": ("refine", "pose/", rig),
    }  # fmt: skip
    for message, given in wrong.items():
        with pytest.raises(TypeError, match=re.escape(message)):
            check_inputs(*given)


def test_every_estimator_asks() -> None:
    """In a process of its own, whose types are not checked."""
    program = """
import fgpose
rig, observations = fgpose.files.load_recording("balance_openpose")
for estimator in (fgpose.smooth, fgpose.refine, fgpose.fuse, fgpose.smooth_people):
    try:
        estimator(rig, observations)
    except TypeError as error:
        print(error)
try:
    fgpose.Observations(17, observations.time_s, observations.points2d_px)
except TypeError as error:
    print(error)
"""
    *said, of_skeleton = lines_of(program)
    names = ("smooth", "refine", "fuse", "smooth_people")
    assert said == [f"{name} takes the observations first, then the rig: {name}(observations, rig)" for name in names]
    assert of_skeleton == "a skeleton or its name is needed, got 17"


def test_what_else_is_called_with_something_else() -> None:
    program = """
import numpy as np
import fgpose
from fgpose.diagnosis import diagnose
rig, observations = fgpose.files.load_recording("balance_openpose")
shape = 2, observations.skeleton.n_joints
trajectory = fgpose.Trajectory(observations.skeleton, np.arange(2.0), np.zeros((*shape, 3)), np.zeros(shape, int))
for call in (
    lambda: fgpose.Estimator("body_25b", rig),
    lambda: fgpose.people.Tracker("Calib.toml", "body_25b"),
    lambda: fgpose.joint_angles(observations),
    lambda: fgpose.kinematics.joint_speeds(observations),
    lambda: fgpose.evaluate(trajectory, "truth.parquet"),
    lambda: fgpose.load_observations("pose", "Calib.toml", fps=60.0),
    lambda: trajectory.show(1),
    lambda: fgpose.smooth(observations, "Calib.toml"),
    lambda: fgpose.save_trajectory("pose.parquet", trajectory),
    lambda: fgpose.save_trajectory(observations, "pose.parquet"),
    lambda: fgpose.files.save_rig(observations, "Calib.toml"),
    lambda: fgpose.files.save_observations(trajectory, "pose.parquet"),
    lambda: diagnose(rig, observations),
):
    try:
        call()
    except TypeError as error:
        print(error)
"""
    assert lines_of(program) == [
        "Estimator takes the rig first, then the skeleton: Estimator(rig, skeleton)",
        "Tracker: rig must be CameraRig, got str: fgpose.load_rig reads one from a file",
        "joint_angles: trajectory must be Trajectory, got Observations: fgpose.smooth(observations, rig) gives one",
        "joint_speeds: trajectory must be Trajectory, got Observations: fgpose.smooth(observations, rig) gives one",
        "evaluate: reference must be Trajectory, got str: fgpose.load_trajectory reads one from a file",
        "load_observations: rig must be CameraRig, got str: fgpose.load_rig reads one from a file",
        "show: rig must be CameraRig, got int",
        "smooth: rig must be CameraRig, got str: fgpose.load_rig reads one from a file",
        "save_trajectory: trajectory must be Trajectory, got str: fgpose.load_trajectory reads one from a file",
        "save_trajectory: trajectory must be Trajectory, got Observations: fgpose.smooth(observations, rig) gives one",
        "save_rig: rig must be CameraRig, got Observations",
        "save_observations: observations must be Observations, got Trajectory",
        "diagnose: rig must be CameraRig, got Observations",
    ]


def lines_of(program: str) -> list[str]:
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()
