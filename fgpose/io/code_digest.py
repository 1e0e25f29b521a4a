"""What code made a file that may serve again: another release may find something else."""

from __future__ import annotations

import hashlib
import inspect
import sys
from functools import cache
from pathlib import Path


@cache
def code_digest(package: Path) -> str:
    """Of the modules in this folder, in hexadecimal digits."""
    digest = hashlib.sha256()
    for module in sorted(package.rglob("*.py")):
        digest.update(module.read_bytes())
    return digest.hexdigest()


def class_digest(cls: type) -> str:
    """Of the source files of a class of another package: those of its bases, of the classes and functions that their
    modules use, and all loaded modules of its own package. Not of fgpose and Python, nor of what is typed into a
    session."""
    of_bases = {base.__module__ for base in cls.__mro__}
    modules = [
        module
        for name, module in list(sys.modules.items())
        if not _is_known(name) and (name in of_bases or _package(name) == _package(cls.__module__))
    ]
    used = [each for module in modules for each in list(vars(module).values()) if _is_code(each)]
    contents = set[bytes]()
    for each in (*modules, *used):
        try:
            file = inspect.getsourcefile(each)
        except (TypeError, OSError):  # Compiled, or typed in.
            continue
        if file is not None and Path(file).is_file():
            contents.add(Path(file).read_bytes())
    return hashlib.sha256(b"".join(sorted(hashlib.sha256(each).digest() for each in contents))).hexdigest()


def _is_code(value: object) -> bool:
    return (inspect.isclass(value) or inspect.isfunction(value)) and not _is_known(str(value.__module__))


def _is_known(module: str) -> bool:
    return _package(module) in ("fgpose", *sys.stdlib_module_names)


def _package(module: str) -> str:
    return module.partition(".")[0]
