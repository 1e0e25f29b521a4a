"""What a live system says of itself: after how many seconds it names a damage, and whether it names any where there is
none.

    python benchmarks/live_diagnosis.py               # damaged sessions
    python benchmarks/live_diagnosis.py --healthy     # sessions of two minutes and more
    python benchmarks/live_diagnosis.py --untracked   # of the diagnosis alone: half of the time

Cameras, people and time are simulated; tracking and diagnosis are real. Each diagnosis is waited for, where time stands
still: what it takes is told beside it. Prints a table, and exits with 1 if a damage is not named or something is named
that is not there.
"""

from __future__ import annotations

import argparse
import logging
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import fgpose
from fgpose.finding import Code
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import zoomed
from fgpose.live.clock import SimulatedClock
from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
from fgpose.live.frame import CameraState, LiveFrame, LiveJudgement
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking, Update
from fgpose.live.tracking.observed import volume_points_m
from fgpose.people_observations import Detections
from fgpose.pipeline.diagnosed import diagnose_people
from fgpose_benchmarks.faults.take import RIGS, takes
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdMotion,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    simulate_crowd,
)
from simulated_cameras import SimulatedCameras

START_S = 1.7e9
CONFIG = fgpose.Config(tracking={"max_processes": 1})
_TRUTH_FPS = 60.0
_DAMAGED_S, _HEALTHY_S = 60.0, 135.0
_LATE_S = 0.3

Images = Mapping[str, Sequence[Detections]]


@dataclass(frozen=True, eq=False)
class Session:
    """Who is there, and how they are seen."""

    n_people: int = 1
    n_cameras: int = 4
    rate_hz: float = 30.0
    duration_s: float = _DAMAGED_S
    seed: int = 1
    stands: bool = False
    """Somebody stands still, and sways."""
    leaves_s: float = np.inf
    """All are gone from then on."""

    @property
    def rig(self) -> CameraRig:
        names = list(RIGS)
        (found,) = [take.rig for take in takes(seconds=1.0) if take.rig_name == names[self.n_cameras - 2]][:1]
        return found

    def images(self) -> Images:
        """What the detectors find, image by image."""
        times = CameraTimes(fps=(self.rate_hz,))
        scene = simulate_crowd(self.motion(), self.rig, DetectionNoise(), Occlusion(), CrowdErrors(), self.seed, times)
        return {name: tuple(map(self._while_there, images)) for name, images in scene.observations.by_camera.items()}

    def motion(self) -> CrowdMotion:
        walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
        n_frames = int(self.duration_s * _TRUTH_FPS) + 30
        motion = crowd_motion(self.n_people, 300 if self.stands else n_frames, _TRUTH_FPS, walks, works, self.seed)
        if not self.stands:
            return motion
        time_s, height_m = np.arange(n_frames) / _TRUTH_FPS, motion.truth_m[:, 150, :, 2:]
        sway_m = 0.01 * np.stack([np.sin(1.9 * time_s), np.cos(1.3 * time_s)], axis=-1)[:, None] * height_m[:, None]
        truth_m = np.repeat(motion.truth_m[:, 150][:, None], n_frames, axis=1)
        truth_m[..., :2] += sway_m
        return replace(motion, truth_m=truth_m, events=())

    def _while_there(self, image: Detections) -> Detections:
        if image.time_s < self.leaves_s:
            return image
        return Detections(image.camera, image.time_s, image.points2d_px[:0], image.confidence[:0])


@dataclass(frozen=True)
class Damage:
    """What is wrong, and how it is named."""

    name: str
    codes: tuple[Code, ...]
    to_images: Callable[[Images, CameraRig], Images] = lambda images, rig: images
    to_rig: Callable[[CameraRig], CameraRig] = lambda rig: rig


def _changed(change: Callable[[Detections, Camera], np.ndarray]) -> Callable[[Images, CameraRig], Images]:
    """Of the second camera the pixels of each image."""

    def of(images: Images, rig: CameraRig) -> Images:
        camera = rig.cameras[1]
        changed = [replace(each, points2d_px=change(each, camera)) for each in images[camera.name]]
        return {**images, camera.name: changed}

    return of


def _mirrored(image: Detections, camera: Camera) -> np.ndarray:
    return np.stack([camera.size_px[0] - 1 - image.points2d_px[..., 0], image.points2d_px[..., 1]], axis=-1)


def _given(order: Mapping[int, int]) -> Callable[[Images, CameraRig], Images]:
    """Cameras with the keypoints of others."""

    def of(images: Images, rig: CameraRig) -> Images:
        names = rig.names
        others = {names[a]: [replace(each, camera=names[a]) for each in images[names[b]]] for a, b in order.items()}
        return {**images, **others}

    return of


