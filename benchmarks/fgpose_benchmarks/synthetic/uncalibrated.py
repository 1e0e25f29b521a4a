"""Recordings of people by cameras that are not calibrated, each with a clock of its own, and the truth about both.

What the cameras deliver is what a calibration from people is given: 2D detections, and per-view 3D joints in the frame
of each camera, as a monocular network gives them. Its errors are those of the other scenes, and what matters to a
calibration more than to anything else: a bias of the joints that depends on the side from which the body is seen, the
same for all cameras, and in per-view 3D a bias of the depths, a body that is tilted and one of the wrong size.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.metrics import mean_known
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.crowd.bodies import VISIBLE, Capsules, hidden_by
from fgpose_benchmarks.synthetic.crowd.errors import CrowdErrors, spells
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.crowd.scene import positions_at
from fgpose_benchmarks.synthetic.noise import MIN_CONFIDENCE, DetectionNoise, joint_depth_m
from fgpose_benchmarks.synthetic.occlusion import NO_OCCLUSION, Occlusion, hallucination
from fgpose_benchmarks.synthetic.real_errors import real_errors
from fgpose_benchmarks.synthetic.scene import simulate
from fgpose_benchmarks.synthetic.snapping import stretches
from fgpose_benchmarks.synthetic.view_bias import ViewBias

_NOISE_FOCAL_PX = 1145.0  # the pixel errors of DetectionNoise are those of a camera with this focal length


@dataclass(frozen=True)
class SimulatedClocks:
    """How the cameras keep time. The clock of each begins with its video.

    Raises:
        ValueError: there is no rate, or a number is negative or not finite.
    """

    fps: tuple[float, ...] = (30.0,)
    """Rates that the files state, given to the cameras in turn."""
    max_start_s: float = 0.0
    """The videos begin up to so much after each other, the first at once; all end together."""
    min_drift_ppm: float = 0.0
    """The clocks go wrong by min_drift_ppm ..."""
    max_drift_ppm: float = 0.0
    """... to max_drift_ppm, too fast or too slow."""

    def __post_init__(self) -> None:
        if not self.fps or not all(0 < rate < np.inf for rate in self.fps):
            raise ValueError(f"SimulatedClocks.fps must be positive rates, got {self.fps}")
        if not (0 <= self.max_start_s < np.inf and 0 <= self.min_drift_ppm <= self.max_drift_ppm < np.inf):
            raise ValueError(
                "SimulatedClocks: max_start_s must not be negative, nor min_drift_ppm exceed max_drift_ppm"
            )

    def drawn(self, rng: np.random.Generator, n_cameras: int) -> tuple[np.ndarray, np.ndarray]:
        """True time at which the clock of each camera begins, and true seconds for each second of it."""
        start_s = rng.uniform(0.0, self.max_start_s, n_cameras)
        drift = rng.uniform(self.min_drift_ppm, self.max_drift_ppm, n_cameras) * rng.choice([-1.0, 1.0], n_cameras)
        return start_s - start_s.min(), 1.0 + 1e-6 * drift


@dataclass(frozen=True)
class SimulatedNetwork:
    """What a network for human poses makes of the images."""

    noise: DetectionNoise = field(default_factory=lambda: DetectionNoise(joint_depth_scale=0.7))
    """Its pixel errors grow with the focal length, as the person in the image does. Half of the variance of each
    joint's depth is noise, half is bias."""
    occlusion: Occlusion = NO_OCCLUSION
    """With n_views > 0, occluders are in every view at all times."""
    real: tuple[str, ...] = ()
    """Sources of real errors, one of which takes the place of the noise in the image; see real_errors."""
    min_bias_m: float = 0.02
    """View-dependent bias of each joint; see ViewBias."""
    max_bias_m: float = 0.04
    depth_bias_scale: float = 0.7
    """View-dependent bias of the depth of each joint in per-view 3D, relative to the measured SD of its depth."""
    tilt_sigma_deg: float = 3.0
    """Of the angle by which the per-view 3D of a camera is tilted about the horizontal of the image, the same at all
    times. With this and the bias, poses of one person on one spot lie 5 to 15 degrees off each other, as those of
    BlazePose do in balance_blazepose."""
    scale_sigma: float = 0.06
    """Of the size that the network takes each person for, as a share of the true size."""
    mistakes: CrowdErrors = field(default_factory=CrowdErrors)
    """Of these, who is missed or flipped, and how few joints are a person. No doubles, no false people."""
    in_3d: bool = True
    """Whether there are per-view 3D joints."""

    def seen_by(self, camera: Camera) -> SimulatedNetwork:
        """With errors in pixels of this camera, in which its occluders are in one view of one."""
        closer = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])) / _NOISE_FOCAL_PX
        noise, occlusion = self.noise, self.occlusion
        noise = replace(
            noise,
            sigma_px=closer * noise.sigma_px,
            correlated_px=closer * noise.correlated_px,
            outlier_px=closer * noise.outlier_px,
            confidence_fall_px=closer * noise.confidence_fall_px,
        )
        hallucination_px, n_views = closer * occlusion.hallucination_px, min(occlusion.n_views, 1)
        return replace(
            self, noise=noise, occlusion=replace(occlusion, hallucination_px=hallucination_px, n_views=n_views)
        )


