"""Human3.6M as h36m-fetch extracts it: one folder for each subject and action, with images and an annot.h5."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_rig
from fgpose.io.content import parse_json, read_content
from fgpose.plain_files import naming
from fgpose_benchmarks.human36m.labels import (
    TEST_SUBJECTS,
    PoseSequence,
    boxes_around_px,
    image_size_px,
    load_label_rigs,
)

if TYPE_CHECKING:
    import h5py

_ANNOTATIONS = "annot.h5"
_DATASETS = ("camera", "frame", "pose/2d", "pose/3d")
_N_JOINTS = 32  # of the original skeleton
# Of the 32 joints of the original, half of which are ends of bones or there twice, those of h36m_17, in its order.
_H36M_17 = [0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27]
# The views' 3D joints are one motion, seen in each camera's frame: brought back to the world they agree to less than a
# millimetre. The cameras of another subject put them centimetres to decimetres apart.
_MAX_DISAGREEMENT_M = 0.02


def load_annotations(
    folder: str | Path, rigs: Mapping[str, CameraRig], subjects: Iterable[str] = TEST_SUBJECTS
) -> list[PoseSequence]:
    """Sequences of the folder that the process_all.py of h36m-fetch writes: SUBJECT/ACTION-SUBACTION/annot.h5.

    Each holds, one row per camera and frame: camera, frame (from 1), pose/2d (32, 2) in pixels of the original image,
    pose/3d (32, 3) in millimetres of the camera's frame; and intrinsics, which are fitted to these and not used.
    pose/3d-univ, of a body of standard size, is not used either. For S9 and S11 the rows are every 64th frame unless
    the script was changed. It drops one view of S11, whose video is corrupt.

    Args:
        folder: its folder processed.
        rigs: cameras of every subject, see load_subject_rigs: the files have no extrinsics.
        subjects: those wanted, in the order of the result. Actions come in the order of their names.

    Raises:
        ValueError: a subject has no sequence or no rig, a file is damaged, or the cameras are not those of the subject.
        OSError: a file cannot be read.
        ImportError: h5py is not installed.
    """
    folder = Path(folder)
    sequences = []
    for subject in subjects:
        paths = sorted(folder.glob(f"{subject}/*/{_ANNOTATIONS}"))
        if not paths:
            raise ValueError(f"{folder}: there is no {subject}/ACTION/{_ANNOTATIONS}")
        if subject not in rigs:
            raise ValueError(f"the cameras of {subject} are missing; there are those of {', '.join(rigs)}")
        sequences += [_load_sequence(path, subject, rigs[subject]) for path in paths]
    return sequences


def load_subject_rigs(path: str | Path) -> dict[str, CameraRig]:
    """The cameras of every subject of Human3.6M.

    Args:
        path: camera-parameters.json of karfly/human36m-camera-parameters (intrinsics by camera; extrinsics by subject
            and camera, world to camera in millimetres); or the .npy labels of Learnable Triangulation; or a folder with
            a calibration for each subject (S9.toml, S11.toml) in any format that fgpose.load_rig reads.

    Raises:
        ValueError: it is none of these, or damaged; the message names the file.
        OSError: it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        found = {each.name.partition(".")[0]: each for each in sorted(path.glob("S*"))}
        if not found:
            raise ValueError(f"{path}: no calibration is named after a subject, as S9.toml is")
        return {subject: load_rig(each) for subject, each in found.items()}
    return load_label_rigs(path) if path.suffix == ".npy" else _read_json(path)


def _read_json(path: Path) -> dict[str, CameraRig]:
    with naming(path, "not the camera parameters of Human3.6M", (KeyError, TypeError, AttributeError, IndexError)):
        parameters = parse_json(read_content(path))
        return {
            subject: CameraRig(
                tuple(
                    Camera.from_world_to_camera(
                        name,
                        image_size_px(name),
                        np.array(parameters["intrinsics"][name]["calibration_matrix"], dtype=float),
                        np.array(extrinsics["R"], dtype=float),
                        np.array(extrinsics["t"], dtype=float)[:, 0] / 1000,
                        np.array(parameters["intrinsics"][name]["distortion"], dtype=float),
                    )
                    for name, extrinsics in cameras.items()
                )
            )
            for subject, cameras in parameters["extrinsics"].items()
        }


