"""What code made a file that may serve again: another release may find something else."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


@cache
def code_digest(package: Path) -> str:
    """Of the modules in this folder, in hexadecimal digits."""
    digest = hashlib.sha256()
    for module in sorted(package.rglob("*.py")):
        digest.update(module.read_bytes())
    return digest.hexdigest()
