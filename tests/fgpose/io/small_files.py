"""Small sound files of every format that fgpose reads, each with its reader."""

from __future__ import annotations

import importlib
import json
import pickle
import shutil
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from network_outputs import Save, sam3d_people, save_json, save_npz, save_objects, save_pickle, save_torch, stacked

from fgpose.association.track import TrackEvent
from fgpose.config import Config, config_to_toml, load_config
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_calibration_origin, load_intrinsics, load_rig, save_rig
from fgpose.io.keypoints import load_observations, load_people, save_observations, save_people_observations
from fgpose.io.keypoints.stated_skeleton import stated_skeleton
from fgpose.io.live.packing import packed
from fgpose.io.live.record_files import MAGIC, as_record
from fgpose.io.live.recordings import RecordedImage, images_document, start_document
from fgpose.io.origin import CalibrationOrigin, InputFile, MovedCamera, Origin, Reason
from fgpose.io.skeletons import load_skeleton
from fgpose.io.studies.events import read_events
from fgpose.io.trajectories import load_origin, load_people_trajectories, load_trajectory, save_people, save_trajectory
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics
from fgpose.kinematics.angles import joint_angles
from fgpose.kinematics.poses import segment_poses
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.monocular.detection_cache import ViewDetections, load_detections, store_detections
from fgpose.monocular.network import People
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.plain_files import naming
from fgpose.report.quality import quality
from fgpose.robot.cell import load_cell
from fgpose.skeleton import LIMBS, Skeleton
from fgpose.study.study import load_study
from fgpose.trajectory import Convergence, Status, Trajectory
from fgpose_benchmarks.comparison.scores import Score, load_scores, save_scores
from fgpose_benchmarks.human36m.predictions import load_predictions
from fgpose_benchmarks.synthetic import motion_from_npz, ring_rig, walking

TESTS = Path(__file__).parents[2]
DATA = TESTS / "data"
_BONES = ((0, 1), (1, 2), (3, 4), (4, 5), (0, 3))
STICK = Skeleton(
    "stick",
    ("pelvis", "left_knee", "left_ankle", "neck", "left_elbow", "left_wrist"),
    bones=_BONES,
    root=(0,),
)
N_FRAMES = 4


@dataclass(frozen=True)
class Format:
    """A way to write files and to read them."""

    name: str
    kind: str
    """Which mutations suit it."""
    make: Callable[[Path], Any]
    """Writes its files into an empty folder."""
    read: Callable[[Path], Any]
    """Reads what is in the folder. Raises ValueError or OSError that names a file, or the folder."""


def trajectory() -> Trajectory:
    rng = np.random.default_rng(0)
    positions_m = rng.normal(size=(N_FRAMES, STICK.n_joints, 3))
    status = np.full((N_FRAMES, STICK.n_joints), Status.OBSERVED)
    positions_m[1, 2], status[1, 2] = np.nan, Status.UNOBSERVABLE
    return Trajectory(
        STICK,
        time_s=2.0 + np.arange(N_FRAMES) / 50,
        positions_m=positions_m,
        status=status,
        covariance_m2=np.broadcast_to(1e-4 * np.eye(3), (N_FRAMES, STICK.n_joints, 3, 3)).copy(),
        residual_px=rng.uniform(0, 5, (N_FRAMES, 2, STICK.n_joints)),
        camera_names=("cam_1", "cam_2"),
        bone_lengths_m=np.linspace(0.2, 0.5, STICK.n_lengths),
        bone_length_sigma_m=np.linspace(0.004, 0.01, STICK.n_lengths),
        convergence=Convergence(True, 7, 10.0, 1.0),
        config=Config(),
        visibility=rng.uniform(size=(N_FRAMES, 2, STICK.n_joints)),
    )


def walk() -> Trajectory:
    """With a trunk and limbs, which have angles."""
    positions_m = walking(N_FRAMES, 50.0)
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    return Trajectory(load_skeleton("h36m_17"), np.arange(N_FRAMES) / 50, positions_m, status)


