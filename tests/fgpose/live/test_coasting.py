"""Where somebody is while images stay away, against the truth."""

from __future__ import annotations

import numpy as np

import fgpose
from fgpose.association.track import TrackState
from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import LivePerson
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, embedded_motion, ring_rig, simulate

_WITHIN_95 = 7.815  # chi-squared with three degrees of freedom


def test_who_runs_is_within_what_is_said() -> None:
    """Real motion, at 2.7 m/s."""
    motion_m, fps = embedded_motion("cmu_02_03_short")
    motion_m = motion_m - motion_m[:, :1].mean(axis=0) * [1.0, 1.0, 0.0]
    skeleton, rig = load_skeleton("h36m_17"), ring_rig(4)
    seen = simulate(motion_m, skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0).observations
    estimator, later = fgpose.Estimator(rig, skeleton), (round(0.2 * fps), round(0.4 * fps))
    squares: dict[int, list[np.ndarray]] = {n: [] for n in later}
    for k, frame in enumerate(seen):
        estimate = estimator.update(frame)
        if frame.frame_time_s[0] < 0.5:  # until then it is not known how they move
            continue
        assert estimate.covariance_m2 is not None
        all_seen = np.ones(skeleton.n_joints)
        person = LivePerson(
            1,
            TrackState.CONFIRMED,
            estimate.positions_m,
            estimate.covariance_m2,
            estimate.status,
            all_seen,
            velocity_mps=estimate.velocity_mps,
        )
        for n in later:
            if k + n < len(motion_m):
                gone = person.coasting(n / fps)
                off_m = gone.positions_m - motion_m[k + n]
                squares[n].append(np.einsum("ja,jab,jb->j", off_m, np.linalg.inv(gone.covariance_m2), off_m))
    for n in later:
        # 16 and 7 % without the speed of the body.
        assert np.mean(np.concatenate(squares[n]) < _WITHIN_95) > 0.95
