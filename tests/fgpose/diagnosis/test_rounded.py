"""Gaps that were filled along straight lines and rounded, or along curves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen.interpolated import interpolated_keypoints
from fgpose.diagnosis.seen.rounded import differences_px, filled_and_rounded
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from tests.fgpose.diagnosis.damaged import SKELETON, room, with_points

LIMBS = [SKELETON.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("wrist", "elbow", "ankle")]
GAPS = ((12, 34), (60, 88), (110, 135))


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(3, seed=3)


def filled(seen: Observations, known: list[int]) -> np.ndarray:
    """By a polynomial through images before and after each gap, counted from its ends."""
    points_px = seen.points2d_px.copy()
    for first, end in GAPS:
        frames = [first - before for before in known] + [end - 1 + after for after in known]
        frames = np.sort(frames)
        within, own_px = np.arange(first, end), seen.points2d_px[frames][:, :, LIMBS]
        if len(known) == 1:
            share = ((within - frames[0]) / (frames[1] - frames[0]))[:, None, None, None]
            points_px[first:end, :, LIMBS] = (1 - share) * own_px[0] + share * own_px[1]
        else:
            points_px[first:end, :, LIMBS] = CubicSpline(frames, np.nan_to_num(own_px))(within)
    return points_px


@pytest.mark.parametrize("decimals", [1, 0])
def test_gaps_that_were_filled_and_rounded(seen, rig, decimals: int) -> None:
    points_px = filled(seen, [1]).round(decimals)
    (finding,) = interpolated_keypoints(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity) == (Code.INTERPOLATED_KEYPOINTS, Severity.WRONG)
    filled_share = sum(end - first for first, end in GAPS) / seen.n_frames * len(LIMBS) / SKELETON.n_joints
    # With whole pixels only the long ones of joints that move; what a line passes before and after a gap counts too.
    assert 0.15 * filled_share <= finding.numbers["share"] <= 1.2 * filled_share


def test_gaps_that_were_filled_by_splines(seen, rig) -> None:
    points_px = filled(seen, [3, 2, 1])
    (finding,) = interpolated_keypoints(Examined.of(with_points(seen, points_px), rig))
    assert finding.code is Code.INTERPOLATED_KEYPOINTS
    assert "curves" in finding.reason


@pytest.mark.slow
@pytest.mark.parametrize("name", ["balance_openpose", "balance_blazepose"])
@pytest.mark.parametrize("step_px", [0.1, 1.0, 4.0])
def test_nothing_is_told_of_real_recordings_that_were_rounded(name: str, step_px: float) -> None:
    _, seen = fgpose.files.load_recording(name)
    for c in range(seen.n_cameras):
        rounded_px = step_px * np.round(seen.points2d_px[:, c] / step_px)
        assert not filled_and_rounded(rounded_px, differences_px(rounded_px, 2), step_px).any()
