"""Recordings are right again with what was found to change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fgpose
from fgpose.association.common_clock import on_common_clock
from fgpose.calibration.changes.change import Change, Kind, with_changes
from fgpose.calibration.self_calibration import calibrate_cameras
from fgpose.geometry.changing_rig import after, in_pieces, is_changing, later_s, put_together, with_later_clock
from tests.fgpose.calibration.changes.changing import FPS, RIG, bumped, filmed, late, slower, walk_m


def error_mm(seen: fgpose.Observations, rig: fgpose.CameraRig, truth_m: np.ndarray) -> float:
    """95 % quantile, at the times of the frames."""
    smoothed = fgpose.smooth(seen, rig)
    number = smoothed.time_s * FPS
    inside = (number >= 0) & (number <= len(truth_m) - 1)
    before = np.floor(number[inside]).astype(int).clip(max=len(truth_m) - 2)
    share = (number[inside] - before)[:, None, None]
    at_m = (1 - share) * truth_m[before] + share * truth_m[before + 1]
    return 1000 * float(np.quantile(np.linalg.norm(smoothed.positions_m[inside] - at_m, axis=-1), 0.95))


@pytest.mark.slow
def test_a_recording_is_mended() -> None:
    """Lost frames too: tests/benchmarks/faults/test_faults."""
    truth_m = walk_m(3)
    seen = filmed(truth_m)
    right_mm = error_mm(seen, RIG, truth_m)
    damaged = (
        (slower(seen, 2, 1.01, truth_m), "clocks"),
        (late(seen, 2, 39), "clocks"),
        (bumped(seen, 1, 2.0, 420, truth_m), "poses"),
    )
    for wrong, what in damaged:
        found = calibrate_cameras(wrong, RIG, poses=what == "poses", clocks=what == "clocks")
        # A fifth is what is promised.
        assert error_mm(found.observations, found.rig, truth_m) < 1.2 * right_mm, what


def test_a_bumped_camera_becomes_two() -> None:
    truth_m = walk_m(3)
    given = RIG.subset(RIG.names[:3])
    seen = bumped(filmed(truth_m), 1, 2.0, 420, truth_m).subset(given.names)
    bump = Change(Kind.BUMP, 1, at_s=14.0, rotation=np.deg2rad([0.0, 2.0, 0.0]))
    changed = with_changes(given, (bump,), poses=True, clocks=True)
    together, rig = on_common_clock(seen, changed)
    assert rig.names == ("ring_0", "ring_1", "ring_1@14.0s", "ring_2")
    assert together.n_frames == seen.n_frames
    in_both = together.seen[:, 1].any(axis=1) & together.seen[:, 2].any(axis=1)
    assert not in_both.any()
    # 2 degrees turn its axis away from where it was, and the frames before are as they were given.
    axes = [camera.world_T_camera[:3, 2] for camera in rig.cameras[1:3]]
    assert np.rad2deg(np.arccos(axes[0] @ axes[1])) == pytest.approx(2.0)
    np.testing.assert_array_equal(rig.cameras[1].world_T_camera, RIG.cameras[1].world_T_camera)


def changing_rig() -> fgpose.CameraRig:
    moved = RIG.cameras[0].world_T_camera.copy()
    moved[:3, 3] += [0.05, 0.0, 0.01]
    late = with_later_clock(RIG.cameras[2], 0.1, 0.001, [(20.0, 0.2), (31.0, -0.1)])
    first = fgpose.Camera(**(vars_of(RIG.cameras[0]) | {"moves": ((18.0, moved),)}))
    return fgpose.CameraRig((first, RIG.cameras[1], late))


def vars_of(camera: fgpose.Camera) -> dict[str, Any]:
    names = ("name", "size_px", "K", "world_T_camera", "distortion", "lens", "time_offset_s")
    return {name: getattr(camera, name) for name in names}


@pytest.mark.parametrize("name", ["rig.toml", "rig.npz"])
def test_files_keep_what_changes(tmp_path: Path, name: str) -> None:
    rig, path = changing_rig(), tmp_path / name
    fgpose.save_rig(rig, path)
    read = fgpose.load_rig(path)
    assert is_changing(read)
    for camera, given in zip(read.cameras, rig.cameras, strict=True):
        assert camera.clock_drift == given.clock_drift
        assert camera.clock_jumps == given.clock_jumps
        assert [since_s for since_s, _ in camera.moves] == [since_s for since_s, _ in given.moves]
        for (_, pose), (_, given_pose) in zip(camera.moves, given.moves, strict=True):
            np.testing.assert_allclose(pose, given_pose, atol=1e-12)


def test_a_format_without_moves_refuses_them(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ring_0 was moved while it filmed"):
        fgpose.save_rig(changing_rig(), tmp_path / "rig", "easymocap")


def test_clocks_are_composed() -> None:
    """A clock that was right after one was found to be wrong still: the same as one after the other."""
    stamp_s = np.array([0.0, 10.0, 19.0, 25.0, 40.0])
    camera = changing_rig().cameras[2]
    common_s = stamp_s + later_s(camera, stamp_s)
    more = with_later_clock(RIG.cameras[2], -0.05, 0.002, [(22.0, 0.1)])
    both = with_later_clock(camera, -0.05, 0.002, [(22.0, 0.1)])
    np.testing.assert_allclose(stamp_s + later_s(both, stamp_s), common_s + later_s(more, common_s), atol=1e-9)


def test_what_is_found_by_the_common_clock_goes_back_into_the_file() -> None:
    given = changing_rig()
    pieces = in_pieces(given)
    found = pieces.with_time_offsets(np.array([0.01, 0.01, 0.0, -0.02]))
    rig = after(given, put_together(pieces, found, pieces))
    assert rig.names == given.names
    np.testing.assert_allclose(rig.time_offsets_s, given.time_offsets_s + np.array([0.01, 0.0, -0.02]))
    assert rig.cameras[0].moves[0][0] == pytest.approx(18.0, abs=0.02)  # by stamps that are 10 ms later now
    assert rig.cameras[2].clock_jumps == given.cameras[2].clock_jumps
