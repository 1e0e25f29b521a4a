"""The line in the terminal says what frames say."""

from __future__ import annotations

import io
import logging
from dataclasses import replace

import pytest
from live_frames import live_frame, live_judgement, live_person, standing_m
from rich.console import Console

from fgpose.cli.commands.live import ConsoleLog, StatusLine, _table, in_words
from fgpose.cli.console import PlainConsole
from fgpose.live.frame import LiveFrame, LiveJudgement
from fgpose.live.statistics import LiveStatistics
from fgpose.skeleton import Skeleton


@pytest.fixture
def frame(skeleton: Skeleton) -> LiveFrame:
    person = live_person(standing_m(skeleton))
    return live_frame(skeleton, [person], 1000.0, cameras=("a", "b", "c"), lost=("b",), delay_s=0.02)


def test_people_cameras_and_frames(frame: LiveFrame, skeleton: Skeleton) -> None:
    assert in_words(frame, 29.7).startswith("1 person · 2 of 3 cameras ok (b lost) · 30 frames/s")
    empty = live_frame(skeleton, [], 1000.0, cameras=("a", "b"), delay_s=0.02)
    expected = "0 people · 2 of 2 cameras ok · 10 frames/s, 20 ms old · 100% of the volume observed"
    assert in_words(empty, 10.0) == expected


def test_what_is_wrong_comes_first_and_that_nobody_has_looked_yet(frame: LiveFrame) -> None:
    said = live_judgement()
    usual = in_words(frame, 29.7)
    lines = {
        "PROBABLY WRONG: mirrored-image, late-camera": said,
        "doubtful: late-camera": replace(said, findings=said.findings[1:]),
        "not diagnosed yet": LiveJudgement(waits_for="nobody was seen to move yet"),
    }
    for words, judgement in lines.items():
        assert in_words(replace(frame, diagnosis=judgement), 29.7) == f"{words} · {usual}"
    assert in_words(replace(frame, diagnosis=replace(said, findings=())), 29.7) == usual


def test_the_line_is_there_while_it_runs_and_the_log_above_it(frame: LiveFrame) -> None:
    text = io.StringIO()
    console = PlainConsole(file=text, force_terminal=True, width=200)
    logger = logging.getLogger("fgpose.test_of_the_line")
    logger.addHandler(ConsoleLog(console))
    with StatusLine(console) as line:
        line.publish(frame)
        logger.warning("camera [b]: lost")
    assert "2 of 3 cameras ok (b lost)" in text.getvalue()
    assert "camera [b]: lost\n" in text.getvalue()


@pytest.mark.parametrize(
    ("delays_s", "words"),
    [
        ((0.02, 0.02, 0.03), "median 20 ms, 95 % 30 ms, 99 % 30 ms"),
        ((4.9, 27.0), "median 4900 ms, 95 % more than 5000 ms, 99 % more than 5000 ms"),
        ((26.9, 27.0), "median more than 5000 ms, 95 % more than 5000 ms, 99 % more than 5000 ms"),
    ],
)
def test_delays_beyond_the_longest_that_is_counted_are_said_to_be_so(
    skeleton: Skeleton, delays_s: tuple[float, ...], words: str
) -> None:
    report = LiveStatistics(("a",))
    for number, delay_s in enumerate(delays_s):
        report.add(live_frame(skeleton, [], 1024.0 + number, cameras=("a",), delay_s=delay_s + 1e-4))
    assert _table(report).title == f"{len(delays_s)} frames; from image to frame: {words}"


@pytest.mark.parametrize("name", ["cam [/dev/video0]", "cam[left]", "[bold]cam", "[/]"])
def test_names_in_brackets_are_no_markup(skeleton: Skeleton, name: str) -> None:
    text = io.StringIO()
    with StatusLine(PlainConsole(file=text, force_terminal=True, width=200)) as line:
        line.publish(live_frame(skeleton, [], 1000.0, cameras=(name,), lost=(name,)))
    assert f"0 of 1 cameras ok ({name} lost)" in text.getvalue()


@pytest.mark.parametrize("name", ["[/dev/video0].mp4", "a[bold]b"])
def test_names_in_any_line_with_a_spinner_are_no_markup(name: str) -> None:
    text = io.StringIO()
    console = PlainConsole(file=text, force_terminal=True, width=200)
    with console.status(f"checking {name}"):
        pass
    with console.status("checking") as status:
        status.update(f"{name}: 3 s")
    assert f"checking {name}" in text.getvalue()
    assert f"{name}: 3 s" in text.getvalue()


def test_nothing_is_shown_in_a_file(frame: LiveFrame) -> None:
    text = io.StringIO()
    with StatusLine(Console(file=text, width=200)) as line:
        line.publish(frame)
    assert text.getvalue().strip() == ""
