"""Outputs of SAM 3D Body and NLF, written from a known motion in every way in which users save them."""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from network_outputs import (
    FPS,
    MHR,
    N_FRAMES,
    SAVES,
    SMPL,
    body_m,
    sam3d_people,
    save_npz,
    save_pickle,
    save_torch,
    stacked,
)

from fgpose.cli import main
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import keypoint_cameras, load_observations, load_people, load_uncalibrated
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

COCO = load_skeleton("coco_17")
TRUTH_M = body_m(MHR.joints)
# Single precision of pixels, 1e-4 px at 1145 px, is 1e-6 of the depth; of it the spread of the joints, 0.1, makes 1e-5.
EXACT_M = 1e-3


def load(folder: Path, rig: CameraRig, skeleton: Any = MHR) -> tuple[Observations, list[str]]:
    """What is read, and what is said."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        observations = load_observations(folder, rig, skeleton, fps=FPS)
    return observations, [str(each.message) for each in said]


def assert_true(observations: Observations, rig: CameraRig, points_m: np.ndarray = TRUTH_M) -> None:
    """All views have the true joints, in 2D and in 3D."""
    assert observations.points3d_m is not None
    np.testing.assert_allclose(observations.points3d_m, np.repeat(points_m[:, None], rig.n_cameras, 1), atol=EXACT_M)
    np.testing.assert_allclose(observations.points2d_px, rig.project(points_m), atol=1e-2)
    assert observations.covariance3d_m2 is not None


def write_cameras(folder: Path, rig: CameraRig, write: Callable[[list[dict[str, Any]], Camera], None]) -> Path:
    for camera in rig.cameras:
        write(sam3d_people(TRUTH_M, camera), camera)
    return folder


@pytest.mark.parametrize("form", SAVES)
@pytest.mark.parametrize("nested", ["one person", "people of the image"])
def test_one_file_for_each_image(tmp_path: Path, rig: CameraRig, form: str, nested: str) -> None:
    suffix, save = SAVES[form]

    def write(people: list[dict[str, Any]], camera: Camera) -> None:
        (tmp_path / camera.name).mkdir()
        for frame, person in enumerate(people):
            document = person if nested == "one person" else [person]
            save(document, tmp_path / camera.name / f"{frame:06d}_sam3d_body{suffix}")

    observations, said = load(write_cameras(tmp_path, rig, write), rig)
    assert_true(observations, rig)
    assert keypoint_cameras(tmp_path) == rig.names
    assert len(said) == 1
    assert "SAM 3D Body states no confidence" in said[0]
    assert (observations.confidence == 0.5).all()


NESTS: dict[str, Callable[[Any], Any]] = {
    "list of people": lambda people: people,
    "list of images": lambda people: [[each] for each in people],
    "table of frames": lambda people: {
        "video_info": {"fps": FPS},
        "frames": [{"frame_idx": f, "people": [p]} for f, p in enumerate(people)],
    },
    "by image": lambda people: {f"image_{frame:04d}.jpg": [person] for frame, person in enumerate(people)},
    "stacked": stacked,
    "stacked with people": lambda people: {key: value[:, None] for key, value in stacked(people).items()},
}


@pytest.mark.parametrize(
    ("form", "nest"),
    [*((form, "stacked") for form in SAVES), *(("pickle", nest) for nest in NESTS if nest != "stacked")],
)
def test_one_file_for_each_camera(tmp_path: Path, rig: CameraRig, form: str, nest: str) -> None:
    suffix, save = SAVES[form]
    write_cameras(tmp_path, rig, lambda people, camera: save(NESTS[nest](people), tmp_path / f"{camera.name}{suffix}"))
    assert_true(load(tmp_path, rig)[0], rig)


def test_stacked_in_plain_npz_with_numbers_of_frames(tmp_path: Path, rig: CameraRig) -> None:
    def write(people: list[dict[str, Any]], camera: Camera) -> None:
        save_npz(stacked(people) | {"frame": 10 + 2 * np.arange(N_FRAMES)}, tmp_path / f"{camera.name}.npz")

    observations, _ = load(write_cameras(tmp_path, rig, write), rig)
    assert_true(observations, rig)
    np.testing.assert_allclose(observations.frame_time_s, (10 + 2 * np.arange(N_FRAMES)) / FPS)


def test_several_people_and_images_without_anybody(tmp_path: Path, rig: CameraRig) -> None:
    """A file for each person in some images, a list of them in others, an empty list where nobody is."""
    others_m = TRUTH_M + np.array([0.7, 0.0, 0.0])
    for camera in rig.cameras:
        folder = tmp_path / camera.name
        folder.mkdir()
        both = list(zip(sam3d_people(TRUTH_M, camera), sam3d_people(others_m, camera), strict=True))
        for number, person in enumerate(both[0]):
            save_npz({k: v for k, v in person.items() if v is not None}, folder / f"frame_0000_person_{number:03d}.npz")
        save_pickle(list(both[1]), folder / "frame_0001.pkl")
        save_pickle([], folder / "frame_0002.pkl")
        save_torch(list(both[3]), folder / "frame_0003.pt")
    with pytest.warns(UserWarning, match="no confidence"):
        people = load_people(tmp_path, rig, MHR, fps=FPS)
    assert [image.n_people for image in people.by_camera[rig.names[0]]] == [2, 2, 0, 2]
    for image, frame in zip(people.by_camera[rig.names[2]], range(N_FRAMES), strict=True):
        if image.n_people:
            assert image.points3d_m is not None
            np.testing.assert_allclose(image.points3d_m, [TRUTH_M[frame], others_m[frame]], atol=EXACT_M)


@pytest.mark.parametrize("by_number", [True, False])
def test_tracks_of_people_with_numbers_of_frames(tmp_path: Path, rig: CameraRig, by_number: bool) -> None:
    """Somebody from the first image on, somebody else from the third."""
    others_m = TRUTH_M + np.array([0.7, 0.0, 0.0])
    for camera in rig.cameras:
        first = stacked(sam3d_people(TRUTH_M, camera)) | {"frame": np.arange(N_FRAMES)}
        second = stacked(sam3d_people(others_m[2:], camera)) | {"frame": np.arange(2, N_FRAMES)}
        save_pickle({1: first, 2: second} if by_number else [first, second], tmp_path / f"{camera.name}.pkl")
    with pytest.warns(UserWarning, match="no confidence"):
        people = load_people(tmp_path, rig, MHR, fps=FPS)
    assert [image.n_people for image in people.by_camera[rig.names[1]]] == [1, 1, 2, 2]
    last = people.by_camera[rig.names[1]][-1].points3d_m
    assert last is not None
    np.testing.assert_allclose(last, [TRUTH_M[-1], others_m[-1]], atol=EXACT_M)


def test_the_joints_of_another_skeleton_are_taken(tmp_path: Path, rig: CameraRig) -> None:
    write_cameras(tmp_path, rig, lambda people, camera: save_pickle(people, tmp_path / f"{camera.name}.pkl"))
    observations, said = load(tmp_path, rig, COCO)
    assert_true(observations, rig, TRUTH_M[:, [MHR.index(joint) for joint in COCO.joints]])
    assert any("of the 70 joints in the files only those of skeleton coco_17" in each for each in said)


# What is found and said


@pytest.mark.parametrize("focal_ratio", [0.8, 1.3])
def test_another_focal_length_is_found_and_depth_solved_anew(
    tmp_path: Path, rig: CameraRig, focal_ratio: float
) -> None:
    for camera in rig.cameras:
        save_pickle(sam3d_people(TRUTH_M, camera, focal_ratio), tmp_path / f"{camera.name}.pkl")
    observations, said = load(tmp_path, rig)
    assumed_px = focal_ratio * rig.cameras[0].K[0, 0]
    assert any(
        f"assumed other focal lengths than the calibration has ({rig.names[0]} {assumed_px:.0f}" in s for s in said
    )
    assert observations.points3d_m is not None
    error_m = np.linalg.norm(observations.points3d_m - TRUTH_M[:, None], axis=-1)
    # Its own distances are off by 20 and 30 %, 0.9 and 1.35 m. The perspective of the assumed focal length is left in
    # the 2D, some pixels.
    assert np.median(error_m) < 0.06
    assert np.isfinite(observations.points3d_m).all()


@pytest.mark.parametrize("focal_ratio", [1.0, 1.25])
@pytest.mark.parametrize("given", ["camera", "world", "nowhere"])
def test_absolute_world_and_relative_are_told_apart_by_projecting(
    tmp_path: Path, rig: CameraRig, given: str, focal_ratio: float
) -> None:
    for camera in rig.cameras:
        people = sam3d_people(TRUTH_M, camera, focal_ratio)
        for person in people:
            absolute_m = person["pred_keypoints_3d"] + person["pred_cam_t"]
            if given == "nowhere":
                del person["pred_cam_t"]
            else:
                person["pred_keypoints_3d"] = camera.to_world_frame(absolute_m) if given == "world" else absolute_m
        save_pickle(people, tmp_path / f"{camera.name}.pkl")
    observations, said = load(tmp_path, rig)
    words = {"camera": "absolute in the frame of each camera", "world": "in the world of the calibration"}
    assert any(words.get(given, "relative to the body and have no translation") in each for each in said)
    if focal_ratio == 1.0:
        assert_true(observations, rig)
    else:
        assert observations.points3d_m is not None
        assert np.median(np.linalg.norm(observations.points3d_m - TRUTH_M[:, None], axis=-1)) < 0.06


def test_joints_that_belong_to_other_pixels_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    for camera in rig.cameras:
        people = sam3d_people(TRUTH_M, camera)
        for person in people:
            person["pred_keypoints_3d"] = person["pred_keypoints_3d"] * np.array([1, -1, -1], np.float32)
        save_pickle(people, tmp_path / f"{camera.name}.pkl")
    with pytest.raises(
        ValueError, match=f"camera {rig.names[0]}: its 3D joints do not project onto its 2D joints"
    ) as e:
        load(tmp_path, rig)
    assert str(e.value).startswith(str(tmp_path))


def test_what_is_no_number_is_left_out(tmp_path: Path, rig: CameraRig) -> None:
    """Of one camera all 3D, of the others that of one image; a focal length that is none is as if it were not there."""
    for camera in rig.cameras:
        people = sam3d_people(TRUTH_M, camera)
        for frame, person in enumerate(people):
            person["focal_length"] = np.float32(-1.0 if frame else np.nan)
            if camera is rig.cameras[0] or frame == 1:
                person["pred_keypoints_3d"] = np.full((70, 3), np.nan, np.float32)
        save_pickle(people, tmp_path / f"{camera.name}.pkl")
    observations, said = load(tmp_path, rig)
    np.testing.assert_allclose(observations.points2d_px, rig.project(TRUTH_M), atol=1e-2)
    assert observations.points3d_m is not None
    known = np.isfinite(observations.points3d_m).all(axis=(2, 3))
    np.testing.assert_array_equal(known, np.outer(np.arange(N_FRAMES) != 1, np.arange(rig.n_cameras) != 0))
    assert not any("focal" in each for each in said)
    for camera in rig.cameras:
        people = sam3d_people(TRUTH_M, camera)
        for person in people:
            person["pred_keypoints_3d"] = np.full((70, 3), np.nan, np.float32)
        save_pickle(people, tmp_path / f"{camera.name}.pkl")
    with pytest.raises(ValueError, match="none of the 3D joints of SAM 3D Body is a number"):
        load(tmp_path, rig)


def test_joints_beyond_the_border_are_no_detections(tmp_path: Path, rig: CameraRig) -> None:
    away_m = TRUTH_M + np.array([0.0, 0.0, 1.7])
    for camera in rig.cameras:
        save_pickle(sam3d_people(away_m, camera), tmp_path / f"{camera.name}.pkl")
    observations, said = load(tmp_path, rig)
    true_px, size_px = rig.project(away_m), rig.cameras[0].size_px
    outside = np.any((true_px < 0) | (true_px > np.array(size_px) - 1), axis=-1)
    assert 0.05 < outside.mean() < 0.6
    assert np.isnan(observations.points2d_px[outside]).all()
    assert (observations.confidence[outside] == 0).all()
    assert np.isfinite(observations.points2d_px[~outside]).all()
    assert any("missing or uncertain" in each and "cut by the border" in each for each in said)


def test_without_a_calibration_only_2d_is_used(tmp_path: Path, rig: CameraRig) -> None:
    write_cameras(tmp_path, rig, lambda people, camera: save_pickle(people, tmp_path / f"{camera.name}.pkl"))
    with pytest.warns(UserWarning, match="not used without a calibration"):
        people = load_uncalibrated(tmp_path, MHR, fps=FPS)
    assert all(image.points3d_m is None and image.n_people == 1 for image in people.images)


# NLF


def nlf(camera: Camera, unit: float, *, parametric: bool) -> dict[str, Any]:
    """As detect_smpl_batched returns it: lists of the people of each image."""
    truth_m = body_m(SMPL.joints)
    in_camera = camera.to_camera_frame(truth_m) / unit
    uncertainty_m = np.where(np.arange(SMPL.n_joints) == SMPL.index("left_wrist"), 0.2, 0.05)
    keys = ("joints3d", "joints2d") if parametric else ("joints3d_nonparam", "joints2d_nonparam")
    document = {
        keys[0]: [each[None] for each in in_camera],
        keys[1]: [each[None] for each in camera.project(truth_m)],
        "joint_uncertainties": [uncertainty_m[None]] * N_FRAMES,
    }
    if not parametric:
        # Of the body model that was fitted: not used.
        document |= {"joints3d": [0.9 * each for each in document[keys[0]]], "joints2d": document[keys[1]]}
    return document


@pytest.mark.parametrize("form", ["pickle", "torch tensors", "json"])
@pytest.mark.parametrize(("unit", "parametric"), [(1e-3, False), (1e-3, True), (1.0, False)])
def test_nlf_in_millimetres_and_metres(
    tmp_path: Path, rig: CameraRig, form: str, unit: float, parametric: bool
) -> None:
    suffix, save = SAVES[form]
    for camera in rig.cameras:
        save(nlf(camera, unit, parametric=parametric), tmp_path / f"{camera.name}{suffix}")
    observations, said = load(tmp_path, rig, SMPL)
    assert_true(observations, rig, body_m(SMPL.joints))
    assert any("taken as millimetres" in each for each in said) == (unit == 1e-3)
    assert not any("no confidence" in each for each in said)
    wrist, other = SMPL.index("left_wrist"), SMPL.index("right_wrist")
    # 1 / (1 + (sigma / 0.1 m)^2)
    np.testing.assert_allclose(observations.confidence[..., wrist], 0.2)
    np.testing.assert_allclose(observations.confidence[..., other], 0.8)
    assert observations.covariance3d_m2 is not None
    trace = np.trace(observations.covariance3d_m2, axis1=-2, axis2=-1)
    # The depth of the whole body is unsure by 4.5 % of 4.5 m, 0.2 m; that of the wrists by 0.2 and 0.05 m more.
    assert (trace[..., wrist] - trace[..., other] > 0.5 * (0.2**2 - 0.05**2)).all()


@pytest.mark.parametrize("form", ["pickle", "torch tensors", "json"])
def test_nlf_of_another_number_of_people_in_each_image(tmp_path: Path, rig: CameraRig, form: str) -> None:
    suffix, save = SAVES[form]
    n_people = (1, 2, 0, 1)
    for camera in rig.cameras:
        document = nlf(camera, 1e-3, parametric=False)
        rows = [np.zeros(n, int) for n in n_people]
        of_images = {key: [each[row] for each, row in zip(of, rows, strict=True)] for key, of in document.items()}
        save(of_images, tmp_path / f"{camera.name}{suffix}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        people = load_people(tmp_path, rig, SMPL, fps=FPS)
    assert tuple(image.n_people for image in people.by_camera[rig.names[0]]) == n_people


@pytest.mark.parametrize("form", ["pickle", "npz", "json"])
def test_nlf_of_joints_that_were_asked_for(tmp_path: Path, rig: CameraRig, form: str) -> None:
    """As estimate_poses_batched returns them: without the uncertainties they are MeTRAbs's."""
    truth_m = TRUTH_M[:, :20]
    skeleton = Skeleton("twenty", MHR.joints[:20], bones=((0, 1),), root=(0,))
    suffix, save = {**SAVES, "npz": (".npz", save_npz)}[form]
    for camera in rig.cameras:
        document = {
            "poses3d": 1000 * camera.to_camera_frame(truth_m)[:, None],
            "poses2d": camera.project(truth_m)[:, None],
            "uncertainties": np.full((N_FRAMES, 1, 20), 0.1),
        }
        save(document, tmp_path / f"{camera.name}{suffix}")
    observations, _ = load(tmp_path, rig, skeleton)
    assert_true(observations, rig, truth_m)
    np.testing.assert_allclose(observations.confidence, 0.5)


