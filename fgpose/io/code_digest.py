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
    """Of the source files of a class of another package: those of its bases, and of what their modules use of classes,
    functions and modules of their package. Not of fgpose and Python, nor of what is typed into a session."""
    names = [base.__module__ for base in cls.__mro__ if not _is_known(base.__module__)]
    modules = [sys.modules[name] for name in names if name in sys.modules]
    used = [each for module in modules for each in list(vars(module).values()) if _is_used(each, module.__name__)]
    contents = set[bytes]()
    for each in (*modules, *used):
        try:
            file = inspect.getsourcefile(each)
        except (TypeError, OSError):  # Compiled, or typed in.
            continue
        if file is not None and Path(file).is_file():
            contents.add(Path(file).read_bytes())
    return hashlib.sha256(b"".join(sorted(hashlib.sha256(each).digest() for each in contents))).hexdigest()


def _is_used(value: object, module: str) -> bool:
    if inspect.ismodule(value):
        return _package(value.__name__) == _package(module)
    return (inspect.isclass(value) or inspect.isfunction(value)) and not _is_known(str(value.__module__))


def _is_known(module: str) -> bool:
    return _package(module) in ("fgpose", *sys.stdlib_module_names)


def _package(module: str) -> str:
    return module.partition(".")[0]
