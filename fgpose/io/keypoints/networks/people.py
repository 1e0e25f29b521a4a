"""The people in a document of a network, however they are nested: by image, by person, or stacked in arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fgpose.geometry.per_view.absolute_pose import UNSTATED_CONFIDENCE, confidence_of_spread
from fgpose.io.keypoints.detections import ImageDetections, NetworkJoints, Provenance, checked_detections, nobody
from fgpose.io.keypoints.networks.documents import as_array, refuse_own_world
from fgpose.io.names import MAX_FRAME, camera_name, frame_numbers
from fgpose.io.skeletons.joint_names import chosen_joints
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


@dataclass(frozen=True)
class Network:
    """The keys of a network's outputs; empty: it has none."""

    name: str
    joints3d: str
    joints2d: str
    translation: str = ""
    focal: str = ""
    sigma: str = ""


# Of NLF's two, the joints that the network localised itself: its uncertainties are of these.
NETWORKS = (
    Network("SAM 3D Body", "pred_keypoints_3d", "pred_keypoints_2d", "pred_cam_t", "focal_length"),
    Network("NLF", "joints3d_nonparam", "joints2d_nonparam", sigma="joint_uncertainties"),
    Network("NLF", "joints3d", "joints2d", sigma="joint_uncertainties"),
    Network("NLF", "poses3d", "poses2d", sigma="uncertainties"),
)
_FRAME_KEYS = ("frame", "frame_idx", "frame_id", "frame_index", "image_id")
USED_KEYS = tuple(
    sorted({key for each in NETWORKS for key in vars(each).values() if key and key != each.name} | {*_FRAME_KEYS})
)
"""The arrays of an npz that are read."""
MARKS = tuple({each.sigma if each.joints3d == "poses3d" else each.joints3d for each in NETWORKS})
"""A file that has one of these is of such a network. (poses3d and poses2d alone are MeTRAbs's.)"""
_DEEPEST = 6  # a person in an image in a list in a table in an array of objects

# In metres no network is that unsure of half of the joints, in millimetres each is.
_MAX_SIGMA_M = 1.0


@dataclass(frozen=True, eq=False)
class _Person:
    joints3d: np.ndarray
    joints2d: np.ndarray
    translation: np.ndarray
    focal_px: float
    sigma: np.ndarray


def network_of(document: Any, deepest: int = _DEEPEST) -> Network | None:
    """The network whose outputs are somewhere in a document; None: of none that is known."""
    return next((network for network, _ in _outputs(document, deepest)), None)


def joints_in(document: Any) -> tuple[str, int]:
    """The network whose outputs are in a document, and how many joints its bodies have; 0: it shows nobody."""
    found = ((network.name, _n_joints(outputs[network.joints3d])) for network, outputs in _outputs(document, _DEEPEST))
    return next(((name, n_joints) for name, n_joints in found if n_joints), ("", 0))


def _outputs(document: Any, deepest: int) -> Iterator[tuple[Network, Mapping[Any, Any]]]:
    """All parts of a document with the outputs of a network that is known."""
    parts: Iterable[Any] = ()
    if isinstance(document, Mapping):
        found = next((each for each in NETWORKS if _is_of(document, each)), None)
        if found is not None:
            yield found, document
            return
        parts = document.values()
    elif isinstance(document, Sequence) and not isinstance(document, str | bytes):
        parts = document
    if deepest:
        for part in parts:
            yield from _outputs(part, deepest - 1)


def _n_joints(joints: Any) -> int:
    """Of the first body in an array, or in lists of arrays."""
    array = as_array(joints)
    if array is not None and array.ndim > 1:
        return array.shape[-2]
    return next(filter(None, map(_n_joints, joints)), 0) if isinstance(joints, list | tuple) else 0


def _is_of(document: Mapping[Any, Any], network: Network) -> bool:
    # Without the uncertainties these are MeTRAbs's.
    marks = {network.joints3d, network.sigma} if network.joints3d == "poses3d" else {network.joints3d}
    return marks <= document.keys()


def image_of(document: Any, source: Provenance, skeleton: Skeleton) -> ImageDetections:
    """Everybody in the document of one image: a dictionary for each person, or arrays of all.

    Raises:
        ValueError: it is of no known network, or its arrays do not fit each other or the skeleton; the message names
            file, camera and frame.
    """
    if document is None or (isinstance(document, list | dict) and not document):
        return nobody(source, skeleton)
    return detections_of(_people(document, source), _known_network(document, source), source, skeleton)


