"""Keypoints whose files say what the joints are need no skeleton; others are refused, with what is likely."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from network_outputs import save_npz, save_pickle, save_torch, stacked

import fgpose
from fgpose.cli import main
from fgpose.io.arrays import read_arrays, write_arrays
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import load_people, load_uncalibrated, save_observations, save_people_observations
from fgpose.io.keypoints.stated_skeleton import stated_skeleton
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

N_FRAMES = 4
RIG = ring_rig(2)
MINE = Skeleton("mine", ("hip", "knee", "foot"), bones=((0, 1), (1, 2)), root=(0,), left_right=())


def seen(skeleton: Skeleton) -> fgpose.Observations:
    points_px = np.random.default_rng(0).uniform(100, 900, (N_FRAMES, 2, skeleton.n_joints, 2))
    time_s, confidence = np.arange(N_FRAMES) / 50, np.full(points_px.shape[:3], 0.75)
    return fgpose.Observations(
        skeleton, time_s=time_s, points2d_px=points_px, confidence=confidence, camera_names=RIG.names
    )


def flat(n_joints: int) -> list[float]:
    points_px = np.random.default_rng(0).uniform(100, 900, (n_joints, 2))
    return np.concatenate([points_px, np.full((n_joints, 1), 0.75)], axis=1).ravel().tolist()


def points(n_joints: int) -> list[Any]:
    return np.random.default_rng(0).uniform(100, 900, (n_joints, 2)).tolist()


def write_openpose(folder: Path, n_joints: int) -> None:
    """As Pose2Sim writes them; the first image shows nobody."""
    for name in RIG.names:
        (folder / f"{name}_json").mkdir()
        for frame in range(N_FRAMES):
            people = [{"pose_keypoints_2d": flat(n_joints)}] if frame else []
            (folder / f"{name}_json" / f"{name}_{frame:06d}.json").write_text(json.dumps({"people": people}))


def write_openpose_with_hands(folder: Path, n_joints: int) -> None:
    write_openpose(folder, n_joints)
    for path in folder.glob("*/*.json"):
        document = json.loads(path.read_text())
        for person in document["people"]:
            person |= {f"hand_{side}_keypoints_2d": flat(21) for side in ("left", "right")}
            person["face_keypoints_2d"] = []
        path.write_text(json.dumps(document))


def write_mmpose_images(folder: Path, n_joints: int) -> None:
    person = {"keypoints": points(n_joints), "keypoint_scores": [0.75] * n_joints}
    for name in RIG.names:
        (folder / name).mkdir()
        for frame in range(N_FRAMES):
            (folder / name / f"{frame:06d}.json").write_text(json.dumps([person] if frame else []))


def of_each_camera(document: Callable[[int], Any]) -> Callable[[Path, int], None]:
    def write(folder: Path, n_joints: int) -> None:
        for name in RIG.names:
            (folder / f"{name}.json").write_text(json.dumps(document(n_joints)))

    return write


def mmpose(meta: Any) -> Callable[[int], Any]:
    def document(n_joints: int) -> Any:
        person = {"keypoints": points(n_joints), "keypoint_scores": [0.75] * n_joints}
        frames = [{"frame_id": frame, "instances": [person] if frame else []} for frame in range(N_FRAMES)]
        return {"meta_info": meta, "instance_info": frames}

    return document


def coco_results(n_joints: int) -> Any:
    return [{"image_id": frame, "keypoints": flat(n_joints), "score": 0.9} for frame in range(N_FRAMES)]


def metrabs(n_joints: int) -> Any:
    return {"poses2d": [[], *[[points(n_joints)]] * (N_FRAMES - 1)]}


def write_freemocap(folder: Path, n_joints: int) -> None:
    np.save(folder / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", np.ones((2, 3, n_joints, 2)))


def write_deeplabcut(folder: Path, n_joints: int) -> None:
    joints = ["tail", *fgpose.load_skeleton("coco_17").joints][: n_joints + 1]
    cells = [(joint.replace("_", " ").upper(), kind) for joint in joints for kind in ("x", "y", "likelihood")]
    for name in RIG.names:
        rows = [["scorer", *("DLC" for _ in cells)], ["bodyparts", *(joint for joint, _ in cells)]]
        rows += [["coords", *(kind for _, kind in cells)], *[[str(t), *map(str, flat(len(joints)))] for t in range(3)]]
        (folder / f"{name}.csv").write_text("\n".join(map(",".join, rows)) + "\n")


def sam3d(n_joints: int) -> dict[str, Any]:
    """What SAM 3D Body finds of somebody in an image. The vertices, which are more, are no joints."""
    rng = np.random.default_rng(0)
    found = {"pred_vertices": (50, 3), "pred_keypoints_3d": (n_joints, 3), "pred_keypoints_2d": (n_joints, 2)}
    return {"focal_length": 900.0, "pred_cam_t": np.array([0.0, 0.0, 4.0])} | {
        key: rng.uniform(100, 900, shape) for key, shape in found.items()
    }


def write_sam3d(folder: Path, n_joints: int) -> None:
    """A pickle for each image; the first shows nobody."""
    for name in RIG.names:
        (folder / name).mkdir()
        for frame in range(N_FRAMES):
            save_pickle([sam3d(n_joints)] if frame else [], folder / name / f"{frame:06d}.pkl")


def write_sam3d_npz(folder: Path, n_joints: int) -> None:
    for name in RIG.names:
        save_npz(stacked([sam3d(n_joints)] * N_FRAMES), folder / f"{name}.npz")


def write_nlf(folder: Path, n_joints: int) -> None:
    """A file of torch for each camera; the first image shows nobody."""
    rng = np.random.default_rng(0)
    people = [
        {"joints3d": rng.normal(size=(n, n_joints, 3)), "joints2d": rng.uniform(100, 900, (n, n_joints, 2))}
        for n in (0, 1, 1, 1)
    ]
    for name in RIG.names:
        save_torch({key: [each[key] for each in people] for key in people[0]}, folder / f"{name}.pt")


HALPE = {"keypoint_id2name": dict(enumerate(fgpose.load_skeleton("halpe_26").joints))}
STATED = {
    "MMPose, names": (of_each_camera(mmpose(HALPE)), 26, "halpe_26"),
    "MMPose, data set": (of_each_camera(mmpose({"dataset_name": "h36m"})), 17, "h36m_17"),
    "FreeMoCap": (write_freemocap, 33, "blazepose_33"),
    "FreeMoCap, with hands and face": (write_freemocap, 553, "holistic_75"),
    "DeepLabCut": (write_deeplabcut, 17, "coco_17"),
}
BY_NUMBER = {
    "OpenPose of Pose2Sim": (write_openpose, 26, "halpe_26"),
    "OpenPose of 17": (write_openpose, 17, "coco_17"),
    "OpenPose of 136": (write_openpose, 136, "halpe_136"),
    "MMPose images": (write_mmpose_images, 26, "halpe_26"),
    "MMPose": (of_each_camera(mmpose(None)), 133, "coco_wholebody_133"),
    "COCO results": (of_each_camera(coco_results), 17, "coco_17"),
}
OF_NETWORKS = {
    "SAM 3D Body": (write_sam3d, 70, "mhr_70"),
    "SAM 3D Body, npz": (write_sam3d_npz, 70, "mhr_70"),
    "NLF": (write_nlf, 24, "smpl_24"),
}
NOT_SAID = {
    "OpenPose of 25": (write_openpose, 25, "of 25 joints is body_25 or body_25b$"),
    "OpenPose with hands": (
        write_openpose_with_hands,
        25,
        "of 25 joints is body_25 or body_25b; with the hands, or the face, that it has too openpose_67$",
    ),
    "MMPose of 17": (write_mmpose_images, 17, "of 17 joints is coco_17 or h36m_17 or h36m_17_lt"),
    "MeTRAbs": (of_each_camera(metrabs), 24, "of 24 joints is smpl_24"),
    "nobody": (of_each_camera(lambda _: {"instance_info": [{"frame_id": 0, "instances": []}]}), 17, "it shows nobody"),
    "NLF of SMPL-X": (write_nlf, 55, "fgpose skeletons lists those there are"),
    "of no skeleton": (write_openpose, 7, "fgpose skeletons lists those there are"),
    "other points": (write_freemocap, 21, "fgpose skeletons lists those there are"),
    "other names": (write_deeplabcut, 3, "fgpose skeletons lists those there are"),
}


@pytest.mark.parametrize("case", STATED)
def test_what_a_file_says_is_taken(case: str, tmp_path: Path) -> None:
    write, n_joints, skeleton = STATED[case]
    write(tmp_path, n_joints)
    assert stated_skeleton(tmp_path) == fgpose.load_skeleton(skeleton)


@pytest.mark.parametrize("case", BY_NUMBER)
def test_the_number_of_joints_is_taken_where_it_tells_and_that_is_said(case: str, tmp_path: Path) -> None:
    write, n_joints, skeleton = BY_NUMBER[case]
    write(tmp_path, n_joints)
    with pytest.warns(
        UserWarning, match=f"the {n_joints} joints of .* are taken for those of {skeleton}; if they are o"
    ):
        assert stated_skeleton(tmp_path) == fgpose.load_skeleton(skeleton)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of 133 joints, and of what is not said
        assert load_people(tmp_path, RIG, fps=50.0).skeleton == fgpose.load_skeleton(skeleton)
        assert load_uncalibrated(tmp_path, fps=50.0).skeleton == fgpose.load_skeleton(skeleton)


@pytest.mark.parametrize("case", OF_NETWORKS)
def test_the_number_of_joints_of_a_network_is_taken_and_that_is_said(case: str, tmp_path: Path) -> None:
    write, n_joints, skeleton = OF_NETWORKS[case]
    write(tmp_path, n_joints)
    with pytest.warns(UserWarning, match=f"the {n_joints} joints of .* are taken for those of {skeleton}; if they"):
        assert stated_skeleton(tmp_path) == fgpose.load_skeleton(skeleton)


def test_hands_that_are_not_used_are_said(tmp_path: Path) -> None:
    write_openpose_with_hands(tmp_path, 25)
    with pytest.warns(UserWarning, match="of the 67 joints in the files only those of skeleton body_25 are used"):
        assert load_people(tmp_path, RIG, "body_25", fps=50.0).skeleton.n_joints == 25
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_people(tmp_path, RIG, "openpose_67", fps=50.0).skeleton.n_joints == 67


@pytest.mark.parametrize("case", NOT_SAID)
def test_where_nothing_tells_the_likely_ones_are_said(case: str, tmp_path: Path) -> None:
    write, n_joints, message = NOT_SAID[case]
    write(tmp_path, n_joints)
    with pytest.raises(ValueError, match=message) as error:
        stated_skeleton(tmp_path)
    assert str(error.value).startswith(f"{tmp_path}: ")
    assert "--skeleton" in str(error.value)


@pytest.mark.parametrize("extension", ["npz", "parquet"])
@pytest.mark.parametrize("skeleton", [fgpose.load_skeleton("body_25b"), MINE], ids=["built-in", "my own"])
def test_our_own_files_hold_it(extension: str, skeleton: Skeleton, tmp_path: Path) -> None:
    of_one, of_all = tmp_path / f"one.{extension}", tmp_path / f"all.{extension}"
    save_observations(seen(skeleton), of_one)
    save_people_observations(PeopleObservations.of_one(seen(skeleton)), of_all)
    for path in (of_one, of_all):
        assert stated_skeleton(path) == skeleton
        assert load_people(path, RIG).skeleton == skeleton


def test_files_of_earlier_versions_have_the_names_of_the_joints(tmp_path: Path) -> None:
    path = tmp_path / "seen.npz"
    for skeleton in (fgpose.load_skeleton("h36m_17_lt"), MINE):
        save_observations(seen(skeleton), path)
        arrays = read_arrays(path)
        del arrays["skeleton"]
        write_arrays(path, arrays)
        if skeleton is not MINE:
            assert stated_skeleton(path) == skeleton
    with pytest.raises(
        ValueError, match=r"no skeleton that comes with fgpose has its joints \(hip, knee, foot\); give"
    ):
        stated_skeleton(path)
    for damaged in (["{"], np.empty(0, dtype="<U1")):
        write_arrays(path, arrays | {"skeleton": np.array(damaged)})
        with pytest.raises(ValueError, match=r"seen.npz: its skeleton is damaged"):
            stated_skeleton(path)


@pytest.mark.slow
def test_commands_need_no_skeleton(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, observations = fgpose.files.load_recording("balance_openpose")
    save_rig(rig, tmp_path / "Calib.toml")
    few = observations.frames(slice(0, 8))
    save_observations(few, tmp_path / "walk.npz")
    save_observations(replace(few, skeleton=renamed(few.skeleton)), tmp_path / "mine.parquet")
    for name in ("walk.npz", "mine.parquet"):
        told = [str(tmp_path / name), "--rig", str(tmp_path / "Calib.toml")]
        assert main(["smooth", *told, "-o", str(tmp_path / "out"), "--formats", "npz"]) == 0
        assert main(["info", *told]) == 0
    assert "body_25b" in capsys.readouterr().out
    assert fgpose.load_trajectory(tmp_path / "out" / "mine.npz").skeleton.name == "mine"


def renamed(skeleton: Skeleton) -> Skeleton:
    return replace(skeleton, name="mine")
