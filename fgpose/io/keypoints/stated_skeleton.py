"""What the joints of keypoints are, where the file says it or its format leaves one possibility."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.arrays import read_arrays, texts
from fgpose.io.formats import KeypointFormat, recognised
from fgpose.io.keypoints import deeplabcut, freemocap, live_files
from fgpose.io.keypoints.camera_files import read_document, reader_of, stated_joints
from fgpose.io.keypoints.detections import Provenance, read_json
from fgpose.io.keypoints.image_files import image_format, skeletons_with_parts
from fgpose.io.keypoints.networks.network_files import is_of_network, joints_of
from fgpose.io.keypoints.recording_files import SKELETON, is_parquet, is_recording
from fgpose.io.keypoints.sources import freemocap_file, keypoint_sources
from fgpose.io.live.recordings import LiveRecordingFile
from fgpose.io.names import not_hidden
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.skeletons.joint_names import plain_joint, skeletons_named, skeletons_with
from fgpose.io.skeletons.tables import skeleton_from_json
from fgpose.io.tables import file_metadata, names, read_table
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

# Programs that write these only know skeletons of 2D networks; 17 joints in OpenPose's files, which Pose2Sim also
# writes, are never Human3.6M's.
_OF_2D_NETWORKS = ("OpenPose", "COCO results")
_OF_3D_NETWORKS = ("h36m_17", "h36m_17_lt", "mhr_70", "smpl_24")
# There are dozens of MeTRAbs, and many have as many joints.
_OF_ANY_SKELETON = ("MeTRAbs",)


def stated_skeleton(path: Path) -> Skeleton:
    """The skeleton of keypoints of any format that load_observations reads.

    Our own files hold it, the recording of a live system too; MMPose's ``meta_info`` and DeepLabCut's header have the
    names of the joints, and FreeMoCap's points are MediaPipe's. OpenPose, Pose2Sim, AlphaPose, COCO results, SAM 3D
    Body and NLF have their number only: where one skeleton, of 2D networks for 2D keypoints, has it, it is taken.

    Raises:
        ValueError: the file does not say it; the message names those that have as many joints. A file is damaged.
        OSError: a file cannot be read.

    Warns:
        UserWarning: the number of the joints alone told it.
    """
    if recognised(KeypointFormat, path) is not None:
        raise _not_said(path, ())
    if is_recording(path):
        with naming(path):
            return _of_recording(path)
    if path.is_file() and live_files.is_live(path):
        return LiveRecordingFile(path).start.skeleton
    if (array := freemocap_file(path)) is not None:
        stated = freemocap.stated_skeleton(array)
        if stated is None:
            raise _not_said(path, ())
        return load_skeleton(stated)
    return _of_cameras(path)


def _of_recording(path: Path) -> Skeleton:
    """Files of earlier versions have the names of the joints only."""
    if is_parquet(path):
        described = file_metadata(path).get(SKELETON)
        joints = names(read_table(path, ["joint"]), "joint", may_lack=True)[0] if described is None else ()
    else:
        arrays = read_arrays(path, ["joints", SKELETON])
        described = next(iter(texts(arrays, SKELETON)), "") if SKELETON in arrays else None
        joints = texts(arrays, "joints")
    if described is not None:
        try:
            return skeleton_from_json(described)
        except ValueError as error:
            raise ValueError(f"its skeleton is damaged: {error}") from None
    fitting = [each for each in map(load_skeleton, builtin_skeletons()) if set(each.joints) == set(joints)]
    if len(fitting) != 1:
        raise ValueError(
            f"no skeleton that comes with fgpose has its joints ({', '.join(joints)}); give the file of the skeleton "
            "that it was made with (skeleton, or --skeleton)"
        )
    return fitting[0]


def _of_cameras(path: Path) -> Skeleton:
    """Of files of other programs: by what the first one that shows somebody says."""
    for name, source in keypoint_sources(path).items():
        if is_of_network(source):
            said = _of_network(source)
        else:
            said = _of_images(source) if source.is_dir() else _of_camera(Provenance(source, name))
        if said is None:
            continue
        format_name, n_joints, fitting, with_parts = said
        if format_name in _OF_2D_NETWORKS:
            fitting = tuple(each for each in fitting if each not in _OF_3D_NETWORKS) or fitting
        if len(fitting) != 1 or with_parts or format_name in _OF_ANY_SKELETON:
            raise _not_said(path, fitting, n_joints, with_parts)
        skeleton = load_skeleton(fitting[0])
        if n_joints:
            warnings.warn(
                f"{path}: the {n_joints} joints of {format_name} are taken for those of {skeleton.name}; if they are "
                "others, give the skeleton (--skeleton)",
                stacklevel=3,
            )
        return skeleton
    raise ValueError(f"{path}: it shows nobody, and does not say what the joints are; give the skeleton (--skeleton)")


_Said = tuple[str, int, tuple[str, ...], tuple[str, ...]]
"""A format; how many joints there are, 0 where their names are known; the skeletons that may be meant; those that have
the hands and the face, too, of which there are lists beside the body's."""