def _kinematics(extension: str) -> Callable[[Path], Any]:
    return lambda folder: save_kinematics(walk(), folder / f"angles{extension}")


def assert_same(actual: Any, expected: Any) -> None:
    """Of two dataclasses of arrays: every field is the same, exactly; a table numbers frames that have no number."""
    for field in fields(expected):
        a, b = getattr(actual, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=field.name)
        elif field.name != "frame_numbers":
            assert a == b, field.name


def rig() -> CameraRig:
    cameras = ring_rig().cameras[:2]
    return CameraRig(cameras)


def points_px() -> np.ndarray:
    return np.random.default_rng(1).uniform(100, 900, (N_FRAMES, 2, STICK.n_joints, 2))


def recording() -> Observations:
    rng = np.random.default_rng(2)
    points3d_m = rng.normal(size=(N_FRAMES, 2, STICK.n_joints, 3))
    return Observations(
        STICK,
        time_s=np.arange(N_FRAMES) / 50,
        points2d_px=points_px(),
        confidence=rng.uniform(0.2, 1.0, (N_FRAMES, 2, STICK.n_joints)),
        points3d_m=points3d_m,
        camera_names=rig().names,
        covariance3d_m2=np.broadcast_to(0.01 * np.eye(3), (*points3d_m.shape, 3)).copy(),
    )


def everybody() -> PeopleObservations:
    """Two people and nobody by turns; the cameras take turns too."""
    of_one, images = recording(), []
    for t, c in np.ndindex(N_FRAMES, 2):
        n_people = 2 * ((t + c) % 2)
        two = of_one.per_detection(lambda array, t=t, c=c, n=n_people: array[[t, t - 1], c][:n])
        images.append(Detections(rig().names[c], (2 * t + c) / 100, **two))
    return PeopleObservations(STICK, rig().names, tuple(images))


def origin() -> Origin:
    return Origin(
        inputs=(
            InputFile("Keypoints", "/nowhere/seen.npz", 123),
            InputFile("Video", "/nowhere/cam_1.mp4", 9_000_000_000, "cam_1", (1920, 1080), 59.94),
        ),
        rig=rig(),
        calibration=CalibrationOrigin(
            {"cam_2": 0.0012},
            (MovedCamera("cam_1", 0.5, 0.012),),
            "coarse",
            (Reason("cam_2", "coarse", "the focal length is not determined", "walk towards the camera"),),
            shift_sigma_m=0.025,
        ),
        events=(TrackEvent(1.25, 3, "recognised", "lengths of the bones"),),
        fps=50.0,
        command="fgpose smooth seen.npz",
        fgpose="1.0",
    )


def _make_people_trajectories(folder: Path) -> None:
    late = replace(trajectory(), time_s=trajectory().time_s + 1 / 50, convergence=None)
    save_people({3: trajectory(), 1: late}, folder / "people.parquet", origin=origin())


def _people(frame: int, camera: int) -> list[dict[str, Any]]:
    points = points_px()[frame, camera]
    flat = np.concatenate([points, np.full((STICK.n_joints, 1), 0.7)], axis=1).ravel().tolist()
    return [
        {"points": points.tolist(), "scores": [0.7] * STICK.n_joints, "flat": flat},
        {"points": (points + 300).tolist(), "scores": [0.6] * STICK.n_joints, "flat": [*flat[:-1], 0.5]},
    ]


def _each_camera(folder: Path, document: Callable[[int], Any]) -> None:
    for camera, name in enumerate(rig().names):
        (folder / f"{name}.json").write_text(json.dumps(document(camera)))


def _make_openpose(folder: Path) -> None:
    for camera, name in enumerate(rig().names):
        (folder / f"{name}_json").mkdir()
        for frame in range(N_FRAMES):
            people = [{"person_id": [-1], "pose_keypoints_2d": each["flat"]} for each in _people(frame, camera)]
            path = folder / f"{name}_json" / f"{name}_{frame:012d}_keypoints.json"
            path.write_text(json.dumps({"version": 1.3, "people": people}))


