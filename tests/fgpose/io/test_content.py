from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from small_files import STICK, rig

from fgpose.config import load_config
from fgpose.io.calibration import load_rig, save_rig
from fgpose.io.content import first_bytes, read_content
from fgpose.io.keypoints import keypoint_cameras, load_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory

# It opens, and reading its beginning fails as on a broken disk.
BROKEN = Path("/proc/self/mem")
READERS: dict[str, Callable[[Path], object]] = {
    "trajectory": load_trajectory,
    "rig": load_rig,
    "skeleton": load_skeleton,
    "config": load_config,
    "keypoints": lambda path: load_observations(path, rig(), STICK, fps=50.0),
    "cameras": keypoint_cameras,
}


def test_content_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"0123456789" * 300_000)
    assert read_content(path) == path.read_bytes()
    assert read_content(path, 3_000_000) == path.read_bytes()
    assert first_bytes(path, 3) == b"012"
    with pytest.raises(ValueError, match="it has more than 2999999 bytes"):
        read_content(path, 2_999_999)


def test_a_calibration_as_powershell_redirects_it(tmp_path: Path) -> None:
    save_rig(rig(), tmp_path / "rig.toml")
    (tmp_path / "redirected.toml").write_text((tmp_path / "rig.toml").read_text(), encoding="utf-16")
    assert load_rig(tmp_path / "redirected.toml").names == rig().names


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="a device of Linux")
def test_a_file_without_an_end_is_refused() -> None:
    with pytest.raises(OSError, match=r"no plain file but a pipe or a device: '/dev/zero'"):
        load_rig(Path("/dev/zero"))


@pytest.mark.parametrize("what", READERS)
def test_a_pipe_is_refused(what: str, tmp_path: Path) -> None:
    """Nobody writes into it: whoever opens it waits for ever."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises((OSError, ValueError), match="pipe"):
        READERS[what](tmp_path / "pipe")


@pytest.mark.skipif(not BROKEN.exists(), reason="a file of Linux")
@pytest.mark.parametrize("what", READERS)
def test_a_disk_that_fails_in_the_middle_is_named(what: str) -> None:
    with pytest.raises((OSError, ValueError), match=str(BROKEN)):
        READERS[what](BROKEN)


@pytest.mark.parametrize("what", READERS)
def test_a_folder_a_missing_file_and_links_in_a_circle_are_named(what: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    for name in ("folder", "missing", "circle"):
        with pytest.raises((OSError, ValueError), match=name):
            READERS[what](tmp_path / name)
