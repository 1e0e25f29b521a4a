"""The files that the commands of the documentation speak of, small: a recording of OpenPose, a room with two people, a
study."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import fgpose
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)
from tests.fgpose.io.network_outputs import MHR, body_m, sam3d_people, save_pickle

# Of the real recording: enough for somebody to be confirmed by their motion, and for offsets to be estimated.
N_FRAMES = 30
ROOM_FPS = 30.0


def make_sandbox(folder: Path) -> None:
    """Calib.toml, pose/ and mocap.trc; a study in S01/ and events.csv; Room.toml, room/ and truth.parquet; sam3d/."""
    rig, observations = fgpose.files.load_recording("balance_openpose")
    observations = observations.frames(slice(0, N_FRAMES))
    fgpose.save_rig(rig, folder / "Calib.toml")
    for camera, name in enumerate(rig.names):
        for frame in range(observations.n_frames):
            seen_px, confidence = observations.points2d_px[frame, camera], observations.confidence[frame, camera]
            write_openpose(folder / "pose" / f"{name}_json", frame, [(seen_px, confidence)])
    fgpose.save_trajectory(fgpose.refine(observations, rig), folder / "mocap.trc")

    session = folder / "S01" / "morning"
    session.mkdir(parents=True)
    fgpose.save_rig(rig, session / "Calib.toml")
    fgpose.files.save_observations(observations, session / "walk.parquet")
    (folder / "events.csv").write_text("subject,trial,event,time_s\nS01,walk,go,0.2\n")

    scene = room()
    fgpose.save_rig(scene.rig, folder / "Room.toml")
    for image in scene.observations.images:
        people = zip(image.points2d_px, image.confidence, strict=True)
        write_openpose(folder / "room" / f"{image.camera}_json", round(image.time_s * ROOM_FPS), people)
    frame_s = np.unique([image.time_s for image in scene.observations.images])
    fgpose.files.save_people(scene.truth(frame_s), folder / "truth.parquet")

    for camera in scene.rig.cameras:
        (folder / "sam3d" / camera.name).mkdir(parents=True)
        for frame, person in enumerate(sam3d_people(body_m(MHR.joints, 10), camera)):
            save_pickle([person], folder / "sam3d" / camera.name / f"{frame:06d}.pkl")


def room() -> CrowdScene:
    """Two people who stay, for 2 s, in four synchronous cameras."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(late_share=0.0, leaving_share=0.0, returning_share=0.0)
    motion = crowd_motion(2, 100, 50.0, walks, works, 2, plan)
    rig = ring_rig(4, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), 2)


def write_openpose(folder: Path, frame: int, people: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
    """One image as OpenPose writes it: x, y and confidence of each joint, zeros where there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for points_px, confidence in people:
        flat = np.nan_to_num(np.concatenate([points_px, confidence[:, None]], axis=1))
        entries.append({"pose_keypoints_2d": flat.ravel().tolist()})
    path = folder / f"{folder.name}_{frame:012d}_keypoints.json"
    path.write_text(json.dumps({"version": 1.3, "people": entries}))
