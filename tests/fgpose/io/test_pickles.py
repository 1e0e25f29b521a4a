"""Pickled dictionaries of NumPy arrays are read; nothing else that a pickle may do happens."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from fgpose.io.pickles import read_dictionary

CONTENT = {
    "names": ["S9", "S11"],
    "plain": np.arange(6, dtype=np.float32).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "rows": np.array([(1, (2.0, 3.0))], dtype=[("index", np.int8), ("point", np.float32, 2)]),
    "number": np.float64(2.5),
    "texts": np.array(["a", "bc"]),
}


def write(path: Path, content: object, protocol: int = 3) -> Path:
    """As np.save does, with any protocol."""
    array = np.array(content, dtype=object)
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": ()})
        pickle.dump(array, file, protocol=protocol)
    return path


def assert_same(loaded: dict) -> None:
    assert loaded.keys() == CONTENT.keys()
    assert loaded["names"] == CONTENT["names"]
    for name in ("plain", "fortran", "rows", "number", "texts"):
        np.testing.assert_array_equal(loaded[name], CONTENT[name])
        assert loaded[name].dtype == CONTENT[name].dtype


def test_what_numpy_saved_comes_back(tmp_path: Path):
    path = tmp_path / "labels.npy"
    np.save(path, np.array(CONTENT, dtype=object), allow_pickle=True)
    assert_same(read_dictionary(path))


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_every_protocol_of_pickle_is_read(protocol: int, tmp_path: Path):
    assert_same(read_dictionary(write(tmp_path / "labels.npy", CONTENT, protocol)))


def test_files_of_numpy_1_are_read(tmp_path: Path):
    path = write(tmp_path / "labels.npy", CONTENT)
    content = path.read_bytes()
    assert b"numpy._core" in content
    # protocol 3 ends names with a line feed, so they may change their length
    path.write_bytes(content.replace(b"numpy._core", b"numpy.core"))
    assert_same(read_dictionary(path))


class Evil:
    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple:
        return os.mkdir, (str(self.trace),)


def test_code_in_a_pickle_does_not_run(tmp_path: Path):
    trace = tmp_path / "trace"
    path = write(tmp_path / "labels.npy", {"table": Evil(trace)})
    with pytest.raises(ValueError, match=r"labels\.npy: not safe to load.*\.mkdir"):
        read_dictionary(path)
    assert not trace.exists()
    np.load(path, allow_pickle=True)
    assert trace.exists()


def test_arrays_of_objects_inside_are_refused(tmp_path: Path):
    content = {"rows": np.array([(1, "a")], dtype=[("index", np.int8), ("any", object)])}
    with pytest.raises(ValueError, match=r"labels\.npy"):
        read_dictionary(write(tmp_path / "labels.npy", content))


def test_wrong_bytes_are_refused_or_read_as_another_value(tmp_path: Path):
    path = write(tmp_path / "labels.npy", CONTENT)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    n_refused = 0
    for _ in range(150):
        changed = bytearray(content)
        changed[int(rng.integers(len(content)))] = int(rng.integers(256))
        path.write_bytes(bytes(changed))
        try:
            read_dictionary(path)
        except ValueError:
            n_refused += 1
    assert 20 < n_refused < 150


@pytest.mark.parametrize("name", ["load", "memmap", "fromfile"])
def test_other_functions_of_numpy_are_not_given_either(name: str, tmp_path: Path):
    class Reader:
        def __reduce__(self) -> tuple:
            return getattr(np, name), (str(tmp_path / "any"),)

    with pytest.raises(ValueError, match="not safe to load"):
        read_dictionary(write(tmp_path / "labels.npy", {"table": Reader()}))


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", b"text" * 10])
def test_files_that_are_no_npy_are_refused(content: bytes, tmp_path: Path):
    path = tmp_path / "labels.npy"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"labels\.npy: not a readable \.npy"):
        read_dictionary(path)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path: Path):
    path = write(tmp_path / "labels.npy", CONTENT)
    content = path.read_bytes()
    for length in range(0, len(content) - 1, 7):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match="labels"):
            read_dictionary(path)


def test_an_array_and_another_object_are_no_dictionary(tmp_path: Path):
    np.save(tmp_path / "numbers.npy", np.arange(3))
    with pytest.raises(ValueError, match="it holds an array of int"):
        read_dictionary(tmp_path / "numbers.npy")
    with pytest.raises(ValueError, match=r"a dictionary saved with np\.save is needed, it holds str"):
        read_dictionary(write(tmp_path / "text.npy", "S9"))


def test_what_is_there_many_times_is_resolved_once(tmp_path: Path):
    """In some hundred bytes 2^200 lists, each of which holds one list twice: it would take for ever."""
    deep: list = [np.arange(3.0)]
    for _ in range(200):
        deep = [deep, deep]
    np.save(tmp_path / "deep.npy", np.array({"a": deep}, dtype=object), allow_pickle=True)
    found = read_dictionary(tmp_path / "deep.npy")["a"]
    for _ in range(200):
        assert found[0] is found[1]
        found = found[0]
    np.testing.assert_array_equal(found[0], [0.0, 1.0, 2.0])
