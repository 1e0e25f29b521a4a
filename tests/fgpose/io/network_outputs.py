"""What monocular networks give of a person whose motion is known, in every way in which users save it."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import walking
from fgpose_benchmarks.synthetic.answering_network import answers

MHR = load_skeleton("mhr_70")
SMPL = load_skeleton("smpl_24")
N_FRAMES, FPS = 4, 30.0
_WALKER = load_skeleton("h36m_17")


def body_m(joints: tuple[str, ...], n_frames: int = N_FRAMES) -> np.ndarray:
    """Somebody who walks, with these joints: those that the walker lacks are near its others."""
    walker_m = walking(n_frames, FPS, _WALKER)
    offsets_m = np.random.default_rng(0).uniform(-0.08, 0.08, (len(joints), 3))
    of_hand = ("thumb", "index", "middle", "ring", "pinky", "hand")

    def nearest(joint: str) -> str:
        side, _, part = joint.partition("_")
        if joint in _WALKER.joints:
            return joint
        if part.startswith(of_hand):
            return f"{side}_wrist"
        parts = {"toe": "ankle", "heel": "ankle", "foot": "ankle", "olecranon": "elbow", "fossa": "elbow"}
        found = next((f"{side}_{near}" for word, near in parts.items() if word in part), None)
        return found or ("thorax" if joint.startswith(("spine", "neck")) or "collar" in part else "head")

    bases = [nearest(joint) for joint in joints]
    own = np.array([base == joint for base, joint in zip(bases, joints, strict=True)])
    return walker_m[:, [_WALKER.index(base) for base in bases]] + np.where(own[:, None], 0.0, offsets_m)


def sam3d_people(points_m: np.ndarray, camera: Camera, focal_ratio: float = 1.0) -> list[dict[str, Any]]:
    """SAM 3D Body's dictionary of the person in each image, single precision as there."""
    found = answers(points_m, camera, focal_ratio)
    return [
        {
            "bbox": np.array([*found.points2d_px[frame].min(axis=0), *found.points2d_px[frame].max(axis=0)]),
            "focal_length": np.float32(found.focal_px),
            "pred_keypoints_3d": found.relative_m[frame].astype(np.float32),
            "pred_keypoints_2d": found.points2d_px[frame].astype(np.float32),
            "pred_vertices": np.zeros((50, 3), np.float32),
            "pred_cam_t": found.translation_m[frame].astype(np.float32),
            "mask": None,
        }
        for frame in range(len(points_m))
    ]


def stacked(people: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    return {key: np.stack([each[key] for each in people]) for key in people[0] if people[0][key] is not None}


def as_json(document: Any) -> Any:
    """As json.dumps takes it."""
    if isinstance(document, dict):
        return {key: as_json(each) for key, each in document.items()}
    if isinstance(document, list):
        return [as_json(each) for each in document]
    return document.tolist() if isinstance(document, np.ndarray | np.generic) else document


class _Global:
    """A name of torch, which is not installed here."""

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name


class _Storage:
    def __init__(self, pid: tuple[Any, ...]) -> None:
        self.pid = pid


class _Tensor:
    """Pickled as torch does: a function of a storage, an offset, a size and a stride."""

    def __init__(self, pid: tuple[Any, ...], array: np.ndarray) -> None:
        self.pid, self.size = pid, array.shape
        self.stride = tuple(step // array.itemsize for step in array.strides)


_PythonPickler: Any = vars(pickle)["_Pickler"]


class _TorchPickler(_PythonPickler):
    """Writes names of modules that are not there, which the pickler in C looks for."""

    def persistent_id(self, obj: Any) -> Any:
        return obj.pid if isinstance(obj, _Storage) else None

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if isinstance(obj, _Global):
            self.write(pickle.GLOBAL + f"{obj.module}\n{obj.name}\n".encode())
        elif isinstance(obj, _Tensor):
            self.save(_Global("torch._utils", "_rebuild_tensor_v2"))
            self.save((_Storage(obj.pid), 0, obj.size, obj.stride, False, {}))
            self.write(pickle.REDUCE)
        else:
            super().save(obj, save_persistent_id)


_STORAGES = {"float32": "FloatStorage", "float64": "DoubleStorage", "int64": "LongStorage"}


def save_torch(document: Any, path: Path, *, tensors: bool = True) -> None:
    """As torch.save does: an archive with a pickle, and the numbers of its tensors beside it."""
    storages: list[bytes] = []

    def converted(each: Any) -> Any:
        if isinstance(each, dict):
            return {key: converted(value) for key, value in each.items()}
        if isinstance(each, list):
            return [converted(value) for value in each]
        if not tensors or not isinstance(each, np.ndarray | np.generic):
            return each
        array = np.ascontiguousarray(each) if np.ndim(each) else np.array(each)
        storages.append(array.tobytes())
        kind = _Global("torch", _STORAGES[array.dtype.name])
        return _Tensor(("storage", kind, str(len(storages) - 1), "cpu", array.size), array)

    content = io.BytesIO()
    _TorchPickler(content, protocol=2).dump(converted(document))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(f"{path.stem}/data.pkl", content.getvalue())
        archive.writestr(f"{path.stem}/byteorder", "little")
        for key, numbers in enumerate(storages):
            archive.writestr(f"{path.stem}/data/{key}", numbers)


def save_pickle(document: Any, path: Path) -> None:
    path.write_bytes(pickle.dumps(document))


def save_json(document: Any, path: Path) -> None:
    path.write_text(json.dumps(as_json(document)))


def save_objects(document: Any, path: Path) -> None:
    """np.savez of what is no array: NumPy makes an array of objects of it."""
    np.savez_compressed(path, output=np.array(document, dtype=object))


def save_npz(document: dict[str, Any], path: Path) -> None:
    np.savez(path, allow_pickle=False, **document)


def save_npy(document: Any, path: Path) -> None:
    np.save(path, np.array(document, dtype=object), allow_pickle=True)


Save = Callable[[Any, Path], None]
SAVES: dict[str, tuple[str, Save]] = {
    "pickle": (".pkl", save_pickle),
    "torch tensors": (".pt", save_torch),
    "torch arrays": (".pth", lambda document, path: save_torch(document, path, tensors=False)),
    "json": (".json", save_json),
    "objects in npz": (".npz", save_objects),
    "objects in npy": (".npy", save_npy),
}
