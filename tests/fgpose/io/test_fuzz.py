"""A short form of the fuzzer beside this file; CONTRIBUTING says how to run the long one."""

from __future__ import annotations

import bad_readers
import pytest
from fuzz import Plan, fuzz
from small_files import FORMATS

SLOW = ("trajectory c3d", "used c3d")
"""Every file in a process of its own."""


FAST = [name for name in FORMATS if name not in SLOW]


@pytest.mark.parametrize(
    ("formats", "n_runs"),
    [(FAST, 8), pytest.param(SLOW, 6, marks=pytest.mark.slow)],
)
def test_a_damaged_file_is_read_or_refused_by_name(formats: list[str], n_runs: int) -> None:
    for name in SLOW if tuple(formats) == SLOW else ():
        pytest.importorskip("ezc3d", reason=name)
    tallies = fuzz(formats, range(n_runs), Plan(seed=10))
    assert [failure for tally in tallies.values() for failure in tally.failures] == []
    # Were all refused, the files would be wrong from the start; were all read, the mutations would do nothing.
    for tally in tallies.values():
        assert tally.counts["refused"] > 0
    assert sum(tally.counts["read"] for tally in tallies.values()) > 0


@pytest.mark.parametrize("name", FORMATS)
def test_the_files_are_sound_before_they_are_damaged(name: str, tmp_path) -> None:
    FORMATS[name].make(tmp_path)
    assert FORMATS[name].read(tmp_path) is not False


@pytest.mark.slow
def test_the_fuzzer_sees_what_no_reader_may_do() -> None:
    names = list(bad_readers.FORMATS)
    tallies = fuzz(names, range(1), Plan(seed=0, catalogue="bad_readers", time_limit_s=3.0))
    assert {name: dict(tally.counts) for name, tally in tallies.items()} == {name: {name: 1} for name in names}
    assert [bool(tally.failures) for tally in tallies.values()] == [True] * 5 + [False] * 2
