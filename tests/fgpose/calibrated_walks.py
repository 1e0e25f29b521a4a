"""A walker before cameras that nobody has calibrated, and what a calibration from people would make of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, CameraSigmas
from fgpose.calibration.from_people.walk import Walk
from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.synthetic import ring_rig, walking

FPS = 20.0
N_FRAMES = 40
SKELETON = load_skeleton("coco_17")


def true_rig(n_cameras: int = 3) -> CameraRig:
    """Cameras around the walker, Full HD."""
    return ring_rig(n_cameras, 5.0, size_px=(1920, 1080))


def joints_m(n_frames: int = N_FRAMES) -> np.ndarray:
    """The walker's joints on the clock of the first camera."""
    h36m = load_skeleton("h36m_17")
    named = walking(n_frames, FPS, h36m)
    # The joints of a face stay with the head.
    like = {name: name if name in h36m.joints else "head" for name in SKELETON.joints}
    return named[:, [h36m.index(like[name]) for name in SKELETON.joints]]


def seen_px(rig: CameraRig) -> np.ndarray:
    """(T, C, J, 2) exactly what the cameras see."""
    return rig.project(joints_m())


def write_openpose(folder: Path, points_px: np.ndarray) -> Path:
    """One folder of JSON files per camera (``cam1_json``), COCO's joints as OpenPose writes them."""
    for c in range(points_px.shape[1]):
        own = folder / f"cam{c + 1}_json"
        own.mkdir(parents=True)
        for t, joints in enumerate(points_px[:, c]):
            flat = np.concatenate([joints, np.full((len(joints), 1), 0.9)], axis=1).ravel().tolist()
            people = {"version": 1.3, "people": [{"pose_keypoints_2d": flat}]}
            (own / f"walk_{t:012d}_keypoints.json").write_text(json.dumps(people))
    return folder


def calibrated(
    people: PeopleObservations,
    rig: CameraRig,
    findings: Sequence[CalibrationFinding] = (),
    offsets_s: Sequence[float] = (),
) -> CalibratedFromPeople:
    """As the chain would give it: the true poses, lenses as in rig, and the walk."""
    rig = rig if not offsets_s else rig.with_time_offsets(np.array(offsets_s))
    n = rig.n_cameras
    points_px = seen_px(rig)
    walk = Walk(SKELETON, rig.names, np.arange(N_FRAMES) / FPS, points_px + 2.0, np.ones(points_px.shape[:3]))
    sigmas = CameraSigmas(
        position_m=np.full(n, 0.03),
        direction_deg=np.full(n, 0.4),
        focal=np.append(0.0, np.full(n - 1, 0.012)),
        offset_s=np.append(0.0, np.full(n - 1, 0.002)),
        scale=0.015,
        vertical_deg=0.5,
        floor_m=0.012,
    )
    residual_px = reprojection_residual_px(walk.points2d_px, rig, joints_m())
    return CalibratedFromPeople(rig, sigmas, walk, joints_m(), residual_px, tuple(findings), "stature 1.78 m")


def named(rig: CameraRig, names: Sequence[str]) -> CameraRig:
    """The rig with other names."""
    return CameraRig(tuple(replace(camera, name=name) for camera, name in zip(rig.cameras, names, strict=True)))


class Chain:
    """In place of the chain: notes what it was given, and gives the truth with these findings."""

    def __init__(self) -> None:
        self.given: dict[str, Any] = {}
        self.people: PeopleObservations | None = None
        self.intrinsics: CameraRig | None = None
        self.findings: Sequence[CalibrationFinding] = ()
        self.result: Callable[[PeopleObservations, CameraRig], CalibratedFromPeople] | None = None

    def __call__(self, people: PeopleObservations, intrinsics: CameraRig, **given: Any) -> CalibratedFromPeople:
        self.people, self.intrinsics, self.given = people, intrinsics, given
        given["progress"](1, 2)
        if self.result is not None:
            return self.result(people, intrinsics)
        return calibrated(people, named(true_rig(), intrinsics.names), self.findings, (0.0, 61.25, -0.5))


def failure(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error, without what was printed before it."""
    assert main(arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fgpose: error: ")]
    return line
