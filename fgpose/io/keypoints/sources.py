"""Which files the keypoints of each camera are in."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from fgpose.io.content import first_bytes
from fgpose.io.keypoints.deeplabcut import is_deeplabcut
from fgpose.io.keypoints.freemocap import is_freemocap
from fgpose.io.keypoints.networks.network_files import is_binary, is_of_network
from fgpose.io.names import camera_name, not_hidden, visible

# How far below a folder without keypoints they are looked for.
_LEVELS = 2
_MAX_NAMED = 4
# More than the keypoints of a person take.
_BEGINNING_BYTES = 1 << 16
_OTHERS = {
    ".h5": "HDF5, as of DeepLabCut or SLEAP: give the table instead (csv; in DeepLabCut "
    "analyze_videos_converth5_to_csv)",
    ".slp": "SLEAP: give keypoints as COCO results, or make a recording of fgpose in Python",
}
_FILTERED = "_filtered"  # what DeepLabCut adds to the name of a table that it has smoothed


def keypoint_sources(path: Path) -> dict[str, Path]:
    """By camera, in natural order: folders of image files, or files of a whole camera. Hidden files do not count.

    Raises:
        ValueError: there are none, they are mixed, or a camera has two; the message names the folder and says where
            keypoints are.
        OSError: a folder cannot be read.
    """
    if not path.is_dir():
        return {path.stem: path}
    found = _found(path)
    if not found:
        raise ValueError(f"{path}: {_none_there(path)}")
    folders = [each for each in found if each.is_dir()]
    files = [each for each in found if each not in folders and each.parent == path]
    if folders and files:
        raise ValueError(
            f"{path}: a mixture of files of a whole camera ({files[0].name}) and folders with one file per image "
            f"({folders[0].name}); move what is not keypoints elsewhere"
        )
    sources: dict[str, Path] = {}
    for source in found:
        is_inside = source.parent == path
        name = source.stem if is_inside and source.is_file() else (source if is_inside else source.parent).name
        if name in sources:
            raise ValueError(
                f"{source}: camera {name} has a second file beside it, {sources[name].name}; rename or move "
                "one of the two"
            )
        sources[name] = source
    return sources


def freemocap_file(path: Path) -> Path | None:
    """The file of FreeMoCap's 2D points: the path itself, or the only one of a folder without other keypoints."""
    if not path.is_dir():
        return path if is_freemocap(path) else None
    arrays = [entry for entry in visible(path) if is_freemocap(entry)]
    return arrays[0] if len(arrays) == 1 and not _found(path) else None


def _found(path: Path) -> list[Path]:
    """Folders and files with keypoints, of whatever kind, in natural order."""
    entries = visible(path)
    folders = [source for entry in entries if entry.is_dir() for source in _in_folder(entry)]
    files = [entry for entry in entries if entry.is_file()]
    tables = _tables(files)
    found = [*folders, *(file for file in files if file.suffix in (".json", ".npz"))] or tables
    # Weights and other pickles lie beside keypoints of other programs.
    return found or [source for source in entries if source.is_dir() or is_binary(source) if is_of_network(source)]


def _in_folder(folder: Path) -> list[Path]:
    """What of a camera is in its folder: the folder itself if it has a file for each image, or the file of all."""
    files = not_hidden(folder.iterdir())
    documents = [file for file in files if file.suffix == ".json"]
    whole = [file for file in documents if file.stem.casefold() == "alphapose-results"]
    if whole:
        return whole
    if documents and (not _is_of_whole_camera(documents[0]) or (len(documents) > 1 and is_of_network(folder))):
        return [folder]
    tables = _tables(files)
    # Of several cameras: they are found when the folder itself is given.
    several = len({camera_name(file.stem) for file in documents or tables}) > 1
    return [] if several else documents or tables


def _tables(files: Iterable[Path]) -> list[Path]:
    """Those of DeepLabCut, without a filtered one beside that from which it was made: fgpose smooths itself."""
    tables = [file for file in files if file.suffix == ".csv" and is_deeplabcut(file)]
    filtered = {_filtered(table) for table in tables}
    return [table for table in tables if table not in filtered]


def _filtered(table: Path) -> Path:
    return table.with_stem(f"{table.stem}{_FILTERED}")


def filtered_beside(path: Path) -> tuple[str, ...]:
    """What to say of filtered tables of DeepLabCut beside those that are read. Raises as keypoint_sources."""
    tables = (source for source in keypoint_sources(path).values() if source.suffix == ".csv")
    left_out = [table for table in map(_filtered, tables) if path.is_dir() and table.exists()]
    if not left_out:
        return ()
    return (
        f"of each table and its filtered one the first is read, not {left_out[0].name}: what is smoothed twice cuts "
        "off fast limbs",
    )


def _is_of_whole_camera(document: Path) -> bool:
    """By its beginning: a single image has no number."""
    beginning = first_bytes(document, _BEGINNING_BYTES)
    return any(f'"{key}"'.encode() in beginning for key in ("instance_info", "frame_id", "image_id", "poses2d"))


def _none_there(path: Path) -> str:
    """What to say of a folder without keypoints."""
    below = list(_below(path, _LEVELS))
    if below:
        named = ", ".join(str(folder) for folder in below[:_MAX_NAMED]) + (", ..." if len(below) > _MAX_NAMED else "")
        return f"no keypoints, but there are some in {named}: give {'one of these' if len(below) > 1 else 'that one'}"
    entries = visible(path)
    files = [*entries, *(file for entry in entries if entry.is_dir() for file in visible(entry))]
    others = sorted({file.suffix.lower() for file in files if file.suffix.lower() in _OTHERS})
    if others:
        return f"its {others[0]} files are {_OTHERS[others[0]]}"
    return "no keypoints; expected one folder of JSON files per camera, or one JSON, csv or npz file per camera"


def _below(path: Path, levels: int) -> Iterable[Path]:
    """The uppermost folders below that have keypoints."""
    for folder in visible(path) if levels else ():
        if not folder.is_dir():
            continue
        if _found(folder) or freemocap_file(folder):
            yield folder
        else:
            yield from _below(folder, levels - 1)
