"""A LiveFrame as ROS 2 messages, in CDR, without ROS."""

from __future__ import annotations

import math
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.live.frame import CameraStatus, LiveFrame, LivePerson

FRAME_ID = "world"
TOPICS = {
    "/poses": "geometry_msgs/msg/PoseArray",
    "/markers": "visualization_msgs/msg/MarkerArray",
    "/people": "fgpose_msgs/msg/People",
}
_OWN = ("Camera", "Person", "People")
_LIFETIME_NS = 500_000_000
"""A person whom no newer message shows disappears from the screen."""
_JOINT_M, _BONE_M = 0.06, 0.03
_UPPER_TRIANGLE = np.triu_indices(3)
_NS = 1_000_000_000
# Okabe and Ito's colours for people who see some colours alike.
_COLOURS = (
    (0.0, 0.45, 0.7),
    (0.9, 0.6, 0.0),
    (0.0, 0.62, 0.45),
    (0.8, 0.47, 0.65),
    (0.34, 0.71, 0.91),
    (0.84, 0.37, 0),
)


@cache
def typestore() -> Any:
    """The message types of ROS 2 Humble, with ours.

    Raises:
        ImportError: rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise ImportError("ROS 2 messages need rosbags: pip install 'fgpose[live]'") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    folder = resources.files("fgpose.live.outputs").joinpath("fgpose_msgs", "msg")
    own: dict[str, Any] = {}
    for name in _OWN:
        text = folder.joinpath(f"{name}.msg").read_text(encoding="utf-8")
        own |= get_types_from_msg(text, f"fgpose_msgs/msg/{name}")
    store.register(own)
    return store


def definition(topic: str) -> str:
    """The message type of a topic as text, with all types that it uses, as MCAP files carry it."""
    return typestore().generate_msgdef(TOPICS[topic], ros_version=2)[0]


def nanoseconds(time_s: float) -> int:
    """0 for a time that is not known."""
    return round(time_s * _NS) if math.isfinite(time_s) and time_s > 0 else 0


def messages(frame: LiveFrame) -> dict[str, bytes]:
    """What is published on each topic."""
    made = {"/poses": _poses(frame), "/markers": _markers(frame), "/people": _people(frame)}
    return {topic: bytes(typestore().serialize_cdr(message, TOPICS[topic])) for topic, message in made.items()}


def _made(kind: str, *values: Any) -> Any:
    package, _, name = kind.partition("/")
    return typestore().types[f"{package}/msg/{name}"](*values)


def _time(nanoseconds: int, kind: str = "Time") -> Any:
    return _made(f"builtin_interfaces/{kind}", *divmod(nanoseconds, _NS))


def _header(frame: LiveFrame) -> Any:
    return _made("std_msgs/Header", _time(nanoseconds(frame.time_s)), FRAME_ID)


def _point(position_m: Float[np.ndarray, " 3"]) -> Any:
    return _made("geometry_msgs/Point", *position_m.tolist())


def _known(person: LivePerson) -> np.ndarray:
    return np.asarray(np.isfinite(person.positions_m).all(axis=-1))


def _pose(position_m: Float[np.ndarray, " 3"]) -> Any:
    return _made("geometry_msgs/Pose", _point(position_m), _made("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0))


def _poses(frame: LiveFrame) -> Any:
    """All known joints of everybody: to nodes that keep a distance, each is something to keep it from."""
    poses = [_pose(joint) for person in frame.people for joint in person.positions_m[_known(person)]]
    return _made("geometry_msgs/PoseArray", _header(frame), poses)


def _markers(frame: LiveFrame) -> Any:
    bones = np.array([*frame.skeleton.bones, *frame.skeleton.lines], dtype=int).reshape(-1, 2)
    markers = []
    for person in frame.people:
        known = _known(person)
        shown = bones[known[bones].all(axis=1)].ravel()
        markers += [
            _marker(frame, person, "SPHERE_LIST", person.positions_m[known]),
            _marker(frame, person, "LINE_LIST", person.positions_m[shown]),
        ]
    return _made("visualization_msgs/MarkerArray", markers)


def _marker(frame: LiveFrame, person: LivePerson, kind: str, points_m: np.ndarray) -> Any:
    marker = typestore().types["visualization_msgs/msg/Marker"]
    is_joints = kind == "SPHERE_LIST"
    scale_m = (_JOINT_M,) * 3 if is_joints else (_BONE_M, 0.0, 0.0)
    colour = _COLOURS[person.person % len(_COLOURS)]
    sensor = _made("sensor_msgs/CompressedImage", _header(frame), "", np.zeros(0, dtype=np.uint8))
    return marker(
        header=_header(frame),
        ns=f"person {person.person}",
        id=0 if is_joints else 1,
        type=getattr(marker, kind),
        action=marker.ADD,
        pose=_pose(np.zeros(3)),
        scale=_made("geometry_msgs/Vector3", *scale_m),
        color=_made("std_msgs/ColorRGBA", *colour, 1.0),
        lifetime=_time(_LIFETIME_NS, "Duration"),
        frame_locked=False,
        points=[_point(point) for point in points_m],
        colors=[],
        texture_resource="",
        texture=sensor,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_made("visualization_msgs/MeshFile", "", np.zeros(0, dtype=np.uint8)),
        mesh_use_embedded_materials=False,
    )


def _people(frame: LiveFrame) -> Any:
    return _made(
        "fgpose_msgs/People",
        _header(frame),
        _time(nanoseconds(frame.published_s)),
        frame.sequence,
        frame.skeleton.name,
        list(frame.skeleton.joints),
        frame.observed_share,
        [_person(person) for person in frame.people],
        [_camera(camera, frame) for camera in frame.cameras],
    )


def _person(person: LivePerson) -> Any:
    return _made(
        "fgpose_msgs/Person",
        person.person,
        person.is_provisional,
        -1 if person.former is None else person.former,
        person.state.value,
        [_point(joint) for joint in person.positions_m],
        person.covariance_m2[:, *_UPPER_TRIANGLE].ravel().astype(np.float32),
        np.asarray(person.status, dtype=np.uint8),
        np.asarray(person.probability, dtype=np.float32),
    )


def _camera(camera: CameraStatus, frame: LiveFrame) -> Any:
    def known(value: float | None) -> float:
        return math.nan if value is None else value

    return _made(
        "fgpose_msgs/Camera",
        camera.name,
        camera.state.value,
        camera.reason,
        frame.published_s - known(camera.image_s),
        camera.rate_hz,
        known(camera.clock_offset_s),
        known(camera.clock_sigma_s),
        known(camera.motion_offset_s),
        known(camera.motion_sigma_s),
        camera.n_images,
        camera.n_used,
        camera.n_lost,
    )