def test_other_files_beside_keypoints_are_left_alone(tmp_path: Path, rig: CameraRig) -> None:
    """Weights in a folder of their own, and images as JSON that say their number themselves."""
    (tmp_path / "weights").mkdir()
    save_torch({"layer": np.zeros((3, 3))}, tmp_path / "weights" / "model.pt")
    for camera in rig.cameras:
        (tmp_path / camera.name).mkdir()
        for frame, person in enumerate(sam3d_people(TRUTH_M, camera)):
            document = {"frame_id": frame, "people": [person]}
            SAVES["json"][1](document, tmp_path / camera.name / f"{frame:06d}.json")
    observations, _ = load(tmp_path, rig)
    assert_true(observations, rig)


# What is refused


class Evil:
    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.trace),)


@pytest.mark.parametrize("form", ["pickle", "torch arrays", "objects in npz"])
def test_code_in_a_file_does_not_run(tmp_path: Path, rig: CameraRig, form: str) -> None:
    suffix, save = SAVES[form]
    trace = tmp_path / "trace"
    for camera in rig.cameras:
        save([{"pred_keypoints_3d": Evil(trace)}], tmp_path / f"{camera.name}{suffix}")
    with pytest.raises(ValueError, match=rf"{rig.names[0]}\{suffix}, camera .*not safe to load.*\.mkdir"):
        load(tmp_path, rig)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Evil(trace)))
    assert trace.exists()


