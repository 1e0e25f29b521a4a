from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.io.arrays import array_names, checked, read_arrays, text, texts, write_arrays


def npy(array: np.ndarray, **replaced: str) -> bytes:
    """The content of a member; in its header one text is replaced by another of any length."""
    content = io.BytesIO()
    np.save(content, array)
    header, numbers = content.getvalue()[10:128].decode(), content.getvalue()[128:]
    for old, new in replaced.items():
        header = header.replace({"shape": str(array.shape), "dtype": array.dtype.str}[old], new)
    header = header.rstrip() + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + numbers


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in members.items():
            target.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("compressed", [True, False])
def test_what_is_written_comes_back(tmp_path: Path, compressed: bool) -> None:
    arrays: dict[str, Any] = {
        "numbers": np.arange(6.0).reshape(2, 3),
        "by_columns": np.asfortranarray(np.arange(6, dtype=np.int8).reshape(2, 3)),
        "names": np.array(["nose", "ä"]),
        "one": np.array("text"),
        "nothing": np.zeros((0, 3)),
        "big_endian": np.arange(3, dtype=">f4"),
    }
    write_arrays(tmp_path / "a.npz", arrays, compressed=compressed)
    found = read_arrays(tmp_path / "a.npz")
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
        assert found[name].flags.writeable
    assert array_names(tmp_path / "a.npz") == set(arrays)
    assert list(read_arrays(tmp_path / "a.npz", ["names"])) == ["names"]


@pytest.mark.parametrize(
    ("shape", "dtype", "message"),
    [
        ("(10000000000, 10000000000)", "<f8", "takes 8"),
        ("(-3,)", "<f8", "there are"),
        ("(2,)", "<f8", r"shape \(2,\)"),
        ("(0, 10000000000000)", "<f8", "there are"),
        ("(3,)", "|O", "type object"),
        ("(3,)", "<U0", "type <U0"),
        ("(3,)", "<c16", "there are"),
        ("((((((", "<f8", "damaged npz"),
        ("(3, 'x')", "<f8", "damaged npz"),
        ("(1e9,)", "<f8", "damaged npz"),
    ],
)
def test_a_header_that_lies_is_not_believed(tmp_path: Path, shape: str, dtype: str, message: str) -> None:
    path = archive(tmp_path / "a.npz", x=npy(np.zeros(3), shape=shape, dtype=dtype))
    with pytest.raises(ValueError, match=f"a damaged npz: .*{message}" if message != "damaged npz" else message):
        read_arrays(path)


def test_rows_without_numbers_are_not_counted_for_ever(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", x=npy(np.zeros((0, 3)), shape="(0, 10000000000000)"))
    with pytest.raises(ValueError, match="has the shape"):
        read_arrays(path)


def test_an_archive_that_grows_without_end_takes_no_memory(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", x=npy(np.zeros(1000)))
    content = bytearray(path.read_bytes())
    # The size of the unpacked member in the directory at the end.
    place = content.rindex(b"PK\x01\x02") + 24
    content[place : place + 4] = (2**32 - 16).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(ValueError, match="array x would take 4294967280 bytes"):
        read_arrays(path)


def test_pickles_twins_and_other_files_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "pickle.npz", x=np.array([{"a": 1}]))
    with zipfile.ZipFile(tmp_path / "twins.npz", "w") as twins:
        twins.writestr("x.npy", npy(np.zeros(3)))
        with pytest.warns(UserWarning, match="Duplicate name"):
            twins.writestr("x.npy", npy(np.ones(3)))
    (tmp_path / "text.npz").write_text("hello")
    for name, message in (("pickle", "type object"), ("twins", "x is there twice"), ("text", "not a zip file")):
        with pytest.raises(ValueError, match=message):
            read_arrays(tmp_path / f"{name}.npz")
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "nothing.npz")


def test_what_is_no_array_is_left_out(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as target:
        target.writestr("readme.txt", "hello")
    assert read_arrays(tmp_path / "a.npz") == {}


ARRAYS = {"x": np.zeros((4, 3)), "n": np.arange(4), "names": np.array(["a", "b"]), "one": np.array("text")}


@pytest.mark.parametrize(
    ("name", "kind", "shape", "message"),
    [
        ("y", "numbers", (4, 3), "the array y is missing"),
        ("names", "numbers", (2,), "names must be numbers"),
        ("x", "whole numbers", (4, 3), "x must be whole numbers, it is of type float64"),
        ("x", "texts", (4, 3), "x must be texts"),
        ("n", "truth values", (4,), "n must be truth values"),
        ("x", "numbers", (None,), r"x must be \(any\), got \(4, 3\)"),
        ("x", "numbers", (None, 2), r"x must be \(any, 2\), got \(4, 3\)"),
        ("n", "numbers", (), r"n must be \(\), got \(4,\)"),
    ],
)
def test_an_array_of_another_kind_or_shape_is_named(name: str, kind: Any, shape: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        checked(ARRAYS, name, kind, *shape)


def test_an_array_as_wanted_is_given() -> None:
    assert checked(ARRAYS, "x", "numbers", None, 3) is ARRAYS["x"]
    assert checked(ARRAYS, "n", "numbers", 4) is ARRAYS["n"]
    assert (texts(ARRAYS, "names"), text(ARRAYS, "one")) == (("a", "b"), "text")
