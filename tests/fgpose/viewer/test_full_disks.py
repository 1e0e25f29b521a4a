"""A disk that is full or hangs is an error of one line, however often it is tried: never a hang."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import NotWrittenError
from fgpose.viewer import open_recording
from fgpose_benchmarks.synthetic import ring_rig
from tests.fgpose.conftest import SKELETON

pytest.importorskip("rerun")


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return ring_rig(2)


def write_to(disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Instead of a temporary file."""

    @contextmanager
    def replacing(*_: object) -> Iterator[Path]:
        yield disk

    monkeypatch.setattr("fgpose.viewer.rerun.session.replacing", replacing)


def record(path: Path, rig: CameraRig) -> None:
    image = np.random.default_rng(0).integers(0, 256, (rig.cameras[0].size_px[1], rig.cameras[0].size_px[0], 3))
    with open_recording(path, rig, SKELETON, image_width_px=None, jpeg_quality=95) as recording:
        recording.log_image(rig.names[0], 0, 0.0, image.astype(np.uint8))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is always full is of Linux")
def test_a_full_disk_is_said_each_time(tmp_path: Path, rig: CameraRig, monkeypatch: pytest.MonkeyPatch) -> None:
    write_to(Path("/dev/full"), monkeypatch)
    for _ in range(5):
        with pytest.raises(NotWrittenError, match=f"^cannot write {tmp_path / 'out.rrd'}: No space left on device$"):
            record(tmp_path / "out.rrd", rig)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is always full is of Linux")
def test_pictures_do_not_go_on_when_the_disk_is_full(
    tmp_path: Path, rig: CameraRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_to(Path("/dev/full"), monkeypatch)
    monkeypatch.setattr("fgpose.viewer.rerun.session._UNFLUSHED_BYTES", 1)
    recording = open_recording(tmp_path / "out.rrd", rig, SKELETON)
    image = np.zeros((*rig.cameras[0].size_px[::-1], 3), np.uint8)

    def record_for_ever() -> None:
        for frame in count():
            recording.log_image(rig.names[0], frame, 0.0, image)

    with pytest.raises(NotWrittenError, match="No space left"):
        record_for_ever()
    recording.discard()


def test_a_disk_that_hangs_is_given_up(tmp_path: Path, rig: CameraRig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe that nobody empties takes 64 kB, and nothing more."""
    disk = tmp_path / "disk"
    os.mkfifo(disk)
    nobody = os.open(disk, os.O_RDONLY | os.O_NONBLOCK)
    write_to(disk, monkeypatch)
    monkeypatch.setattr("fgpose.viewer.rerun.session._FLUSH_TIMEOUT_S", 0.2)
    with pytest.raises(NotWrittenError, match=f"^cannot write {tmp_path / 'out.rrd'}: "):
        record(tmp_path / "out.rrd", rig)
    discarded = open_recording(tmp_path / "out.rrd", rig, SKELETON)
    discarded.discard()
    os.close(nobody)