@pytest.mark.parametrize(
    ("network", "document"),
    [
        (
            "GVHMR",
            {"smpl_params_global": {"transl": np.zeros((4, 3))}, "smpl_params_incam": {}},
        ),
        ("WHAM", {0: {"pose_world": np.zeros((4, 72)), "trans_world": np.zeros((4, 3)), "frame_ids": np.arange(4)}}),
        ("TRAM", {"pred_rotmat": np.zeros((4, 24, 3, 3)), "pred_trans": np.zeros((4, 1, 3)), "frame": np.arange(4)}),
    ],
)
@pytest.mark.parametrize("form", ["pickle", "torch tensors", "json", "objects in npz"])
def test_bodies_in_a_world_of_their_own_are_refused_by_name(
    tmp_path: Path, rig: CameraRig, network: str, document: Any, form: str
) -> None:
    suffix, save = SAVES[form]
    for camera in rig.cameras:
        save(document, tmp_path / f"{camera.name}{suffix}")
    with pytest.raises(
        ValueError, match=rf"{rig.names[0]}\{suffix}.*: of {network}, which gives a body model in a world"
    ):
        load(tmp_path, rig)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda person: person.pop("pred_keypoints_2d"), "pred_keypoints_2d is missing: the 2D joints are needed too"),
        (lambda person: person.update(pred_keypoints_2d=np.zeros((69, 2))), r"got \(70, 3\) and \(69, 2\)"),
        (lambda person: person.update(pred_cam_t=np.zeros(2)), r"pred_cam_t must be \(1, 3\), got \(2,\)"),
        (lambda person: person.update(pred_keypoints_3d="here"), "pred_keypoints_3d is not an array of numbers"),
        (lambda person: person.pop("pred_keypoints_3d"), "no joints of a network that is known here: it has "),
    ],
)
def test_what_does_not_fit_is_one_clear_error(
    tmp_path: Path, rig: CameraRig, change: Callable[[dict[str, Any]], Any], message: str
) -> None:
    for camera in rig.cameras:
        people = sam3d_people(TRUTH_M, camera)
        for person in people:
            change(person)
        save_pickle(people, tmp_path / f"{camera.name}.pkl")
    with pytest.raises(ValueError, match=message) as error:
        load(tmp_path, rig)
    assert str(tmp_path / f"{rig.names[0]}.pkl") in str(error.value)


