"""Archives of packages: small ones made here, and the real ones."""

from __future__ import annotations

import hashlib
import io
import tarfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from fgpose.monocular.downloads.packages import FetchError, Member, Package, download


def member_of(package: Package, path: str, content: bytes) -> Member:
    return Member(package, path, len(content), hashlib.sha256(content).hexdigest())


def write_wheel(path: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for name, content in files.items():
            wheel.writestr(name, content)
    return path


def write_tarball(path: Path, files: Mapping[str, bytes]) -> Path:
    with tarfile.open(path, "w:gz") as tarball:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            tarball.addfile(info, io.BytesIO(content))
    return path


class Registry:
    """Serves archives of its own in place of the network, and remembers what was asked for."""

    def __init__(self, packages: Mapping[Package, Mapping[str, bytes]]) -> None:
        self.packages = dict(packages)
        self.asked: list[Package] = []

    def download(self, package: Package, folder: Path) -> Path:
        self.asked.append(package)
        if package not in self.packages:
            raise FetchError(f"cannot fetch the {package}: no route to host")
        if package.registry == "PyPI":
            return write_wheel(folder / f"{package.name}.whl", self.packages[package])
        return write_tarball(folder / "package.tgz", self.packages[package])


class RealPackages:
    """The packages of the registries, each fetched once; skips the test where no registry answers."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self._archives: dict[Package, Path | str] = {}

    def archive(self, package: Package) -> Path:
        if package not in self._archives:
            try:
                self._archives[package] = download(package, self._folders.mktemp("package"))
            except FetchError as error:
                self._archives[package] = str(error)
        archive = self._archives[package]
        if isinstance(archive, str):
            pytest.skip(archive)
        return archive

    def download(self, package: Package, folder: Path) -> Path:
        """For what takes a way to download."""
        return self.archive(package)