@dataclass(frozen=True, eq=False)
class WalkScene:
    """What uncalibrated cameras deliver, and the truth."""

    observations: PeopleObservations
    """Each camera by its own clock; per-view 3D joints in the frame of each camera."""
    intrinsics: CameraRig
    """As they are given to a calibration: true or guessed. All poses are the identity."""
    rig: CameraRig
    """True cameras in the world of the motion. time_offset_s turns the clock of each camera into that of the first, at
    the middle of the time that all videos show."""
    motion: CrowdMotion
    """By true time."""
    start_s: Float[np.ndarray, " camera"]
    """True time at which the clock of each camera begins."""
    rate: Float[np.ndarray, " camera"]
    """True seconds for each second of the clock of each camera."""
    who: tuple[Int[np.ndarray, " _"], ...]
    """(P,) true person of each detection, for each image of the observations."""

    def true_s(self, camera: int, time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """True time of the clock of a camera."""
        return self.start_s[camera] + self.rate[camera] * time_s

    def joints_m(self, time_s: Float[np.ndarray, " time"], person: int = 0) -> Float[np.ndarray, "time joint 3"]:
        """True joints at times of the first camera's clock; NaN where the person is not there."""
        return positions_at(self.motion, self.true_s(0, time_s))[person]


def film(
    motion: CrowdMotion,
    rig: CameraRig,
    seed: int,
    network: SimulatedNetwork | None = None,
    clocks: SimulatedClocks | None = None,
    focal_guess: float | None = None,
) -> WalkScene:
    """People as uncalibrated cameras see them. The same seed gives the same scene.

    Args:
        focal_guess: the intrinsics are not known: focal lengths are the true ones times this, the principal point is
            the centre of the image, there is no distortion; per-view 3D is what comes of it.

    Raises:
        ValueError: a number of the network is out of range.
    """
    network, clocks = network or SimulatedNetwork(), clocks or SimulatedClocks()
    clock_rng, bias_rng, person_rng, *camera_rngs = np.random.default_rng(seed).spawn(3 + rig.n_cameras)
    start_s, rate = clocks.drawn(clock_rng, rig.n_cameras)
    if network.real:
        network = replace(network, real=(network.real[int(person_rng.integers(len(network.real)))],))
    bias = ViewBias.drawn(bias_rng, motion.skeleton, network.min_bias_m, network.max_bias_m)
    size = 1.0 + network.scale_sigma * np.clip(person_rng.standard_normal(motion.n_people), -2.0, 2.0)
    tilts = bias_rng.standard_normal(rig.n_cameras)
    duration_s = (motion.truth_m.shape[1] - 1) / motion.fps
    images: list[tuple[Detections, np.ndarray]] = []
    intrinsics = []
    for c, (camera, rng) in enumerate(zip(rig.cameras, camera_rngs, strict=True)):
        fps = clocks.fps[c % len(clocks.fps)]
        time_s = np.arange(int((duration_s - start_s[c]) / rate[c] * fps + 1e-9) + 1) / fps
        seen_m = positions_at(motion, start_s[c] + rate[c] * time_s)
        given = _given(camera, focal_guess)
        view = _View(camera, given, motion.skeleton, fps, seen_m, float(tilts[c]))
        its_network = network.seen_by(camera)
        people = [
            view.detected(person_rng, person, its_network, bias, float(size[person]))
            for person, person_rng in enumerate(rng.spawn(motion.n_people))
        ]
        images += view.images(rng, time_s, people, in_3d=network.in_3d)
        intrinsics.append(given)
    order = sorted(range(len(images)), key=lambda n: (images[n][0].time_s, rig.names.index(images[n][0].camera)))
    own_s = ((start_s.max() + duration_s) / 2 - start_s) / rate
    true_rig = rig.with_time_offsets(own_s[0] - own_s)
    observations = PeopleObservations(motion.skeleton, rig.names, tuple(images[n][0] for n in order))
    who = tuple(images[n][1] for n in order)
    return WalkScene(observations, CameraRig(tuple(intrinsics)), true_rig, motion, start_s, rate, who)


def _given(camera: Camera, focal_guess: float | None) -> Camera:
    """What is known of a camera beforehand."""
    if focal_guess is None:
        return replace(camera, world_T_camera=np.eye(4), time_offset_s=0.0)
    focal_px = focal_guess * float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    width, height = camera.size_px
    K = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
    return Camera(camera.name, camera.size_px, K, np.eye(4), np.zeros(0))


@dataclass(frozen=True, eq=False)
class _Person:
    """One person in all images of a camera; NaN and 0 where missing."""

    points2d_px: Float[np.ndarray, "image joint 2"]
    confidence: Float[np.ndarray, "image joint"]
    points3d_m: Float[np.ndarray, "image joint 3"]


@dataclass(frozen=True, eq=False)
class _View:
    """The truth as one camera sees it."""

    camera: Camera
    given: Camera
    skeleton: Skeleton
    fps: float
    seen_m: Float[np.ndarray, "person image joint 3"]
    """World frame; NaN where a person is not there."""
    tilt: float
    """Of per-view 3D, in standard deviations."""

    def detected(
        self, rng: np.random.Generator, person: int, network: SimulatedNetwork, bias: ViewBias, size: float
    ) -> _Person:
        n_images, n_joints = self.seen_m.shape[1:3]
        tilt = np.tan(np.deg2rad(network.tilt_sigma_deg) * self.tilt)
        points2d_px, points3d_m = np.full((n_images, n_joints, 2), np.nan), np.full((n_images, n_joints, 3), np.nan)
        confidence = np.zeros((n_images, n_joints))
        for start, end in stretches(np.isfinite(self.seen_m[person]).all(axis=(1, 2))):
            there = slice(start, end)
            seen_m, camera_m = self.seen_m[person, there], self.camera.position_m
            biased_m = bias.seen_m(seen_m, camera_m, self.skeleton)
            points2d_px[there], confidence[there], in_camera_m = self._simulated(rng, biased_m, network)
            farther_m = network.depth_bias_scale * joint_depth_m(self.skeleton)
            farther_m = farther_m * bias.relative_depth(seen_m, camera_m, self.skeleton)
            down_m = self.camera.to_camera_frame(seen_m)[..., 1]
            farther_m += tilt * (down_m - down_m.mean(axis=1, keepdims=True))
            points3d_m[there] = self._in_3d(points2d_px[there], in_camera_m, farther_m, size)
        return self._with_mistakes(rng, _Person(points2d_px, confidence, points3d_m), person, network)

    def _simulated(
        self, rng: np.random.Generator, seen_m: Float[np.ndarray, "image joint 3"], network: SimulatedNetwork
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels of the original image, confidence, and 3D joints in the frame of the camera."""
        alone = CameraRig((replace(self.camera, world_T_camera=np.eye(4)),))
        real = None
        if network.real:
            real = real_errors(rng, len(seen_m), 1, self.skeleton, self.fps, network.real)
        in_camera_m, seed = self.camera.to_camera_frame(seen_m), int(rng.integers(2**32))
        scene = simulate(in_camera_m, self.skeleton, alone, self.fps, network.noise, network.occlusion, seed, real=real)
        observed = scene.observations
        assert observed.points3d_m is not None
        return observed.points2d_px[:, 0], observed.confidence[:, 0], observed.points3d_m[:, 0]

    def _in_3d(
        self,
        points2d_px: Float[np.ndarray, "image joint 2"],
        in_camera_m: Float[np.ndarray, "image joint 3"],
        farther_m: Float[np.ndarray, "image joint"],
        size: float,
    ) -> Float[np.ndarray, "image joint 3"]:
        """What a network makes of it that takes the body for another size and knows the intrinsics as given: distances
        are proportional to both, the depth within the body only to the size."""
        depth_m = in_camera_m[..., 2:]
        away_m = mean_known(depth_m[..., 0], axis=1)[:, None, None]
        beside_m = in_camera_m[..., :2] - _slope(self.camera, points2d_px) * depth_m
        closer = np.sqrt(np.prod(np.diag(self.given.K)[:2] / np.diag(self.camera.K)[:2]))
        depth_m = size * (depth_m + (closer - 1.0) * away_m + farther_m[..., None])
        return np.concatenate([_slope(self.given, points2d_px) * depth_m + size * beside_m, depth_m], axis=-1)

    def _with_mistakes(
        self, rng: np.random.Generator, found: _Person, person: int, network: SimulatedNetwork
    ) -> _Person:
        """Joints behind other people are hallucinated or missing; then the whole body is flipped or missed."""
        mistakes, occlusion, n_images = network.mistakes, network.occlusion, len(found.confidence)
        people_m = self.seen_m.swapaxes(0, 1)
        hidden = np.zeros(found.confidence.shape, dtype=bool)
        if len(self.seen_m) > 1:
            hider = hidden_by(self.camera.position_m, people_m, Capsules.of(self.skeleton))[:, person]
            hidden = np.asarray(hider != VISIBLE)
        invented = hallucination(rng, (n_images, 1, self.skeleton.n_joints), self.fps, occlusion)
        seen_joints = ((found.confidence > 0) & ~hidden).sum(axis=-1)
        missed = spells(rng, (n_images,), self.fps, mistakes.missed_share, mistakes.missed_s)
        missed |= seen_joints < mistakes.min_visible_joints
        gone = missed[:, None] | (hidden & invented.missing[:, 0])
        points2d_px = found.points2d_px + np.where(hidden[..., None], invented.pixel_px[:, 0], 0.0)
        confidence = found.confidence * np.where(hidden, occlusion.confidence / network.noise.confidence, 1.0)
        flipped = spells(rng, (n_images,), self.fps, mistakes.flipped_share, mistakes.flipped_s)
        joint = np.where(flipped[:, None], self.skeleton.mirror, np.arange(self.skeleton.n_joints))
        gone |= ~self._shows(points2d_px)
        confidence = np.where(gone, 0.0, np.clip(confidence, MIN_CONFIDENCE, 1.0))
        arrays = np.where(gone[..., None], np.nan, points2d_px), np.where(gone[..., None], np.nan, found.points3d_m)
        points2d_px, points3d_m = (np.take_along_axis(array, joint[..., None], axis=1) for array in arrays)
        return _Person(points2d_px, np.take_along_axis(confidence, joint, axis=1), points3d_m)

    def _shows(self, points2d_px: Float[np.ndarray, "image joint 2"]) -> np.ndarray:
        """Whether points of the original image are inside it; not where they are NaN."""
        return np.all((points2d_px >= 0) & (points2d_px < self.camera.size_px), axis=-1)

    def images(
        self, rng: np.random.Generator, time_s: Float[np.ndarray, " image"], people: list[_Person], *, in_3d: bool
    ) -> list[tuple[Detections, np.ndarray]]:
        """All images of the camera with who is in them, in random order."""
        found = []
        for t, image_s in enumerate(time_s.tolist()):
            there = np.array([n for n, person in enumerate(people) if person.confidence[t].any()], dtype=int)
            order = there[rng.permutation(len(there))]
            n_joints = self.skeleton.n_joints
            points2d_px = np.array([people[n].points2d_px[t] for n in order]).reshape(-1, n_joints, 2)
            confidence = np.array([people[n].confidence[t] for n in order]).reshape(-1, n_joints)
            points3d_m = np.array([people[n].points3d_m[t] for n in order]).reshape(-1, n_joints, 3)
            given_3d = points3d_m if in_3d else None
            found.append((Detections(self.camera.name, image_s, points2d_px, confidence, given_3d), order))
        return found


def _slope(camera: Camera, points2d_px: Float[np.ndarray, "image joint 2"]) -> Float[np.ndarray, "image joint 2"]:
    """Rays of the original image at unit depth."""
    return (camera.undistort(points2d_px) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