def images_of(document: Any, source: Provenance, skeleton: Skeleton) -> dict[int, ImageDetections]:
    """Everybody in the document of a whole camera, by the number of the frame: a list of its images or a dictionary by
    them, or arrays whose first axis is the frame. Without numbers, images are counted from 0. Raises as image_of."""
    network = _known_network(document, source)
    found: dict[int, list[_Person]] = {}
    for frame, people in _images(document, network, source):
        found.setdefault(frame, []).extend(people)
    images = {}
    for frame, people in sorted(found.items()):
        images[frame] = detections_of(people, network, replace(source, frame=frame), skeleton)
    return images


def is_of_one_image(document: Any) -> bool:
    """Whether a document can only be of one image: one body, alone or with others in a list."""
    if isinstance(document, Mapping) and (network := network_of(document, 0)) is not None:
        joints = as_array(document[network.joints3d])
        return joints is not None and joints.ndim == 2
    return False


def _known_network(document: Any, source: Provenance) -> Network:
    with naming(source):
        refuse_own_world(document)
        if (network := network_of(document)) is not None:
            return network
        keys = ", ".join(map(str, list(document)[:8])) if isinstance(document, Mapping) else type(document).__name__
        wanted = " or ".join(dict.fromkeys(f"{each.joints3d} ({each.name})" for each in NETWORKS[:3]))
        raise ValueError(f"no joints of a network that is known here: it has {keys}, not {wanted}")


def detections_of(
    people: Sequence[_Person], network: Network, source: Provenance, skeleton: Skeleton
) -> ImageDetections:
    """The people of one image, checked. Raises ValueError, which names file, camera, frame and joint."""
    seen = [each for each in people if np.isfinite(each.joints2d).any()]
    if not seen:
        return nobody(source, skeleton)
    n_given = seen[0].joints2d.shape[0]
    sigma_m = _metres(np.stack([each.sigma for each in seen]))
    confidence = np.where(np.isnan(sigma_m), UNSTATED_CONFIDENCE, confidence_of_spread(sigma_m**2))
    joints2d, joints3d = np.stack([each.joints2d for each in seen]), np.stack([each.joints3d for each in seen])
    checked = checked_detections(source, skeleton, joints2d, confidence, joints3d)
    chosen = chosen_joints(skeleton, n_given)
    joints = NetworkJoints(
        network.name,
        np.stack([each.translation for each in seen]),
        np.array([each.focal_px for each in seen]),
        sigma_m if chosen is None else sigma_m[:, list(chosen)],
    )
    return replace(checked, of_network=joints)


def _metres(sigma: np.ndarray) -> np.ndarray:
    """Uncertainties, which NLF gives in metres also where its joints are in millimetres."""
    known = sigma[np.isfinite(sigma)]
    return sigma * 1e-3 if known.size and np.median(known) > _MAX_SIGMA_M else sigma


def _images(document: Any, network: Network, source: Provenance) -> Iterable[tuple[int, list[_Person]]]:
    """The people of each image, with its number."""
    if isinstance(document, Mapping) and _is_of(document, network):
        yield from _stacked_images(document, network, source)
        return
    if isinstance(document, Mapping):
        parts = {str(key): part for key, part in document.items() if _holds(part)}
        if len(parts) == 1 and not any(letter.isdigit() for key in parts for letter in key):
            for part in parts.values():
                yield from _images(part, network, source)
            return
        numbers = frame_numbers(list(parts), camera_name(source.camera))
    else:
        parts = {str(place): part for place, part in enumerate(document)}
        numbers = {str(place): _frame_of(part, place, source) for place, part in enumerate(document)}
    for key, part in parts.items():
        frame = numbers[key]
        if _is_track(part, network):
            yield from _stacked_images(part, network, source)
        elif frame is None:
            raise ValueError(f"{source}: no frame number in the key {key!r}")
        else:
            yield frame, _people(part, replace(source, frame=frame))


def _is_track(part: Any, network: Network) -> bool:
    """Whether a part of a document is somebody in several images, whose numbers are there too."""
    if not isinstance(part, Mapping) or not _is_of(part, network):
        return False
    numbers = [as_array(part[key]) for key in _FRAME_KEYS if key in part]
    joints = as_array(part[network.joints3d])
    return (
        joints is not None and joints.ndim > 2 and any(n is not None and n.shape == joints.shape[:1] for n in numbers)
    )


def _stacked_images(
    document: Mapping[Any, Any], network: Network, source: Provenance
) -> Iterable[tuple[int, list[_Person]]]:
    """Of arrays whose first axis is the frame, or lists of the arrays of each frame."""
    of_one_image = is_of_one_image(document)
    n_frames = 1 if of_one_image else len(_rows(document, network.joints3d, source))
    of_each: dict[str, list[Any]] = {}
    for key in filter(None, (network.joints3d, network.joints2d, network.translation, network.focal, network.sigma)):
        if document.get(key) is None:
            continue
        array = as_array(document[key])
        if array is not None and array.size == 1:
            of_each[key] = [float(array.ravel()[0])] * n_frames
        else:
            of_each[key] = [document[key]] if of_one_image else _rows(document, key, source)
        if len(of_each[key]) != n_frames:
            raise ValueError(f"{source}: {network.joints3d} of {n_frames} frames, {key} of {len(of_each[key])}")
    numbers = _stated_frames(document, n_frames, source)
    for frame, row in zip(numbers, zip(*of_each.values(), strict=True), strict=True):
        yield frame, _people(dict(zip(of_each, row, strict=True)), replace(source, frame=frame))


