from __future__ import annotations

from pathlib import Path

import pytest
from registry_packages import Registry

from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.downloads.packages import Package

PACKAGE = Package("PyPI", "pose2sim", "0.10.49")


def test_other_videos_are_refused(tmp_path: Path) -> None:
    registry = Registry({PACKAGE: {"Pose2Sim/Demo_SinglePerson/calibration/Calib.qca.txt": bytes(4843)}})
    with pytest.raises(ValueError, match=r"Calib.qca.txt of the PyPI package pose2sim 0.10.49 has the sha256"):
        fetch_demo_videos(tmp_path, download=registry.download)
    assert not list(tmp_path.rglob("*.*"))


def test_without_registry_one_error_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=f"cannot fetch the {PACKAGE}: .* copy {tmp_path} from a computer where it did"):
        fetch_demo_videos(tmp_path, download=Registry({}).download)


def test_they_go_into_the_cache_if_no_folder_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path))
    with pytest.raises(OSError, match=f"copy {tmp_path}/demo_videos from"):
        fetch_demo_videos(download=Registry({}).download)