def _mmpose(frame: int, camera: int) -> list[dict[str, Any]]:
    return [{"keypoints": each["points"], "keypoint_scores": each["scores"]} for each in _people(frame, camera)]


def _make_mmpose_images(folder: Path) -> None:
    for camera, name in enumerate(rig().names):
        (folder / name).mkdir()
        for frame in range(N_FRAMES):
            (folder / name / f"{frame:06d}.json").write_text(json.dumps(_mmpose(frame, camera)))


def _make_mmpose(folder: Path) -> None:
    def document(camera: int) -> dict[str, Any]:
        images = [{"frame_id": frame, "instances": _mmpose(frame, camera)} for frame in range(N_FRAMES)]
        return {"meta_info": {"dataset_name": "stick"}, "instance_info": images}

    _each_camera(folder, document)


def _make_mmpose_frames(folder: Path) -> None:
    """Of the inferencer, with scores of RTMW."""

    def document(camera: int) -> list[dict[str, Any]]:
        scores = [9.0] * STICK.n_joints
        return [
            {"frame_id": frame, "instances": [each | {"keypoint_scores": scores} for each in _mmpose(frame, camera)]}
            for frame in range(N_FRAMES)
        ]

    _each_camera(folder, document)


def _make_deeplabcut(folder: Path) -> None:
    for camera, name in enumerate(rig().names):
        cells = [(joint, kind) for joint in STICK.joints for kind in ("x", "y", "likelihood")]
        rows = [["scorer", *("DLC" for _ in cells)]]
        rows += [["bodyparts", *(joint for joint, _ in cells)], ["coords", *(kind for _, kind in cells)]]
        rows += [[str(frame), *map(str, _people(frame, camera)[0]["flat"])] for frame in range(N_FRAMES)]
        (folder / f"{name}DLC_resnet50.csv").write_text("\n".join(map(",".join, rows)) + "\n")


