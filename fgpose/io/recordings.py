"""The recordings that come with fgpose: real detections of calibrated cameras, to try things on."""

from __future__ import annotations

from functools import cache
from importlib import resources

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_rig
from fgpose.io.keypoints import load_observations
from fgpose.observations import Observations

_SKELETONS = {"balance_blazepose": "blazepose_33", "balance_openpose": "body_25b"}


def recordings() -> tuple[str, ...]:
    """Names of the recordings that come with fgpose; the README beside each says what it is and whose."""
    return tuple(_SKELETONS)


@cache
def load_recording(name: str) -> tuple[CameraRig, Observations]:
    """Cameras and observations of a recording by name.

    - balance_openpose: OpenPose (BODY_25B) of a man on one leg; 100 frames at 60 fps, 4 cameras.
    - balance_blazepose: the same by BlazePose (33 landmarks), with per-view 3D joints.

    Raises:
        ValueError: no recording has this name.
    """
    if name not in _SKELETONS:
        raise ValueError(f"no recording {name!r}; there is {', '.join(recordings())}")
    folder = resources.files("fgpose").joinpath("data", name)
    with resources.as_file(folder.joinpath("calibration.toml")) as path:
        rig = load_rig(path)
    with resources.as_file(folder.joinpath("observations.npz")) as path:
        return rig, load_observations(path, rig, _SKELETONS[name])
