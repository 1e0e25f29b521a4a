"""Frames as a tracker would publish them, of people whose pose is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgpose.association.track import TrackState
from fgpose.finding import Code, Severity
from fgpose.live.frame import CameraState, CameraStatus, LiveFinding, LiveFrame, LiveJudgement, LivePerson
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status


def standing_m(skeleton: Skeleton, at_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """(J, 3): somebody upright with hanging arms who looks along y, of the joints of h36m_17."""
    middle = {"pelvis": 0.95, "spine": 1.2, "thorax": 1.4, "neck_base": 1.5, "head": 1.7}
    side = {"hip": (0.1, 0.95), "knee": (0.1, 0.5), "ankle": (0.1, 0.1), "shoulder": (0.2, 1.4)}
    side |= {"elbow": (0.25, 1.1), "wrist": (0.25, 0.85)}
    joints_m = {name: (0.0, 0.0, height) for name, height in middle.items()}
    for sign, prefix in ((-1, "left"), (1, "right")):
        joints_m |= {f"{prefix}_{name}": (sign * x, 0.0, height) for name, (x, height) in side.items()}
    return np.array([joints_m[name] for name in skeleton.joints]) + np.array([*at_m, 0.0])


def live_person(
    joints_m: np.ndarray,
    number: int = 1,
    sigma_m: float | np.ndarray = 0.0,
    state: TrackState = TrackState.CONFIRMED,
) -> LivePerson:
    """Somebody whose joints all have one standard deviation, or one for each axis."""
    covariance_m2 = np.broadcast_to(np.diag(np.broadcast_to(sigma_m, 3).astype(float) ** 2), (len(joints_m), 3, 3))
    known = np.isfinite(joints_m).all(axis=-1)
    status = np.where(known, Status.OBSERVED, Status.UNOBSERVABLE)
    return LivePerson(number, state, joints_m, covariance_m2, status, known.astype(float))


def live_frame(
    skeleton: Skeleton,
    people: Sequence[LivePerson] = (),
    time_s: float = 1000.0,
    *,
    cameras: Sequence[str] = (),
    lost: Sequence[str] = (),
    sequence: int = 0,
    delay_s: float = 0.02,
) -> LiveFrame:
    """A frame of these people; cameras are ok but for those that are lost."""
    status = [
        CameraStatus(name, CameraState.LOST, "nothing has come for 2.0 s") if name in lost
        else CameraStatus(name, CameraState.OK, "", time_s, 30.0, -0.012, 0.001, 900, 890, 2, unproven_s=0.0)
        for name in cameras
    ]  # fmt: skip
    share = 1.0 if len(cameras) - len(lost) >= 2 else 0.0
    since_s = time_s - 60.0
    return LiveFrame(sequence, time_s, time_s + delay_s, skeleton, tuple(people), tuple(status), share, since_s)


def live_judgement(camera: str = "b", time_s: float = 1000.0) -> LiveJudgement:
    """A camera is mirrored, by the minute before."""
    mirrored = f"The images of {camera} are mirrored"
    found = (
        LiveFinding(Code.MIRRORED_IMAGE, Severity.WRONG, mirrored, "Switch mirroring off.", camera),
        LiveFinding(Code.LATE_CAMERA, Severity.DOUBTFUL, "All are late", "Set the clocks.", from_s=time_s - 30.0),
    )
    return LiveJudgement(found, time_s - 62.0, time_s - 2.0, time_s, {"lenses": "it is short"})
