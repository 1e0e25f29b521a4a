"""The videos of calibrated cameras that the package pose2sim ships as its demonstration: real people, BSD-3-Clause."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from fgpose.monocular.downloads import packages
from fgpose.monocular.downloads.cache import CachedFile, Say, cache_folder, provide
from fgpose.monocular.downloads.packages import Download, Member, Package

DemoVideos = Literal["Demo_SinglePerson", "Demo_MultiPerson"]

_WHEEL = Package("PyPI", "pose2sim", "0.10.49")
_LICENCE = Member(
    _WHEEL,
    "pose2sim-0.10.49.dist-info/licenses/LICENSE",
    1_521,
    "7f8a9ede713463b96d261a39c3ec404748c8e4f528c795e5f8cb18898ed944cf",
)
_FILES: dict[DemoVideos, dict[str, tuple[int, str]]] = {
    "Demo_SinglePerson": {
        "calibration/Calib.qca.txt": (4_843, "fd90e4bbae3278ef1dc0cdd42a34ee06bf88286f628a02c00a29407aa39e34c5"),
        "videos/cam01.mp4": (387_775, "cf4f2816c86bea4bfbea255333d8626ff32a3ecabdab8b0fb147cea9167fde3a"),
        "videos/cam02.mp4": (540_548, "94ff87cf978b8406e8aa36ab3c5362e72848994e87652f0dc7a33c315e8e0442"),
        "videos/cam03.mp4": (1_709_101, "b8b329f832f178f27ecb78d024d5026b96c6adb36c387bfe2c0af85eab8a11ca"),
        "videos/cam04.mp4": (1_772_999, "b5c0e7863fd70d008e7178d3c556b045b0ea5f78fcd61ca548a0b2e807e641f7"),
    },
    "Demo_MultiPerson": {
        "calibration/Calib.qca.txt": (4_843, "fd90e4bbae3278ef1dc0cdd42a34ee06bf88286f628a02c00a29407aa39e34c5"),
        "videos/cam01.mp4": (764_061, "543cee6a4c2c2b52dc9eac9137ee63d14f1f84e706a9a7264769edcb11e5ea53"),
        "videos/cam02.mp4": (610_385, "8895092a7cf26359205a427b7ac2f4a935c2e0bd36d9b7a5140cb33faa468a6b"),
        "videos/cam03.mp4": (801_091, "d3daf48cdf9f5603868ddb99166ddaf9b12279e7ce968922926560d5fd3f0c99"),
        "videos/cam04.mp4": (877_130, "1490149dc40e7301fa5ceae23862b044ba5c398a8b2a40df21ed894702728c09"),
    },
}


def fetch_demo_videos(
    folder: Path | None = None,
    recording: DemoVideos = "Demo_SinglePerson",
    progress: Say | None = None,
    *,
    download: Download = packages.download,
) -> Path:
    """Fetch a recording of four cameras (100 frames, 60 fps, 1088 x 1920 pixels, Qualisys calibration).

    If it is there already, its files are only compared with their digests; that needs no network.

    Args:
        folder: where the recording gets a folder of its name; by default in the user's cache.
        recording: one person balancing on one leg, or several people.
        progress: told what is done next.
        download: fetches a package.

    Returns:
        The folder of the recording, which has videos/cam01.mp4 to cam04.mp4, calibration/Calib.qca.txt and LICENSE.

    Raises:
        ValueError: what was fetched is damaged or not the expected content.
        OSError: the package cannot be fetched, or the folder cannot be written; the message says what to do.
    """
    folder = cache_folder() / "demo_videos" if folder is None else folder
    members = {
        path: Member(_WHEEL, f"Pose2Sim/{recording}/{path}", *digest) for path, digest in _FILES[recording].items()
    }
    members["LICENSE"] = _LICENCE
    files = [CachedFile.copy_of(member, f"{recording}/{path}") for path, member in members.items()]
    provide(files, folder, download, progress)
    return folder / recording
