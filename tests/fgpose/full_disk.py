"""A disk that is full for a while."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import Any

import pytest


class FullDisk:
    """Takes part of a write while it is full, and refuses the rest.

    Args:
        folder: it is full for all files that are opened for writing in here.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_full, self.n_refused = False, 0
        usual = Path.open

        def opened(path: Path, mode: str = "r", buffering: int = -1, **options: Any) -> Any:
            if path.parent != folder or mode not in ("xb", "wb"):
                return usual(path, mode, buffering, **options)
            file = _File(path, mode[0], self)
            return file if buffering == 0 else io.BufferedWriter(file)

        monkeypatch.setattr(Path, "open", opened)


class _File(io.FileIO):
    def __init__(self, path: Path, mode: str, disk: FullDisk) -> None:
        super().__init__(path, mode)
        self._disk = disk

    def write(self, content: Any) -> int:
        if self._disk.is_full:
            self._disk.n_refused += 1
            super().write(bytes(content[:7]))
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(content)
