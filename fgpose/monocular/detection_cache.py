"""The detections in a camera's images, kept in a file so that no image is run through the network twice."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera
from fgpose.io.arrays import checked, read_arrays, texts, write_arrays
from fgpose.io.code_digest import class_digest, code_digest
from fgpose.monocular.clips import Clip
from fgpose.monocular.network import Network, People

_ARRAYS = ("boxes", "points2d_px", "confidence", "points3d_m", "covariance_m2")


@dataclass(frozen=True, eq=False)
class ViewDetections:
    """The people in the first images of one camera. Single precision (1e-4 px, 1e-7 m), as it is stored."""

    stamps_s: Float[np.ndarray, " image"]
    """Time stamp of each image in its file; NaN where it has none."""
    n_people: Int[np.ndarray, " image"]
    people: People
    """All of them, image by image."""
    ended: bool = False
    """Whether the last image of the clip is among them."""

    @property
    def n_images(self) -> int:
        return len(self.n_people)

    def first(self, n_images: int) -> ViewDetections:
        """The beginning."""
        if n_images >= self.n_images:
            return self
        last = int(self.n_people[:n_images].sum())
        return ViewDetections(self.stamps_s[:n_images], self.n_people[:n_images], _part(self.people, 0, last))

    @staticmethod
    def stacked(stamps_s: list[float], people: list[People], n_joints: int, ended: bool) -> ViewDetections:
        """From the images one by one."""
        everybody = [People.nobody(n_joints), *people]
        arrays = [np.concatenate([getattr(each, name) for each in everybody]).astype(np.float32) for name in _ARRAYS]
        problems = tuple(problem for each in people for problem in each.problems)
        n_people = np.array([each.n_people for each in people], dtype=int)
        return ViewDetections(np.array(stamps_s, dtype=float), n_people, People(*arrays, problems=problems), ended)

    def unstacked(self) -> list[People]:
        """The people of each image."""
        stops = np.cumsum(self.n_people)
        return [
            _part(self.people, stop - n, stop) for n, stop in zip(self.n_people.tolist(), stops.tolist(), strict=True)
        ]


def _part(people: People, start: int, stop: int) -> People:
    return People(*(getattr(people, name)[start:stop] for name in (*_ARRAYS, "problems")))


def cache_path(folder: Path, clip: Clip, network: Network, camera: Camera) -> Path:
    """The file for what this network finds in this clip. Its name changes with whatever the detections depend on.

    These are the content of the clip, the network, the image size and the intrinsics, the code of this package and
    that of the network if it is of another; not the pose of the camera. Raises OSError if the clip cannot be read.
    """
    intrinsics = (camera.size_px, camera.K.tolist(), camera.distortion.tolist(), camera.lens)
    code = code_digest(Path(__file__).parent), class_digest(type(network))
    parts = (code, clip.fingerprint(), network.name, network.skeleton.joints, intrinsics)
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
    return folder / f"{clip.name}-{digest}.npz"


def load_detections(path: Path, n_joints: int) -> ViewDetections | None:
    """What store_detections wrote, None if there is no such file.

    Warns:
        UserWarning: the file is damaged; then None.
    """
    if not path.exists():
        return None
    try:
        arrays = read_arrays(path)
        view = _view(arrays, n_joints)
    except (ValueError, OSError) as error:
        warnings.warn(f"{path}: damaged, detected again ({error})", stacklevel=2)
        return None
    return view


def _view(arrays: Mapping[str, np.ndarray], n_joints: int) -> ViewDetections:
    """Raises ValueError unless the shapes fit together."""
    n_people = checked(arrays, "n_people", "whole numbers", None).astype(int)
    stamps_s = checked(arrays, "stamps_s", "numbers", len(n_people)).astype(float)
    if (n_people < 0).any():
        raise ValueError("its images have no count of people each")
    people = People(
        *(
            checked(arrays, name, "numbers", int(n_people.sum()), *shape)
            for name, shape in People.shapes(n_joints).items()
        ),
        problems=texts(arrays, "problems"),
    )
    return ViewDetections(stamps_s, n_people, people, bool(checked(arrays, "ended", "truth values")))


def store_detections(view: ViewDetections, path: Path) -> None:
    """Replace the file, whole or not at all. Raises OSError if it cannot be written."""
    arrays = {name: getattr(view.people, name) for name in _ARRAYS}
    arrays["problems"] = np.array(view.people.problems, dtype=str)
    arrays |= {"stamps_s": view.stamps_s, "n_people": view.n_people, "ended": np.array(view.ended)}
    write_arrays(path, arrays, compressed=False)