def _late(images: Images, rig: CameraRig) -> Images:
    """The second camera shows what was 0.3 s ago."""
    name = rig.names[1]
    own = images[name]
    n = round(_LATE_S / (own[1].time_s - own[0].time_s))
    late = [replace(own[max(k - n, 0)], time_s=each.time_s) for k, each in enumerate(own)]
    return {**images, name: late}


def _filtered(share: float) -> Callable[[Images, CameraRig], Images]:
    """Each detector lets so much of what is new pass; of one person."""

    def of_camera(images: Sequence[Detections]) -> list[Detections]:
        last_px, filtered = None, []
        for image in images:
            if image.n_people != 1:
                last_px = None
                filtered.append(image)
                continue
            px = image.points2d_px[0]
            is_known = last_px is not None and np.isfinite(last_px)
            last_px = px if last_px is None else np.where(is_known, last_px + share * (px - last_px), px)
            filtered.append(replace(image, points2d_px=last_px[None]))
        return filtered

    return lambda images, rig: {name: of_camera(own) for name, own in images.items()}


def _smoothed(sigma_s: float) -> Callable[[Images, CameraRig], Images]:
    """Each detector smooths over past and future; of one person."""
    from scipy.ndimage import gaussian_filter1d

    def of_camera(images: Sequence[Detections]) -> list[Detections]:
        alone = [k for k, image in enumerate(images) if image.n_people == 1]
        px = np.stack([images[k].points2d_px[0] for k in alone])
        known = np.isfinite(px)
        sigma = sigma_s / (images[1].time_s - images[0].time_s)
        weights = gaussian_filter1d(known.astype(float), sigma, axis=0)
        smooth = gaussian_filter1d(np.where(known, px, 0.0), sigma, axis=0) / np.maximum(weights, 1e-9)
        changed = dict(zip(alone, np.where(known, smooth, np.nan), strict=True))
        return [
            replace(image, points2d_px=changed[k][None]) if k in changed else image for k, image in enumerate(images)
        ]

    return lambda images, rig: {name: of_camera(own) for name, own in images.items()}


def _in_millimetres(rig: CameraRig) -> CameraRig:
    def of(camera: Camera) -> Camera:
        pose = camera.world_T_camera.copy()
        pose[:3, 3] *= 1000.0
        return replace(camera, world_T_camera=pose)

    return CameraRig(tuple(map(of, rig.cameras)))


def _zoomed(rig: CameraRig) -> CameraRig:
    return CameraRig(tuple(zoomed(each, 1.25) if c == 1 else each for c, each in enumerate(rig.cameras)))


