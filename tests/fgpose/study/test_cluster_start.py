"""Where a machine cannot start workers, that is one line."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from fgpose.study.cluster import workers
from fgpose.study.study import Resources

pytest.importorskip("distributed")


def test_a_machine_without_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    class Context:
        def Lock(self) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("fgpose.study.cluster.get_context", lambda _: Context())
    with (
        pytest.raises(OSError, match="no worker can be started: Read-only file system; /dev/shm must be writable"),
        workers(Resources(workers=1)),
    ):
        pass


def test_a_folder_that_was_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "deleted"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with (
        pytest.raises(OSError, match="the current folder was deleted"),
        workers(Resources(workers=1)),
    ):
        pass