def _of_network(source: Path) -> _Said | None:
    network, n_joints = joints_of(source)
    return (network, n_joints, skeletons_with(n_joints), ()) if n_joints else None


def _of_images(folder: Path) -> _Said | None:
    for path in not_hidden(folder.glob("*.json")):
        document = read_json(Provenance(path, folder.name))
        format_name = image_format(document)
        if format_name and (n_joints := _n_joints(format_name, document)):
            with_parts = skeletons_with_parts(document) if format_name == "OpenPose" else ()
            return format_name, n_joints, skeletons_with(n_joints), with_parts
    return None


def _of_camera(source: Provenance) -> _Said | None:
    if source.path.suffix == ".csv":
        return "DeepLabCut", 0, _largest_within(deeplabcut.body_parts(source)), ()
    document = read_document(source)
    format_name, _ = reader_of(document, source)
    if format_name == "MMPose" and isinstance(document, Mapping):
        stated = skeletons_named(*stated_joints(document.get("meta_info")))
        if stated:
            return format_name, 0, stated, ()
    n_joints = _n_joints(format_name, document)
    return (format_name, n_joints, skeletons_with(n_joints), ()) if n_joints else None


def _n_joints(format_name: str, document: Any) -> int:
    """Of the first person; 0 where there is nobody. What is damaged is found when it is read."""
    if format_name == "MeTRAbs":
        images = document if isinstance(document, list) else [document]
        return max(
            (_n_points(image["poses2d"]) for image in images if isinstance(image, Mapping) and "poses2d" in image),
            default=0,
        )
    flat = {"OpenPose": "pose_keypoints_2d", "COCO results": "keypoints"}.get(format_name)
    for person in _people(document):
        points = person.get(flat or "keypoints")
        if isinstance(points, list) and points:
            return len(points) // 3 if flat else len(points)
    return 0


def _n_points(poses: Any) -> int:
    """Of the first pose in lists of lists, or an array, of points."""
    if isinstance(poses, np.ndarray):
        return poses.shape[-2] if poses.ndim > 1 else 0
    lists = [each for each in poses if isinstance(each, list)] if isinstance(poses, list) else []
    if any(isinstance(number, int | float) for each in lists for number in each[:1]):
        return len(poses)
    return next((n for n in map(_n_points, lists) if n), 0)


def _people(document: Any) -> Iterator[Mapping[str, Any]]:
    """Of one image or all, one after the other."""
    if isinstance(document, Mapping):
        document = document.get("people") or document.get("instance_info")
    rows = [row for row in document if isinstance(row, Mapping)] if isinstance(document, list) else []
    of_images = (row["instances"] if isinstance(row.get("instances"), list) else [row] for row in rows)
    return (person for person in chain.from_iterable(of_images) if isinstance(person, Mapping))


def _largest_within(parts: Sequence[str]) -> tuple[str, ...]:
    """The skeletons all of whose joints are among the parts, those of most joints."""
    there = {plain_joint(part) for part in parts}
    within = [each for each in map(load_skeleton, builtin_skeletons()) if {*map(plain_joint, each.joints)} <= there]
    most = max((each.n_joints for each in within), default=0)
    return tuple(each.name for each in within if each.n_joints == most)


def _not_said(path: Path, likely: Sequence[str], n_joints: int = 0, with_parts: Sequence[str] = ()) -> ValueError:
    of_so_many = f" of {n_joints} joints is {' or '.join(likely)}" if likely and n_joints else ""
    fitting = of_so_many or (
        f" possible are {', '.join(likely)}" if likely else " fgpose skeletons lists those there are"
    )
    if with_parts:
        fitting += f"; with the hands, or the face, that it has too {' or '.join(with_parts)}"
    return ValueError(f"{path}: it does not say what its joints are; give the skeleton (--skeleton):{fitting}")