def _load_sequence(path: Path, subject: str, rig: CameraRig) -> PoseSequence:
    import h5py

    with naming(path, damage=(KeyError, OSError)):
        with h5py.File(path, "r") as file:
            datasets = _read_datasets(file)
        return _sequence(datasets, subject, path.parent.name, rig)


def _read_datasets(file: h5py.File) -> dict[str, np.ndarray]:
    missing = [name for name in _DATASETS if name not in file]
    if missing:
        raise ValueError(f"not an annotation of h36m-fetch: {', '.join(missing)} is missing")
    datasets = {name: np.asarray(file[name]) for name in _DATASETS}
    n_rows = len(datasets["frame"])
    shapes = ((n_rows,), (n_rows,), (n_rows, _N_JOINTS, 2), (n_rows, _N_JOINTS, 3))
    for name, shape in zip(_DATASETS, shapes, strict=True):
        if datasets[name].shape != shape:
            raise ValueError(f"{name} must be {shape}, got {datasets[name].shape}")
    return datasets


def _sequence(datasets: dict[str, np.ndarray], subject: str, action: str, rig: CameraRig) -> PoseSequence:
    frames = np.unique(datasets["frame"])
    unknown = {str(camera) for camera in np.unique(datasets["camera"])} - set(rig.names)
    if unknown:
        raise ValueError(f"the calibration of {subject} has no camera {', '.join(sorted(unknown))}")
    world_m = np.full((len(frames), rig.n_cameras, len(_H36M_17), 3), np.nan)
    boxes_px = np.full((len(frames), rig.n_cameras, 4), np.nan)
    for c, rows, at in _rows_by_camera(datasets, rig, frames):
        in_camera_m = datasets["pose/3d"][rows][:, _H36M_17].astype(float) / 1000
        world_m[at, c] = rig.cameras[c].to_world_frame(in_camera_m)
        boxes_px[at, c] = boxes_around_px(datasets["pose/2d"][rows][:, _H36M_17].astype(float))
    return PoseSequence(subject, action, rig, frames.astype(int) - 1, _agreed(world_m, rig, subject), boxes_px)


def _rows_by_camera(
    datasets: dict[str, np.ndarray], rig: CameraRig, frames: Int[np.ndarray, " frame"]
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Of every camera its index, its rows, and the places of their frames."""
    for c, name in enumerate(rig.names):
        rows = np.flatnonzero(datasets["camera"].astype(str) == name)
        numbers = datasets["frame"][rows]
        if len(np.unique(numbers)) != len(numbers):
            raise ValueError(f"camera {name} has a frame twice")
        yield c, rows, np.searchsorted(frames, numbers)


def _agreed(
    world_m: Float[np.ndarray, "frame camera joint 3"], rig: CameraRig, subject: str
) -> Float[np.ndarray, "frame joint 3"]:
    """The motion in the first view of each frame. Raises ValueError unless all views agree."""
    known = np.isfinite(world_m).all(axis=(-1, -2))
    first_m = world_m[np.arange(len(world_m)), known.argmax(axis=1)]
    distances_m = np.linalg.norm(world_m - first_m[:, None], axis=-1).max(axis=-1)
    if np.any(distances_m > _MAX_DISAGREEMENT_M):
        camera = np.nanmax(np.where(known, distances_m, np.nan), axis=0).argmax()
        raise ValueError(
            f"with this calibration of {subject} the views put the person up to {np.nanmax(distances_m):.3f} m apart, "
            f"most of all camera {rig.names[camera]}: it is that of another subject, or not in metres"
        )
    return first_m