def _make_freemocap(folder: Path) -> None:
    np.save(folder / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", points_px().swapaxes(0, 1))


def _make_coco(folder: Path) -> None:
    def document(camera: int) -> list[dict[str, Any]]:
        names = [frame if frame % 2 else f"images/{frame:06d}.jpg" for frame in range(N_FRAMES)]
        return [
            {"image_id": name, "category_id": 1, "keypoints": each["flat"], "score": 0.9}
            for frame, name in enumerate(names)
            for each in _people(frame, camera)
        ]

    _each_camera(folder, document)


def _metrabs(camera: int) -> dict[str, Any]:
    points = points_px()[:, camera, None]
    boxes = np.full((N_FRAMES, 1, 5), 0.9)
    poses3d = np.random.default_rng(3).normal([0, 0, 4000], 500, (*points.shape[:-1], 3))
    return {"poses2d": points, "poses3d": poses3d, "boxes": boxes, "frame": np.arange(N_FRAMES)}


def _make_metrabs_json(folder: Path) -> None:
    _each_camera(folder, lambda camera: {name: array.tolist() for name, array in _metrabs(camera).items()})


def _make_metrabs_npz(folder: Path) -> None:
    for camera, name in enumerate(rig().names):
        np.savez(folder / f"{name}.npz", **_metrabs(camera))


def _save_stacked(people: Any, path: Path) -> None:
    save_npz(stacked(people), path)


def _network(extension: str, save: Save) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        points_m = np.random.default_rng(4).normal([0, 0, 1], 0.5, (N_FRAMES, STICK.n_joints, 3))
        for camera in rig().cameras:
            save(sam3d_people(points_m, camera), folder / f"{camera.name}{extension}")

    return make


def _read_keypoints(folder: Path) -> Observations:
    with warnings.catch_warnings():
        # What was changed to read them is said.
        warnings.simplefilter("ignore", UserWarning)
        with suppress(ValueError):  # the files of these joints, which are nobody's, do not say what they are
            stated_skeleton(folder)
        return load_observations(folder, rig(), STICK, fps=50.0)


def _known_rig(extension: str) -> Callable[[Path], None]:
    return lambda folder: save_rig(rig(), folder / f"rig{extension}", origin=origin().calibration)


def _make_easymocap(folder: Path) -> None:
    intrinsics, extrinsics = (["%YAML:1.0", "---", "names:", '   - "cam_1"', '   - "cam_2"'] for _ in range(2))
    for camera, name in zip(rig().cameras, ("cam_1", "cam_2"), strict=True):
        camera_T_world = camera.camera_T_world
        intrinsics += _matrix(f"K_{name}", camera.K) + _matrix(f"dist_{name}", np.zeros((1, 5)))
        intrinsics += [f"H_{name}: {camera.size_px[1]}", f"W_{name}: {camera.size_px[0]}"]
        extrinsics += _matrix(f"Rot_{name}", camera_T_world[:3, :3]) + _matrix(f"T_{name}", camera_T_world[:3, 3:])
    (folder / "intri.yml").write_text("\n".join(intrinsics) + "\n")
    (folder / "extri.yml").write_text("\n".join(extrinsics) + "\n")


def _matrix(name: str, values: np.ndarray) -> list[str]:
    rows, columns = values.shape
    data = ", ".join(f"{value:.17g}" if value % 1 else f"{value:.0f}." for value in values.ravel())
    return [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {data} ]"]


_SKELETON = {
    "name": "stick",
    "joints": [*STICK.joints, "right_knee", "right_ankle", "right_elbow", "right_wrist"],
    "root": ["pelvis"],
    "bones": [["left_knee", "left_ankle"], ["right_knee", "right_ankle"], ["pelvis", "neck"]],
    "lines": [["neck", "left_elbow"]],
    "left_right": [["left_knee", "right_knee"], ["left_ankle", "right_ankle"]],
    "limbs": {LIMBS[3]: ["left_knee", "left_ankle"]},
}


def _make_skeleton(folder: Path) -> None:
    import tomli_w

    (folder / "skeleton.toml").write_text(tomli_w.dumps(_SKELETON))


def _make_motion(folder: Path) -> None:
    np.savez(folder / "motion.npz", positions_m=np.zeros((N_FRAMES, 17, 3)), fps=np.array(50.0))


def _make_predictions(folder: Path) -> None:
    np.savez(
        folder / "predictions.npz",
        subject=np.array(["S9"] * N_FRAMES),
        action=np.array(["Greeting-2"] * N_FRAMES),
        frame=np.arange(N_FRAMES),
        positions_m=np.zeros((N_FRAMES, 17, 3)),
        joints=np.array(load_skeleton("h36m_17").joints),
    )


def _make_detections(folder: Path) -> None:
    n_joints, n_people = STICK.n_joints, 3
    shapes = ((5,), (n_joints, 2), (n_joints,), (n_joints, 3), (n_joints, 3, 3))
    people = People(*(np.ones((n_people, *shape)) for shape in shapes), problems=("", "small", ""))
    view = ViewDetections(np.arange(2) / 50, np.array([1, 2]), people, True)
    store_detections(view, folder / "cam_1.npz")


def _read_detections(folder: Path) -> None:
    """A damaged file is a warning there, since it can be made again."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        try:
            load_detections(folder / "cam_1.npz", STICK.n_joints)
        except UserWarning as warning:
            raise ValueError(str(warning)) from None


def _make_tflite(folder: Path) -> None:
    # A module of other tests, which pytest finds by itself.
    sys.path.append(str(TESTS / "fgpose" / "monocular" / "downloads"))
    tiny = importlib.import_module("tiny_tflite").TinyTflite()
    image, hidden = tiny.tensor(1, 4, 4, 2, name="image"), tiny.tensor(1, 4, 4, 2)
    result = tiny.tensor(1, 4, 4, 2, name="result")
    tiny.operator("ADD", [image, tiny.constant(np.ones((1, 4, 4, 2), dtype=np.float32))], hidden, "AddOptions")
    tiny.operator("LOGISTIC", [hidden], result)
    (folder / "tiny.tflite").write_bytes(tiny.build([image], [result]))


def _read_tflite(folder: Path) -> bytes:
    from fgpose.monocular.downloads.tflite import convert

    return convert((folder / "tiny.tflite").read_bytes(), name="tiny.tflite")


def _make_live_recording(folder: Path) -> None:
    images = [RecordedImage(image, image.time_s + 0.1) for image in everybody().images]
    documents = [start_document(rig(), STICK, Config(), 0.0), *(images_document([image]) for image in images)]
    records = [as_record(packed(document)) for document in [*documents, {"kind": "end"}]]
    (folder / "live.fgpose").write_bytes(MAGIC + b"".join(records))


def _make_live_rig(folder: Path) -> None:
    save_rig(rig(), folder / "Calib.toml")
    sources = [
        f'[cameras.{name}]\nsource = "rtsp://viewer:secret@10.0.0.{n}/{name}"\n' for n, name in enumerate(rig().names)
    ]
    (folder / "live.toml").write_text('[live]\ncalibration = "Calib.toml"\n\n' + "\n".join(sources))


_STUDY = """[data]
root = "."
keypoints = ["{subject}/{trial}/pose"]
calibration = "{subject}/Calib.toml"
skeleton = "body_25"
fps = 50.0
[steps]
people = "1"
"""
_CELL = """walking_m_s = 1.6
[volume]
low_m = [-2, -2, 0]
high_m = [2, 2, 2.2]
[links.forearm]
capsules = [{ from_m = [0, 0, 0], to_m = [0, 0, 0.4], radius_m = 0.08 }]
[zones.conveyor]
boxes = [{ low_m = [0.5, -1, 0], high_m = [1, 1, 0.9] }]
"""


def _text(name: str, content: str) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_text(content)


def _make_scores(folder: Path) -> None:
    texts: dict[str, Any] = {"variant": "noise", "clip": "walk", "method": "batch", "group": "ours"}
    several: dict[str, Any] = {"coverage": (0.5,), "coverage_occluded": (0.5,), "joint_mm": (1.0, 2.0)}
    numbers: dict[str, Any] = {field.name: 1.0 for field in fields(Score)}
    save_scores([Score(**(numbers | several | texts))], folder / "scores.json")


def _make_used(extension: str) -> Callable[[Path], Any]:
    return lambda folder: save_trajectory(walk(), folder / f"result{extension}")


def _use_result(path: Path) -> None:
    """Judge what a result file has, and write it in all other formats."""
    people = load_people_trajectories(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        warnings.simplefilter("error", RuntimeWarning)
        with naming(path):
            quality(FinishedRecording(path.stem, people))
        for extension in (".npz", ".trc", ".c3d", ".parquet"):
            save_people(people, path.parent / f"written{extension}", world_up="z")
        for each in people.values():
            segment_poses(each)
            joint_angles(each)


def _make_xcp(folder: Path) -> None:
    lens = 'FOCAL_LENGTH="1145" PRINCIPAL_POINT="500 500" VICON_RADIAL2="ViconRadial2 500 500 0.1 0.01 0"'
    cameras = []
    for camera in rig().cameras:
        x, y, z = (1000 * camera.position_m).tolist()
        frame = f'<KeyFrame {lens} ORIENTATION="0.5 0.5 0.5 0.5" POSITION="{x} {y} {z}"/>'
        head = f'DEVICEID="{camera.name}" TYPE="VideoCamera" SENSOR_SIZE="1000 1000"'
        cameras.append(f"<Camera {head}><KeyFrames>{frame}</KeyFrames></Camera>")
    (folder / "rig.xcp").write_text(f"<Cameras>{''.join(cameras)}</Cameras>")


def _make_opencap(folder: Path) -> None:
    for camera in rig().cameras:
        (folder / camera.name).mkdir()
        values = {
            "intrinsicMat": camera.K,
            "distortion": np.zeros((1, 5)),
            "imageSize": np.array([[1000.0], [1000.0]]),
            "rotation": camera.camera_T_world[:3, :3],
            "translation": 1000 * camera.camera_T_world[:3, 3:],
        }
        with (folder / camera.name / "cameraIntrinsicsExtrinsics.pickle").open("wb") as file:
            pickle.dump(values, file)


def _make_biocv(folder: Path) -> None:
    for camera in rig().cameras:
        pose = [[*row[:3], 1000 * row[3]] for row in camera.camera_T_world[:3].tolist()]
        rows = [[1000, 1000], *camera.K.tolist(), *pose, [0.0] * 5]
        (folder / f"{camera.name}.calib").write_text("\n".join(" ".join(map(str, row)) for row in rows))


def _make_rig_json(folder: Path) -> None:
    cameras = {
        camera.name: {
            "K": camera.K.tolist(),
            "dist": [0.0] * 5,
            "R": camera.camera_T_world[:3, :3].tolist(),
            "t": camera.camera_T_world[:3, 3].tolist(),
            "size": [1000, 1000],
        }
        for camera in rig().cameras
    }
    (folder / "rig.json").write_text(json.dumps(cameras))


def _copied(source: Path) -> Callable[[Path], Any]:
    return lambda folder: shutil.copy(source, folder / source.name)


def _result(extension: str) -> Callable[[Path], None]:
    return lambda folder: save_trajectory(trajectory(), folder / f"result{extension}")


def _one(reader: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """The reader on the only file of the folder."""

    def read(folder: Path) -> Any:
        (path,) = folder.iterdir()
        return reader(path)

    return read


def _make_lens_yaml(folder: Path) -> None:
    """As OpenCV's calibration program writes it."""
    import cv2

    storage = cv2.FileStorage(str(folder / "lens.yml"), cv2.FILE_STORAGE_WRITE)
    for key, value in {"image_width": 640, "image_height": 480}.items():
        storage.write(key, value)
    storage.write("camera_matrix", rig().cameras[0].K)
    storage.write("distortion_coefficients", np.zeros((5, 1)))
    storage.release()


def _make_lens_json(folder: Path) -> None:
    lens = {"camera_matrix": rig().cameras[0].K.tolist(), "dist_coeff": [0.1, 0.0, 0.0, 0.0], "image_size": [640, 480]}
    (folder / "lens.json").write_text(json.dumps({"cam_0": lens, "cam_1": lens}))


def _read_lens(path: Path) -> CameraRig:
    return load_intrinsics(path, ["cam_0", "cam_1"], [(640, 480), (640, 480)])


def _read_recording(path: Path) -> Observations:
    with suppress(ValueError):
        stated_skeleton(path)
    return load_observations(path, rig(), STICK)


def _read_people(path: Path) -> PeopleObservations:
    return load_people(path, rig(), STICK)


FORMATS = {
    each.name: each
    for each in (
        Format("trajectory parquet", "parquet", _result(".parquet"), _one(load_trajectory)),
        Format("trajectory npz", "npz", _result(".npz"), _one(load_trajectory)),
        Format("trajectory trc", "text", _result(".trc"), _one(load_trajectory)),
        Format("trajectory c3d", "c3d", _result(".c3d"), _one(load_trajectory)),
        Format("people trajectories parquet", "parquet", _make_people_trajectories, _one(load_people_trajectories)),
        Format("origin parquet", "parquet", _make_people_trajectories, _one(load_origin)),
        Format("angles parquet", "parquet", _kinematics(".parquet"), _one(load_angles)),
        Format("rig toml", "toml", lambda folder: save_rig(rig(), folder / "rig.toml"), _one(load_rig)),
        Format("rig aniposelib", "toml", _copied(DATA / "webcam_mediapipe" / "config.toml"), _one(load_rig)),
        Format("rig qualisys", "text", _copied(DATA / "qualisys" / "Calib.qca.txt"), _one(load_rig)),
        Format("rig yaml", "text", _make_easymocap, load_rig),
        Format("rig xcp", "text", _make_xcp, _one(load_rig)),
        Format("rig opencap", "bytes", _make_opencap, load_rig),
        Format("rig biocv", "text", _make_biocv, load_rig),
        Format("rig json", "json", _make_rig_json, _one(load_rig)),
        Format("lens yaml", "text", _make_lens_yaml, _one(_read_lens)),
        Format("lens json", "json", _make_lens_json, _one(_read_lens)),
        Format(
            "rig caliscope", "toml", lambda folder: save_rig(rig(), folder / "rig.toml", "caliscope"), _one(load_rig)
        ),
        Format("rig npz", "npz", lambda folder: save_rig(rig(), folder / "rig.npz"), _one(load_rig)),
        Format("origin of a rig toml", "toml", _known_rig(".toml"), _one(load_calibration_origin)),
        Format("origin of a rig npz", "npz", _known_rig(".npz"), _one(load_calibration_origin)),
        Format("skeleton toml", "toml", _make_skeleton, _one(load_skeleton)),
        Format(
            "config toml",
            "toml",
            lambda folder: (folder / "config.toml").write_text(config_to_toml(Config())),
            _one(load_config),
        ),
        Format("openpose", "json", _make_openpose, _read_keypoints),
        Format("mmpose images", "json", _make_mmpose_images, _read_keypoints),
        Format("mmpose", "json", _make_mmpose, _read_keypoints),
        Format("mmpose frames", "json", _make_mmpose_frames, _read_keypoints),
        Format("coco", "json", _make_coco, _read_keypoints),
        Format("deeplabcut", "text", _make_deeplabcut, _read_keypoints),
        Format("freemocap", "bytes", _make_freemocap, _read_keypoints),
        Format("metrabs json", "json", _make_metrabs_json, _read_keypoints),
        Format("metrabs npz", "npz", _make_metrabs_npz, _read_keypoints),
        Format(
            "network npz",
            "npz",
            _network(".npz", _save_stacked),
            _read_keypoints,
        ),
        Format("network objects", "npz", _network(".npz", save_objects), _read_keypoints),
        Format("network pickle", "bytes", _network(".pkl", save_pickle), _read_keypoints),
        Format("network torch", "bytes", _network(".pt", save_torch), _read_keypoints),
        Format("network json", "json", _network(".json", save_json), _read_keypoints),
        Format("recording npz", "npz", lambda f: save_observations(recording(), f / "seen.npz"), _one(_read_recording)),
        Format(
            "recording parquet",
            "parquet",
            lambda folder: save_observations(recording(), folder / "seen.parquet"),
            _one(_read_recording),
        ),
        Format(
            "people npz",
            "npz",
            lambda folder: save_people_observations(everybody(), folder / "seen.npz"),
            _one(_read_people),
        ),
        Format(
            "people parquet",
            "parquet",
            lambda folder: save_people_observations(everybody(), folder / "seen.parquet"),
            _one(_read_people),
        ),
        Format("live recording", "bytes", _make_live_recording, _one(_read_people)),
        Format("rig of a live recording", "bytes", _make_live_recording, _one(load_rig)),
        Format("motion npz", "npz", _make_motion, _one(motion_from_npz)),
        Format("predictions npz", "npz", _make_predictions, _one(load_predictions)),
        Format("detections npz", "npz", _make_detections, _read_detections),
        Format("live rig", "toml", _make_live_rig, lambda folder: load_live_rig(folder / "live.toml")),
        Format("study", "toml", _text("study.toml", _STUDY), _one(load_study)),
        Format("cell", "toml", _text("cell.toml", _CELL), _one(load_cell)),
        Format(
            "events", "text", _text("events.csv", "event,time_s,subject\nfall,1.5,S1\nend,2,S1\n"), _one(read_events)
        ),
        Format("scores", "json", _make_scores, _one(lambda path: load_scores(path, Score))),
        Format("used parquet", "parquet", _make_used(".parquet"), _one(_use_result)),
        Format("used npz", "npz", _make_used(".npz"), _one(_use_result)),
        Format("used c3d", "c3d", _make_used(".c3d"), _one(_use_result)),
        Format("used trc", "text", _make_used(".trc"), _one(_use_result)),
        Format("tflite", "bytes", _make_tflite, _read_tflite),
    )
}