def _rows(document: Mapping[str, Any], key: str, source: Provenance) -> list[Any]:
    """Of an array or a list, along its first axis."""
    value = document[key]
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim):
        return list(value)
    raise ValueError(f"{source}: {key} is not an array of numbers")


def _stated_frames(document: Mapping[str, Any], n_frames: int, source: Provenance) -> list[int]:
    key = next((key for key in _FRAME_KEYS if key in document), None)
    numbers = list(range(n_frames)) if key is None else np.atleast_1d(_numbers(document, key, source)).tolist()
    if len(numbers) != n_frames:
        raise ValueError(f"{source}: {n_frames} frames, but {key} has {len(numbers)} numbers")
    return [_whole_number(number, source) for number in numbers]


def _holds(part: Any) -> bool:
    """Whether there are people in a part of a document, or none where some could be."""
    return network_of(part) is not None or (isinstance(part, list) and not part)


def _frame_of(part: Any, place: int, source: Provenance) -> int:
    stated = next((part[key] for key in _FRAME_KEYS if key in part), place) if isinstance(part, Mapping) else place
    return place if isinstance(stated, list | tuple) or np.ndim(stated) else _whole_number(stated, source)


def _whole_number(value: Any, source: Provenance) -> int:
    number = as_array(value)
    if (
        number is None
        or number.size != 1
        or not 0 <= float(number.ravel()[0]) < MAX_FRAME
        or float(number.ravel()[0]) % 1
    ):
        raise ValueError(f"{source}: {value!r} is not the number of a frame")
    return int(number.ravel()[0])


def _people(value: Any, source: Provenance) -> list[_Person]:
    """Everybody in what a document has of one image."""
    if value is None:
        return []
    if not isinstance(value, Mapping):
        parts = list(value) if isinstance(value, Sequence) and not isinstance(value, str | bytes) else [None]
        if parts and not any(isinstance(part, Mapping | list | tuple) for part in parts):
            raise ValueError(f"{source}: a list of people is needed, got {type(value).__name__}")
        return [person for part in parts for person in _people(part, source)]
    network = network_of(value, 0)
    if network is None:
        return [person for part in value.values() if network_of(part) is not None for person in _people(part, source)]
    joints3d, joints2d = _numbers(value, network.joints3d, source), _numbers(value, network.joints2d, source)
    if joints3d.size == joints2d.size == 0:
        return []
    if joints3d.ndim not in (2, 3) or joints3d.shape[-1] != 3 or joints2d.shape != (*joints3d.shape[:-1], 2):
        raise ValueError(
            f"{source}: {network.joints3d} must be (joints, 3) or (people, joints, 3) and {network.joints2d} (..., 2), "
            f"got {joints3d.shape} and {joints2d.shape}"
        )
    joints3d, joints2d = (each.reshape(-1, *each.shape[-2:]) for each in (joints3d, joints2d))
    n_people, n_joints = joints3d.shape[:2]
    translation = _optional(value, network.translation, (n_people, 3), source)
    focal_px = _optional(value, network.focal, (n_people, 1), source)
    sigma = _optional(value, network.sigma, (n_people, n_joints), source)
    return [
        _Person(*each) for each in zip(joints3d, joints2d, translation, focal_px[:, 0].tolist(), sigma, strict=True)
    ]


def _numbers(value: Mapping[str, Any], key: str, source: Provenance) -> np.ndarray:
    if value.get(key) is None:
        raise ValueError(f"{source}: {key} is missing: the 2D joints are needed too, they tell where the 3D ones are")
    array = as_array(value[key])
    if array is None:
        raise ValueError(f"{source}: {key} is not an array of numbers")
    return array.astype(float)


def _optional(value: Mapping[str, Any], key: str, shape: tuple[int, int], source: Provenance) -> np.ndarray:
    """An array of everybody, NaN where there is none; one number may stand for all."""
    if not key or value.get(key) is None:
        return np.full(shape, np.nan)
    array = _numbers(value, key, source)
    if array.size not in (1 if shape[1] == 1 else shape[0] * shape[1], shape[0] * shape[1]):
        raise ValueError(f"{source}: {key} must be {shape}, got {array.shape}")
    return np.broadcast_to(array.reshape(-1, shape[1]), shape)
