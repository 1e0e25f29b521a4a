"""Conventions of camera poses that are mistaken for each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis
from fgpose.diagnosis.hypotheses.scene import Scene
from fgpose.finding import Code

Pose = Float[np.ndarray, "4 4"]
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


class Convention(NamedTuple):
    """How a pose was meant, from how it was read."""

    meant: Callable[[Pose], Pose]
    words: str


def _joined(R: Float[np.ndarray, "3 3"], position_m: Float[np.ndarray, 3]) -> Pose:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, position_m
    return pose


_AS_READ = Convention(lambda pose: pose, "")
_OF_PLACES = (
    _AS_READ,
    Convention(
        lambda pose: _joined(pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]),
        "the poses are stored from the camera to the world, not from the world to the camera",
    ),
    Convention(
        lambda pose: _joined(pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]),
        "what is stored as translation is the position of the camera",
    ),
    Convention(lambda pose: _joined(pose[:3, :3].T, pose[:3, 3]), "the rotations are stored transposed"),
)
_OF_AXES = (
    _AS_READ,
    Convention(
        lambda pose: pose @ _OPENGL,
        "the cameras have the axes of OpenGL (y up, z backwards), not of OpenCV (y down, z forwards)",
    ),
)


def pose_hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    """Of all cameras alike."""
    for place in _OF_PLACES:
        for axes in _OF_AXES:
            words = " and ".join(each.words for each in (place, axes) if each.words)
            if words:
                yield _hypothesis(scene, place, axes, words)


def _hypothesis(scene: Scene, place: Convention, axes: Convention, words: str) -> Hypothesis:
    def mend(given: Scene) -> Scene:
        views = {c: view.at(axes.meant(place.meant(view.camera.world_T_camera))) for c, view in enumerate(given.views)}
        return given.with_views(views)

    return Hypothesis(
        Code.CAMERA_AXES,
        tuple(range(scene.n_cameras)),
        mend,
        f"The calibration is read in another convention than it was written in: {words}",
        "Convert it: fgpose reads x_camera = R x_world + t, with x to the right, y down and z forwards in the camera.",
    )
