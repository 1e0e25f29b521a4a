"""Reading of NumPy archives that may be damaged."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

# What zipfile and numpy raise on damaged archives, depending on the byte that is wrong.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    OSError,
    ValueError,
    LookupError,
    SyntaxError,
    RuntimeError,
    AttributeError,
    TypeError,
    MemoryError,
)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an npz without pickles.

    Raises:
        ValueError: the file is damaged or something else; the caller names it.
        OSError: it cannot be opened.
    """
    with path.open("rb") as stream:
        try:
            with np.load(stream, allow_pickle=False) as archive:
                members = {name: archive[name] for name in archive.files}
        except _DAMAGE as error:
            raise ValueError(f"a damaged npz: {error}") from None
    # Any zip opens as an npz; NumPy gives a member that is no array as bytes.
    return {name: member for name, member in members.items() if isinstance(member, np.ndarray)}
