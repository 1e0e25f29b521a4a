"""Files of others: none keeps its reader waiting, and none takes the memory."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fgpose.cli import main
from fgpose.config import load_config
from fgpose.io.arrays import read_arrays
from fgpose.io.calibration.calibrated_view import CalibratedView, rig_in_metres
from fgpose.io.tables import read_table
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.live.sources.folder import _read as read_live_image
from fgpose.monocular.clips import _open_video
from fgpose.monocular.image_files import read_image
from fgpose.plain_files import MAX_CAMERAS, MAX_MESSAGE, naming
from fgpose.study import load_study

READERS: dict[str, Callable[[Path], object]] = {
    "configuration": load_config,
    "study": load_study,
    "live rig": load_live_rig,
    "video": _open_video,
    "image": read_image,
}


@pytest.mark.parametrize("what", READERS)
def test_a_pipe_is_refused(what: str, tmp_path: Path) -> None:
    """Nobody writes into it: whoever opens it waits for ever."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises((OSError, ValueError), match="no plain file but a pipe or a device") as error:
        READERS[what](tmp_path / "pipe")
    assert "pipe" in str(error.value)


@pytest.mark.parametrize("what", READERS)
def test_a_device_is_refused(what: str) -> None:
    with pytest.raises((OSError, ValueError), match="no plain file but a pipe or a device"):
        READERS[what](Path("/dev/zero"))


@pytest.mark.parametrize("command", [["view"], ["study"], ["smooth", "--config"], ["report"], ["live"]])
def test_commands_name_a_device(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "/dev/zero"]) == 2
    assert "/dev/zero: no plain file but a pipe or a device" in capsys.readouterr().err


def test_a_small_archive_of_large_arrays_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    header = np.lib.format.magic(1, 0) + struct.pack("<H", 118)
    n = 600 << 17
    header += f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({n},), }}".ljust(117).encode() + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("x.npy", "w") as member:
            member.write(header)
            for _ in range(600):
                member.write(bytes(1 << 20))
        archive.writestr("other.npy", header)
    assert path.stat().st_size < 4 << 20
    with pytest.raises(ValueError, match=r"its \d+ bytes stand for \d+, more than fgpose reads"):
        read_arrays(path)


@pytest.mark.parametrize("kind", ["rows", "texts"])
def test_a_small_table_of_many_rows_is_refused_before_it_is_read(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.parquet"
    if kind == "rows":
        table = pa.table({"x": pa.DictionaryArray.from_arrays(pa.array(np.zeros(1 << 26, np.int8)), pa.array([1.5]))})
    else:
        texts = pa.array(["a" * (1 << 20)])
        table = pa.table({"x": pa.DictionaryArray.from_arrays(pa.array(np.zeros(1 << 12, np.int8)), texts)})
    pq.write_table(table, path, compression="zstd", store_schema=False)
    assert path.stat().st_size < 1 << 20
    with pytest.raises(ValueError, match="more than fgpose reads"):
        read_table(path)


def png(side_px: int) -> bytes:
    """An image that is black, or would be: of its lines there is one."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", side_px, side_px, 8, 0, 0, 0, 0)
    lines = zlib.compress(bytes(side_px + 1))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", lines) + chunk(b"IEND", b"")


@pytest.mark.parametrize("side_px", [30_000, 65_535])
def test_an_image_of_too_many_pixels_is_refused(side_px: int, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(side_px))
    with pytest.raises(ValueError, match=r"a\.png: not an image, or one of more than 134217728 pixels"):
        read_image(tmp_path / "a.png")
    assert read_live_image(tmp_path / "a.png") is None


def test_a_rig_of_too_many_cameras_is_refused() -> None:
    view = CalibratedView("a", (100, 100), np.eye(3), np.eye(3), np.zeros(3), np.zeros(0))
    with pytest.raises(ValueError, match="60000 cameras are more than the 1000"):
        rig_in_metres([view] * 60_000, "m", "auto")
    assert MAX_CAMERAS == 1000


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("no rig"), "a/rig.toml: not a rig: no rig"),
        (ValueError("a/rig.toml, camera cam_1: no pose"), "not a rig: a/rig.toml, camera cam_1: no pose"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "no text"), "a/rig.toml: not a rig: 'utf-8' codec"),
        (OSError("a damaged archive"), "a/rig.toml: not a rig: a damaged archive"),
        (KeyError("pose"), "a/rig.toml: not a rig: pose is missing"),
        (RecursionError(), "a/rig.toml: it is nested too deeply"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_once_with_its_name(error: Exception, said: str) -> None:
    with (
        pytest.raises(ValueError, match="a/rig") as caught,
        naming("a/rig.toml", "not a rig", damage=(KeyError, OSError)),
    ):
        raise error
    assert str(caught.value).startswith(said)


def test_no_message_quotes_all_of_a_file() -> None:
    with pytest.raises(ValueError, match=r"rig\.toml: camera xx") as caught, naming("rig.toml"):
        raise ValueError(f"camera {'x' * 100_000} has no pose")
    assert len(str(caught.value)) < MAX_MESSAGE + 50
    assert str(caught.value).endswith("xx has no pose")


def test_errors_of_the_system_keep_their_kind_and_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no_such"), naming("rig.toml"):
        (tmp_path / "no_such").read_bytes()
    with pytest.raises(OSError, match=r"rig\.toml"), naming("rig.toml"):
        raise OSError(5, "Input/output error")


def test_a_failure_of_the_mathematics_is_not_said_of_the_file() -> None:
    with pytest.raises(np.linalg.LinAlgError), naming("rig.toml"):
        np.linalg.inv(np.zeros((2, 2)))
