"""Which detections a result was made from, found again in the keypoints.

Files of keypoints do not say who is who. The result has the reprojection error of each joint in each image: of all
people in an image, as detected and with left and right exchanged, those detections are taken whose errors are these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.common_clock import on_common_clock
from fgpose.correspondences import NO_IMAGE
from fgpose.estimation.evidence.delays import image_motion_px
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.changing_rig import is_changing
from fgpose.io.keypoints import keypoint_cameras, load_people
from fgpose.io.names import seen_cameras
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.plain_files import naming
from fgpose.sampling import nearest, usual_step_s
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import lower_medians


def used_detections(
    path: Path, rig: CameraRig, people: Mapping[int, Trajectory], fps: float | None = None
) -> dict[int, Observations]:
    """What the cameras saw of each person, in the frames of the trajectory and in the order of its cameras. Each image
    has its time by the clock of the rig.

    Args:
        path: keypoints of any format.
        rig: at least the cameras of the result.
        people: the result. Where it has reprojection errors, only the joints that have one are given.
        fps: of keypoints without times.

    Raises:
        ValueError: the keypoints are damaged, or not of the recording of the result; the message names the file.
        OSError: they cannot be read.
    """
    first = next(iter(people.values()))
    wanted = first.camera_names or rig.names
    named = seen_cameras(keypoint_cameras(path), rig.names)
    if named:
        rig = rig.subset(name for name in rig.names if name in named or name in wanted)
    everybody = load_people(path, rig, first.skeleton, fps=fps, ignore_other_cameras=True)
    if is_changing(rig):
        together, pieces = on_common_clock(everybody, rig)
        images = _Images(together.subset(wanted), pieces.subset(wanted), np.zeros(len(wanted)))
        return _of_best([images], people, path)
    own = rig.subset(wanted)
    clocks = [_Images(everybody.subset(wanted), own, own.time_offsets_s)]
    together, _ = on_common_clock(everybody, rig)
    if together is not everybody:
        # The images were put together by the offsets, or these were only found later: as it fits the result better.
        clocks.append(_Images(together.subset(wanted), own, np.zeros(own.n_cameras)))
    return _of_best(clocks, people, path)


def _of_best(clocks: Sequence[_Images], people: Mapping[int, Trajectory], path: Path) -> dict[int, Observations]:
    """As the images fit the result best."""
    with naming(path):
        found = [{number: clock.of_person(each) for number, each in people.items()} for clock in clocks]
    best = min(found, key=lambda clock: sum(misfit_px for _, misfit_px in clock.values()))
    return {number: observations for number, (observations, _) in best.items()}


@dataclass(frozen=True, eq=False)
class _Images:
    """The images of a recording, put together by their times."""

    people: PeopleObservations
    rig: CameraRig
    offsets_s: Float[np.ndarray, " camera"]
    """From the times of the images to the clock of the rig."""

    def of_person(self, trajectory: Trajectory) -> tuple[Observations, float]:
        """What the cameras saw of a person, and by how much the reprojection errors differ from those of the result,
        mean over the images, pixels. Raises ValueError if there are no images of its frames."""
        image = self.people.frames.image[self._frames_of(trajectory)]
        time_s = np.repeat(trajectory.time_s[:, None], self.rig.n_cameras, axis=1) + self.offsets_s
        for c, name in enumerate(self.rig.names):
            taken = image[:, c] != NO_IMAGE
            time_s[taken, c] = self.people.times_s(name)[image[taken, c]] + self.offsets_s[c]
        delay_s = time_s - trajectory.time_s[:, None]
        moved_px = image_motion_px(trajectory.positions_m, trajectory.time_s, delay_s, self.rig)
        expected_px = self.rig.project(trajectory.positions_m) + moved_px
        chosen = []
        for c, candidates in enumerate(self._candidates):
            error_px = None if trajectory.residual_px is None else trajectory.residual_px[:, c]
            chosen.append(candidates.nearest(image[:, c], expected_px[:, c], error_px))
        seen = np.stack([of_camera for of_camera, _ in chosen], axis=1)
        names = self.rig.names
        observations = Observations(trajectory.skeleton, time_s, seen[..., :2], seen[..., 2], camera_names=names)
        misfit_px = np.concatenate([of_camera for _, of_camera in chosen])
        return observations, float(misfit_px[np.isfinite(misfit_px)].mean()) if np.isfinite(misfit_px).any() else np.inf

    def _frames_of(self, trajectory: Trajectory) -> Int[np.ndarray, " frame"]:
        """Of the recording."""
        # A frame of a result has the mean time at which its images were taken; in older ones that of its stamps.
        shifts_s = dict.fromkeys((float(self.offsets_s.mean()), 0.0))
        matched = [self._matched(trajectory.time_s - shift_s) for shift_s in shifts_s]
        frames, apart_s = min(matched, key=lambda each: float(each[1].max()))
        if apart_s.max() > usual_step_s(trajectory.time_s) / 2 or (np.diff(frames) <= 0).any():
            at_s = trajectory.time_s[int(apart_s.argmax())]
            raise ValueError(f"no frame at {at_s:.3f} s, where the result has one: are they of one recording?")
        return frames

    def _matched(
        self, time_s: Float[np.ndarray, " frame"]
    ) -> tuple[Int[np.ndarray, " frame"], Float[np.ndarray, " frame"]]:
        """The nearest frames of the recording, and how far off they are."""
        recorded_s = self.people.frames.frame_time_s
        frames = nearest(time_s, recorded_s)
        return frames, np.abs(recorded_s[frames] - time_s)

    @cached_property
    def _candidates(self) -> list[_Candidates]:
        images, mirror = self.people.by_camera, self.people.skeleton.mirror
        return [_Candidates.of(images[camera.name], camera, mirror) for camera in self.rig.cameras]


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Everybody in the images of one camera, as detected and with left and right exchanged."""

    seen: Float[np.ndarray, "image candidate joint 3"]
    """Pixels and confidence; NaN where an image shows fewer, and in an image more, which stands for none."""
    undistorted_px: Float[np.ndarray, "image candidate joint 2"]

    @staticmethod
    def of(images: Sequence[Detections], camera: Camera, mirror: Int[np.ndarray, " joint"]) -> _Candidates:
        n_most = max((image.n_people for image in images), default=0) or 1
        seen = np.full((len(images) + 1, n_most, len(mirror), 3), np.nan)
        for of_image, image in zip(seen, images, strict=False):
            of_image[: image.n_people, :, :2] = image.points2d_px
            of_image[: image.n_people, :, 2] = image.confidence
        seen = np.concatenate([seen, seen[:, :, mirror]], axis=1)
        return _Candidates(seen, camera.undistort(seen[..., :2]))

    def nearest(
        self,
        image: Int[np.ndarray, " frame"],
        expected_px: Float[np.ndarray, "frame joint 2"],
        error_px: Float[np.ndarray, "frame joint"] | None,
    ) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, " frame"]]:
        """The candidate of each frame whose reprojection errors differ least from those of the result, median over the
        joints, and this difference. It is zero up to the bias of the detector, which the result is free of."""
        own_px = np.linalg.norm(self.undistorted_px[image] - expected_px[:, None], axis=-1)
        wanted_px = np.zeros(1) if error_px is None else error_px[:, None]
        misfit_px = np.nan_to_num(lower_medians(np.abs(own_px - wanted_px)), nan=np.inf)
        best = np.argmin(misfit_px, axis=1)
        rows = np.arange(len(image))
        seen = self.seen[image, best]
        used = np.isfinite(misfit_px[rows, best])[:, None] & (True if error_px is None else np.isfinite(error_px))
        seen = np.where(used[..., None], seen, (np.nan, np.nan, 0.0))
        seen[..., 2] = np.nan_to_num(seen[..., 2])
        return seen, misfit_px[rows, best]
