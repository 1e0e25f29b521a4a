"""The entity paths of a recording, which batch, live and blueprint share."""

from __future__ import annotations

import rerun as rr

from fgpose.skeleton import LIMBS, Skeleton

WORLD = "world"
REPROJECTION_PX = "plots/reprojection_px"
BONE_LENGTH = "plots/bone_length"
WEIGHT = "plots/weight"
RESIDUAL = "plots/residual"
UPDATE_MS = "plots/update_ms"
STATUS = "status"
RESIDUAL_TABLE = "residuals"
N_PEOPLE = "plots/people"
UNUSED = "plots/unused"
TRACKS = "tracks"
EVENTS = "events"
CAMERA_EVENTS = "events/cameras"
RECORDING_EVENTS = "events/recording"
DIAGNOSIS_EVENTS = "events/diagnosis"
CAMERA_STATES = "cameras"
DELAY_MS = "plots/delay_ms"
OBSERVED = "plots/observed"
EPIPOLAR_PX = "plots/epipolar_px"
WALKED = "world/walked"
FLOOR = "world/floor"
VERTICAL = "world/vertical"
CAMERA_SIGMAS = "world/camera_sigmas"
CAMERAS_BEFORE = "world/cameras_before"
CAMERA_MOVES = "world/camera_moves"
CAMERA_NAMES = "world/camera_names"
VIEWS = "world/views"
REPORT = "report"
CAMERA_LEGEND = "legend/cameras"
LIMB_LEGEND = "legend/limbs"


def join(*parts: str) -> str:
    """Entity path of parts; the first is a path, every other one a name, whatever characters it has."""
    return "/".join((parts[0], *map(rr.escape_entity_path_part, parts[1:])))


def camera(name: str) -> str:
    return join("world/camera", name)


def image(camera_name: str) -> str:
    return f"{camera(camera_name)}/image"


def picture(camera_name: str) -> str:
    return f"{image(camera_name)}/picture"


def detections(camera_name: str) -> str:
    return f"{image(camera_name)}/detections"


def coverage(camera_name: str) -> str:
    return f"{image(camera_name)}/coverage"


def reprojections(camera_name: str, trajectory: str) -> str:
    return join(f"{image(camera_name)}/reprojections", trajectory)


def view(camera_name: str) -> str:
    return join(VIEWS, camera_name)


def trajectory(name: str) -> str:
    """Of a result, or of a person."""
    return join(WORLD, name)


def person(number: int) -> str:
    """Of a person, in place of the name of a result. The viewer shows a space in a path as a backslash and a space."""
    return f"person_{number}"


def label(name: str) -> str:
    """Of the number of a person, or the name of a result, above them."""
    return f"{trajectory(name)}/label"


def limb_names(skeleton: Skeleton) -> tuple[str, ...]:
    """One name per limb pair: eq. 4's where the skeleton has all of them, else that of the left bone."""
    if len(skeleton.limbs) == len(LIMBS):
        return LIMBS
    return tuple(skeleton.bone_name(limb) for limb in skeleton.limbs)


def limb_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """The joints whose residuals are plotted one by one: those of the limbs, or all where no limb is named."""
    joints = {joint for pair in skeleton.limb_pairs for bone in pair for joint in bone}
    return tuple(sorted(joints)) or tuple(range(skeleton.n_joints))
