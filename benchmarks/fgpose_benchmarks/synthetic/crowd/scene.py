"""Scenes of several people: a true motion as the cameras of a rig would have seen it, each at its own times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.trajectory import Trajectory, joint_status
from fgpose_benchmarks.synthetic.crowd.bodies import Capsules, hidden_by
from fgpose_benchmarks.synthetic.crowd.errors import CameraTimes, CrowdErrors, FalsePerson, false_people
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.crowd.views import SimulatedDetections, TrueView, detect
from fgpose_benchmarks.synthetic.noise import DetectionNoise
from fgpose_benchmarks.synthetic.occlusion import Occlusion
from fgpose_benchmarks.synthetic.snapping import stretches


@dataclass(frozen=True, eq=False)
class CrowdScene:
    """People whose motion is known exactly, what the cameras saw of them, and what each detection is.

    The last four have one array for each image of the observations, in their order and with their people.
    """

    motion: CrowdMotion
    observations: PeopleObservations
    rig: CameraRig
    who: tuple[Int[np.ndarray, " _"], ...]
    """(P,) true person; -1: nobody, a false detection."""
    joint_of: tuple[Int[np.ndarray, "_ _"], ...]
    """(P, J) true person whose joint is really seen; -1: missing or hallucinated, or of a false person."""
    hidden: tuple[Bool[np.ndarray, "_ _"], ...]
    """(P, J) whether a body or furniture hides the joint from the camera; it may be detected all the same."""
    flipped: tuple[Bool[np.ndarray, " _"], ...]
    """(P,) whether left and right joints are interchanged; the other labels are interchanged with them."""

    def truth(self, time_s: Float[np.ndarray, " frame"]) -> dict[int, Trajectory]:
        """The true motion of each person at some times, as evaluate_people takes it."""
        positions_m = positions_at(self.motion, time_s)
        is_there = np.asarray(np.isfinite(positions_m).all(axis=-1))
        status = joint_status(is_there, is_there)
        return {
            person: Trajectory(self.motion.skeleton, time_s.copy(), positions_m[person].copy(), status[person].copy())
            for person in range(self.motion.n_people)
        }


def simulate_crowd(
    motion: CrowdMotion,
    rig: CameraRig,
    noise: DetectionNoise,
    occlusion: Occlusion,
    errors: CrowdErrors,
    seed: int,
    times: CameraTimes | None = None,
) -> CrowdScene:
    """What the cameras of the rig would have seen of these people.

    Bodies and furniture hide joints. Of the occlusion, only what becomes of a hidden joint is used, not its occluders:
    hallucination_px, correlation_s, missing_share and confidence; of a joint grabbed from somebody, snap_confidence.
    The same seed gives the same scene, and every kind of error has a stream of its own. A camera sees the people
    time_offset_s later than its images say.

    Raises:
        ValueError: the skeleton lacks a joint of the bodies that hide.
    """
    times, capsules = times or CameraTimes(), Capsules.of(motion.skeleton)
    duration_s = (motion.truth_m.shape[1] - 1) / motion.fps
    found = []
    for c, (camera, rng) in enumerate(zip(rig.cameras, np.random.default_rng(seed).spawn(rig.n_cameras), strict=True)):
        times_rng, detect_rng, false_rng, order_rng = rng.spawn(4)
        time_s = times.of(times_rng, c, duration_s)
        seen_m = positions_at(motion, time_s + camera.time_offset_s).swapaxes(0, 1)
        hider = hidden_by(camera.position_m, seen_m, capsules, motion.furniture, own_body=errors.own_body)
        view = TrueView(camera, motion.skeleton, times.fps[c % len(times.fps)], seen_m, hider)
        detected = detect(detect_rng, view, noise, occlusion, errors)
        false = false_people(false_rng, camera, view.true_px, duration_s, errors)
        found += _images(order_rng, view, time_s, detected, false, noise.sigma_px)
    found.sort(key=lambda image: (image.detections.time_s, rig.names.index(image.detections.camera)))
    observations = PeopleObservations(motion.skeleton, rig.names, tuple(image.detections for image in found))
    labels = (tuple(getattr(image, name) for image in found) for name in ("who", "joint_of", "hidden", "flipped"))
    return CrowdScene(motion, observations, rig, *labels)


def positions_at(motion: CrowdMotion, time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, "person time joint 3"]:
    """The true joints at any times: a spline through each stretch of presence; NaN outside, and in one of a frame."""
    from scipy.interpolate import CubicSpline

    positions_m = np.full((motion.n_people, len(time_s), *motion.truth_m.shape[2:]), np.nan)
    for person, there in enumerate(motion.is_there):
        for start, end in stretches(there):
            if end - start < 2:
                continue
            known_s = np.arange(start, end) / motion.fps
            inside = (time_s >= known_s[0] - 1e-9) & (time_s <= known_s[-1] + 1e-9)
            positions_m[person, inside] = CubicSpline(known_s, motion.truth_m[person, start:end])(time_s[inside])
    return positions_m


@dataclass(frozen=True, eq=False)
class _Image:
    """Detections of one image and what they are."""

    detections: Detections
    who: Int[np.ndarray, " person"]
    joint_of: Int[np.ndarray, "person joint"]
    hidden: Bool[np.ndarray, "person joint"]
    flipped: Bool[np.ndarray, " person"]


def _images(
    rng: np.random.Generator,
    view: TrueView,
    time_s: Float[np.ndarray, " image"],
    detected: SimulatedDetections,
    false: list[FalsePerson],
    sigma_px: float,
) -> list[_Image]:
    """All images of a camera, the people of each in random order."""
    n_joints = view.skeleton.n_joints
    n_people = view.hider.shape[1]
    images = []
    for t, image_s in enumerate(time_s.tolist()):
        present = [person for person in false if person.start_s <= image_s < person.end_s]
        false_px = np.array([person.points_px for person in present]).reshape(-1, n_joints, 2)
        false_px = false_px + sigma_px * rng.standard_normal(false_px.shape)
        there = np.flatnonzero(detected.is_there[t])
        order = rng.permutation(len(there) + len(present))
        points_px = np.concatenate([detected.points_px[t, there], false_px])[order]
        confidence = np.concatenate([detected.confidence[t, there], *(person.confidence[None] for person in present)])
        confidence = np.where(view.shows(points_px), confidence[order], 0.0)
        nobody = np.full((len(present), n_joints), -1)
        images.append(
            _Image(
                Detections(view.camera.name, image_s, _original_px(view.camera, points_px, confidence), confidence),
                np.concatenate([there % n_people, nobody[:, 0]])[order],
                np.concatenate([detected.joint_of[t, there], nobody])[order],
                np.concatenate([detected.hidden[t, there], np.zeros_like(nobody, dtype=bool)])[order],
                np.concatenate([detected.is_flipped[t, there], np.zeros(len(present), dtype=bool)])[order],
            )
        )
    return images


def _original_px(
    camera: Camera, undistorted_px: Float[np.ndarray, "person joint 2"], confidence: Float[np.ndarray, "person joint"]
) -> Float[np.ndarray, "person joint 2"]:
    return np.where(confidence[..., None] > 0, camera.distort(undistorted_px), np.nan)