DAMAGES = (
    Damage("mirrored camera", (Code.MIRRORED_IMAGE,), _changed(_mirrored)),
    Damage("two cameras exchanged", (Code.EXCHANGED_CAMERAS,), _given({0: 1, 1: 0})),
    Damage("half-size images of one camera", (Code.IMAGE_SIZE,), _changed(lambda image, _: image.points2d_px / 2)),
    Damage("rig in millimetres", (Code.UNIT,), to_rig=_in_millimetres),
    Damage("smoothed over 0.2 s", (Code.SMOOTHED_KEYPOINTS,), _smoothed(0.2)),
    Damage("filtered, a third passes", (Code.SMOOTHED_KEYPOINTS,), _filtered(1 / 3)),
    Damage("one camera's keypoints twice", (Code.EXCHANGED_CAMERAS,), _given({1: 0})),
    Damage("late by 0.3 s", (Code.LATE_CAMERA,), _late),
    Damage("zoomed by 1.25", (Code.WRONG_LENS, Code.WRONG_CAMERA, Code.MOVED_CAMERA), to_rig=_zoomed),
)
HEALTHY = {
    "one person": Session(),
    "one person, another walk": Session(seed=2),
    "two people": Session(n_people=2, seed=3),
    "three people": Session(n_people=3, seed=4),
    "somebody who stands still": Session(seed=5, stands=True),
    "somebody who leaves": Session(seed=6, leaves_s=70.0),
    "one person, 15 Hz": Session(seed=7, rate_hz=15.0),
    "one person, 60 Hz": Session(seed=8, rate_hz=60.0),
    "one person, two cameras": Session(seed=9, n_cameras=2),
    "one person, three cameras": Session(seed=10, n_cameras=3),
    "two people, two cameras": Session(n_people=2, seed=11, n_cameras=2),
    "two people, three cameras, 15 Hz": Session(n_people=2, seed=12, n_cameras=3, rate_hz=15.0),
}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was said."""

    judgements: tuple[LiveJudgement, ...]
    """One after the other."""
    doubtful: Mapping[str, float]
    """Seconds after the beginning at which a camera was doubtful first."""
    child_s: float
    """Processor time of each diagnosis."""
    wall_s: float

    def first(self, codes: Sequence[Code]) -> float:
        """After how many seconds one of these was said; NaN: never."""
        for judgement in self.judgements:
            if any(finding.code in codes for finding in judgement.findings):
                return (judgement.judged_s or np.nan) - START_S
        return np.nan

    def others(self, codes: Sequence[Code]) -> dict[str, float]:
        """What else was said, and when first, seconds."""
        found: dict[str, float] = {}
        for judgement in self.judgements:
            for finding in judgement.findings:
                if finding.code not in codes:
                    name = f"{finding.severity}: {finding.code} {finding.camera}".strip()
                    found.setdefault(name, (judgement.judged_s or np.nan) - START_S)
        return found


class Heard:
    """A consumer that keeps what was said."""

    def __init__(self) -> None:
        self.judgements = list[LiveJudgement]()
        self.doubtful = dict[str, float]()

    def publish(self, frame: LiveFrame) -> None:
        if frame.diagnosis is not None:
            self.judged(frame.diagnosis)
        for camera in frame.cameras:
            if camera.state is CameraState.DOUBTFUL:
                self.doubtful.setdefault(f"{camera.name}: {camera.reason}", frame.published_s - START_S)

    def judged(self, said: LiveJudgement) -> None:
        if said.is_judged and (not self.judgements or self.judgements[-1].judged_s != said.judged_s):
            self.judgements.append(said)


def run(session: Session, damage: Damage | None = None, *, is_tracked: bool = True) -> Outcome:
    """A live system with these cameras."""
    images, rig = session.images(), session.rig
    if damage is not None:
        images, rig = damage.to_images(images, rig), damage.to_rig(rig)
    clock, heard, skeleton = SimulatedClock(START_S), Heard(), session.motion().skeleton
    feed = SimulatedCameras(rig, clock, lambda name, n: images[name][n], session.rate_hz, 0.3, session.seed)
    began_s, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    diagnosis = LiveDiagnosis(rig, skeleton, diagnose_people, now_s=clock.now_s, waits=True)
    end_s = START_S + session.duration_s
    if is_tracked:
        tracking = LiveTracking(rig, skeleton, CONFIG, volume_points_m(rig))
        LiveSystem(feed, tracking, (heard,), (), clock, diagnosis=diagnosis).run(end_s)
    while clock.now_s() < end_s:
        diagnosis.observe(Update(tuple(feed.take(0.1)), (), ()))
        heard.judged(diagnosis.said)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    child_s = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    n_judged = max(len(heard.judgements), 1)
    return Outcome(tuple(heard.judgements), heard.doubtful, child_s / n_judged, time.monotonic() - began_s)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--healthy", action="store_true", help="sessions without a damage")
    parser.add_argument("--only", default="", help="those whose name contains this")
    parser.add_argument("--people", type=int, default=1, help="in damaged sessions")
    parser.add_argument("--seed", type=int, default=1, help="other people on other ways")
    parser.add_argument("--untracked", action="store_true", help="without the tracker, and so without states")
    parser.add_argument("--verbose", action="store_true", help="with what is said")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.ERROR)
    if options.healthy:
        later = 100 * (options.seed - 1)
        sessions = [
            (name, replace(each, duration_s=_HEALTHY_S, seed=each.seed + later), None) for name, each in HEALTHY.items()
        ]
    else:
        damaged = Session(n_people=options.people, seed=options.seed)
        sessions = [(damage.name, damaged, damage) for damage in DAMAGES]
    is_right = True
    print("| session | said after [s] | diagnoses | also said [s] | first doubtful camera [s] | child [s each] |")
    print("|---|---|---|---|---|---|", flush=True)
    for name, session, damage in sessions:
        if options.only not in name:
            continue
        codes = () if damage is None else damage.codes
        outcome = run(session, damage, is_tracked=not options.untracked)
        first_s, others = outcome.first(codes), outcome.others(codes)
        is_right &= not others if damage is None else bool(np.isfinite(first_s))
        also = "; ".join(f"{what} {at_s:.0f}" for what, at_s in others.items()) or "-"
        doubtful = min(outcome.doubtful.values(), default=np.nan)
        row = (name, f"{first_s:.0f}", str(len(outcome.judgements)), also, f"{doubtful:.1f}", f"{outcome.child_s:.1f}")
        print(f"| {' | '.join(row)} |", flush=True)
        if options.verbose:
            for reason, at_s in outcome.doubtful.items():
                print(f"    {at_s:.1f} s: {reason}")
            for judgement in outcome.judgements:
                print("   ", judgement)
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"\nThe largest process of the diagnosis took {peak_mb:.0f} MB.")
    return 0 if is_right else 1


if __name__ == "__main__":
    raise SystemExit(main())
