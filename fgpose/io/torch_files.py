"""What torch.save has written, read without torch and without running anything; also as older versions wrote it."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

from fgpose.io.content import damage, read_content
from fgpose.io.pickles import unpickled, unpickled_stream
from fgpose.io.tensors import Storage, stated_storage
from fgpose.plain_files import check_expansion, max_file_bytes


def read_torch(path: Path) -> Any:
    """What a file of torch.save holds: plain values, and tensors as arrays, which must not be changed.

    Raises:
        ValueError: it is a model, is damaged, or wants more than arrays, tensors and plain values; the caller names it.
        OSError: it cannot be read.
    """
    content = read_content(path, max_file_bytes())
    if zipfile.is_zipfile(io.BytesIO(content)):
        return _of_archive(content)
    return unpickled_stream(content)


def _of_archive(content: bytes) -> Any:
    with damage("a damaged file of torch"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        check_expansion(sum(sizes.values()), len(content))
        members = {name: archive.read(name) for name in sizes if _is_needed(name)}
    tables = [name for name in members if name.endswith("/data.pkl") and name.count("/") == 1]
    if len(tables) != 1:
        raise ValueError("not a file of torch.save: it has no data.pkl")
    root = tables[0].removesuffix("data.pkl")
    if f"{root}constants.pkl" in sizes:
        raise ValueError("a model of TorchScript, not what a network has found")
    if members.get(f"{root}byteorder", b"little") != b"little":
        raise ValueError("written on a computer whose numbers begin with their largest byte; save it as npz there")
    known: dict[str, Storage] = {}

    def storage(pid: Any) -> Storage:
        key, stated = stated_storage(pid)
        if key not in known:
            stated.fill(members.get(f"{root}data/{key}", b""))
            known[key] = stated
        return known[key]

    return unpickled(members[tables[0]], storage)


def _is_needed(name: str) -> bool:
    return name.endswith(("/data.pkl", "/byteorder")) or "/data/" in name