def test_the_images_of_one_camera_are_not_those_of_all(tmp_path: Path, rig: CameraRig) -> None:
    for frame, person in enumerate(sam3d_people(TRUTH_M, rig.cameras[0])):
        save_pickle(person, tmp_path / f"{frame:06d}.pkl")
    with pytest.raises(ValueError, match="a single image, where files of a whole camera are expected"):
        load(tmp_path, rig)


def test_two_files_of_one_frame_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    for camera in rig.cameras:
        (tmp_path / camera.name).mkdir()
        for name in ("000001.pkl", "000001.pt", "000002.pkl"):
            save = save_torch if name.endswith("pt") else save_pickle
            save(sam3d_people(TRUTH_M, camera)[0], tmp_path / camera.name / name)
    with pytest.raises(ValueError, match="another file has the same frame number"):
        load(tmp_path, rig)


def test_damaged_files_are_refused_wherever_they_end(tmp_path: Path, rig: CameraRig) -> None:
    write_cameras(tmp_path, rig, lambda people, camera: save_torch(people, tmp_path / f"{camera.name}.pt"))
    path = tmp_path / f"{rig.names[1]}.pt"
    content = path.read_bytes()
    for length in range(0, len(content) - 1, len(content) // 20):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match=path.name):
            load(tmp_path, rig)


@pytest.mark.filterwarnings("default::UserWarning")
def test_smooth_takes_the_files_and_says_what_was_found(
    tmp_path: Path, rig: CameraRig, capsys: pytest.CaptureFixture[str]
) -> None:
    """A focal length too long by a quarter, in all cameras; files of torch."""
    truth_m = body_m(MHR.joints, 20)[:, [MHR.index(joint) for joint in COCO.joints]]
    save_rig(rig, tmp_path / "Calib.toml")
    (tmp_path / "sam3d").mkdir()
    for camera in rig.cameras:
        save_torch(sam3d_people(body_m(MHR.joints, 20), camera, 1.25), tmp_path / "sam3d" / f"{camera.name}.pt")
    files = [str(tmp_path / "sam3d"), "--rig", str(tmp_path / "Calib.toml"), "--output", str(tmp_path)]
    assert main(["smooth", *files, "--skeleton", "coco_17", "--fps", f"{FPS}", "--formats", "parquet"]) == 0
    printed = " ".join("".join(capsys.readouterr()).split())
    assert "the network assumed other focal lengths than the calibration has" in printed
    assert "states no confidence" in printed
    positions_m = load_trajectory(tmp_path / "sam3d.parquet").positions_m
    # The perspective of the assumed focal length is left in the 2D, some pixels of 4 mm, which cameras around the
    # person have on different sides.
    assert np.nanmedian(np.linalg.norm(positions_m - truth_m, axis=-1)) < 0.01
