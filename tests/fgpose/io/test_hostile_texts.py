"""Small texts that stand for much, and names that other programs would take for more than names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_files import STICK, rig

from fgpose import plain_files
from fgpose.cli.app import _one_line
from fgpose.config import load_config
from fgpose.io import content
from fgpose.io.calibration import load_intrinsics, load_rig
from fgpose.io.content import parse_json, read_content, text_lines
from fgpose.io.keypoints import load_people
from fgpose.io.skeletons import load_skeleton
from fgpose.io.studies.events import read_events
from fgpose.io.tables import as_cell, name_in_cell
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.io.trajectories.markers import markers_to_trajectory
from fgpose.skeleton import Skeleton

TRC = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n50\t{n}\t{n}\tm\n"
TRC += "Frame#\tTime\t{names}\n\tX1\n"
LENS = ["cam_1"]
READERS: dict[str, Callable[[Path], object]] = {
    "json": load_rig,
    "toml": load_rig,
    "skeleton.toml": load_skeleton,
    "config.toml": load_config,
    "lens.json": lambda path: load_intrinsics(path, LENS),
    "lens.yml": lambda path: load_intrinsics(path, LENS),
}
NESTED = {"json": '{"a":' * 100_000, "toml": "a=" + "[" * 100_000, "yml": "%YAML:1.0\na: " + "[" * 100_000}
MANY_DIGITS = {"json": '{"a":' + "1" * 100_000, "toml": "a=" + "1" * 100_000, "yml": "%YAML:1.0\na: *a" + "1" * 100_000}


@pytest.mark.parametrize("what", READERS)
@pytest.mark.parametrize("texts", [NESTED, MANY_DIGITS], ids=["nested", "digits"])
def test_documents_that_are_deep_or_have_endless_numbers_are_refused(
    what: str, texts: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / f"bomb.{what}"
    path.write_text(texts[path.suffix[1:]])
    with pytest.raises(ValueError, match=r"bomb\."):
        READERS[what](path)


@pytest.mark.parametrize("what", ["toml", "skeleton.toml", "config.toml"])
def test_settings_that_would_take_minutes_are_refused(what: str, tmp_path: Path) -> None:
    path = tmp_path / f"bomb.{what}"
    path.write_text("a=[" + "1," * (1 << 19) + "]")
    with pytest.raises(ValueError, match=r"it has more than \d+ bytes"):
        READERS[what](path)


def test_yaml_that_would_take_minutes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bomb.yml").write_text("a: [" + "1," * 80_000 + "]")
    with pytest.raises(ValueError, match="it has some 80002 values"):
        load_intrinsics(tmp_path / "bomb.yml", LENS)


def test_a_key_of_many_parts_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bomb.toml").write_text(f"[a{'.a' * 50}]\n")
    with pytest.raises(ValueError, match="nested too deeply"):
        load_config(tmp_path / "bomb.toml")


def test_json_of_nothing_but_lists_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(ValueError, match="9000001 bytes stand for 288000064"):
        parse_json(b"[" + b"[]," * 3_000_000)


def test_a_line_without_an_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(content, "MAX_LINE", 10)
    assert list(text_lines(b"12345678\n\n1\r\n")) == ["12345678", "", "1"]
    with pytest.raises(ValueError, match="line 2 has 10 characters or more"):
        list(text_lines(b"1\n" + b"1" * 20))


@pytest.mark.parametrize("line", [b"\n", b" \r\n", b"\t\n", b";;\n"])
def test_a_text_of_nothing_but_empty_lines_is_refused(line: bytes) -> None:
    assert len(list(text_lines(2 * (b"1\n" + line * 9_000)))) == 18_002
    with pytest.raises(ValueError, match="line 10002 is one of more than 10000 empty lines"):
        list(text_lines(b"1\n" + line * 20_000))


def test_the_size_of_a_text_is_seen_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "large.trc"
    with path.open("wb") as file:
        file.write(b"PathFileType")
        file.truncate((1 << 30) + 1)
    with pytest.raises(ValueError, match="more than 1073741824 bytes; FGPOSE_MAX_FILE_GB raises the limit"):
        load_trajectory(path)
    path.write_bytes(bytes(1000))
    monkeypatch.setenv("FGPOSE_MAX_FILE_GB", "3e-6")
    with pytest.raises(ValueError, match="more than 805 bytes"):
        read_content(path)
    monkeypatch.setenv("FGPOSE_MAX_FILE_GB", "much")
    with pytest.raises(ValueError, match="FGPOSE_MAX_FILE_GB is 'much', no number of gigabytes"):
        read_content(path)


@pytest.mark.parametrize(("n_markers", "why"), [(4097, "line 4 names 4097 markers"), (4000, "bytes stand for")])
def test_a_trc_that_promises_more_than_it_has_is_refused(
    n_markers: int, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plain_files, "MAX_UNSUSPICIOUS_BYTES", 1 << 20)
    names = "\t".join(f"m{n}" for n in range(n_markers))
    (tmp_path / "bomb.trc").write_text(TRC.format(n=10**9, names=names) + "1\t0\n" * 1000)
    with pytest.raises(ValueError, match=rf"bomb\.trc: .*{why}"):
        load_trajectory(tmp_path / "bomb.trc")


def test_numbers_beyond_all_bounds_are_gaps(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(TRC.format(n=10**9, names="A\t\t\tB") + f"1\t0\t{'1' * 1000}\t1e400\t0\t1\t1\t1\n")
    found = load_trajectory(tmp_path / "a.trc")
    assert np.isnan(found.positions_m[0, 0]).all()
    assert found.n_frames == 1


def test_tables_of_many_columns_and_short_rows_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_files, "MAX_UNSUSPICIOUS_BYTES", 1 << 20)
    columns = ",".join(f"a{n}" for n in range(990))
    for header, why in ((f"event,time_s,subject,{columns}", "stand for"), (f"{columns},{columns}", "1980 columns")):
        (tmp_path / "events.csv").write_text(f"{header}\n" + "e,1,s\n" * 2000)
        with pytest.raises(ValueError, match=rf"events\.csv: .*{why}"):
            read_events(tmp_path / "events.csv")


def test_few_images_do_not_make_a_day(tmp_path: Path) -> None:
    rows = ",".join(f'{{"image_id":{frame},"keypoints":[]}}' for frame in range(0, 1_100_000, 999))
    for camera in rig().names:
        (tmp_path / f"{camera}.json").write_text(f'[{rows},{{"image_id":1,"keypoints":[]}}]')
    with pytest.raises(ValueError, match="the numbers of the images are not frame numbers: 1103 images"):
        load_people(tmp_path, rig(), STICK, fps=50.0)


def test_a_message_that_quotes_all_of_a_file_is_cut() -> None:
    assert _one_line(ValueError("a" * 10_000)) == f"{'a' * 3200} [6000 characters] {'a' * 800}"


NAMES = ("=HYPERLINK(1)", "'=1", "''=1", "'a", "+1", "-", "@SUM(A1)", "a, b; c", "größe", "<b>", '"')


def test_names_in_a_trc_come_back_and_none_is_a_formula(tmp_path: Path) -> None:
    written = markers_to_trajectory(list(NAMES), np.arange(3) / 50, np.ones((3, len(NAMES), 3)))
    path = tmp_path / "a\tname\nin two lines.trc"
    save_trajectory(written, path)
    assert path.read_text().splitlines()[0].startswith("PathFileType\t4\t(X/Y/Z)\ta name in two lines.trc")
    cells = path.read_text().splitlines()[3].split("\t")
    assert not [cell for cell in cells if cell.startswith(("=", "+", "-", "@"))]
    assert load_trajectory(path).skeleton.joints == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_name_comes_back_from_a_cell(name: str) -> None:
    assert name_in_cell(as_cell(name)) == name


@pytest.mark.parametrize("name", ["a\tb", "a\nb", "a\rb", "\x1b[2J", "a\u2028b", " a", ""])
def test_a_joint_whose_name_is_several_cells_or_lines_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="is no name of a joint"):
        Skeleton("odd", (name,), bones=(), root=(0,))
