from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.text import Text

from fgpose_benchmarks.accuracy.figures import (
    calibration_curves,
    error_against_cameras,
    error_against_desynchronised_cameras,
    error_of_joints,
    write_figures,
)
from fgpose_benchmarks.comparison.plot_style import SELF_CALIBRATED, shown
from fgpose_benchmarks.comparison.scores import Score
from fgpose_benchmarks.comparison.summary import Summaries, summarise
from tests.benchmarks.comparison.made_up_scores import made_up

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NONE = (np.nan,) * 3
# Two pairs are nearly equal: their labels must be moved apart.
METHODS = {
    "one view": ("per-frame", 130.0),
    "RANSAC": ("per-frame", 58.0),
    "the paper's method": ("per-frame", 66.0),
    "RANSAC + Butterworth": ("linear", 40.0),
    "aniposelib, best setting": ("peer", 39.9),
    "AdaFuse": ("file", 55.0),
    "something": ("unheard of", 3.0),
    "fgpose per frame": ("ours", 36.0),
    "fgpose online, lag 0.2 s": ("ours", 18.0),
    "fgpose batch": ("ours", 14.0),
    SELF_CALIBRATED: ("ours", 13.9),
    "oracle": ("oracle", 13.6),
}
FACTORS = {
    "occluded": 1.0,
    "occluded_3_cameras": 1.5,
    "occluded_2_cameras": 2.0,
    "clean": 0.5,
    "desync_1": 0.6,
    "desync_2": 0.7,
    "desync_3": 0.8,
}


def all_scores(clips: tuple[str, ...] = ("walk", "jump")) -> list[Score]:
    return [
        made_up(
            variant,
            clip,
            method,
            group,
            error_mm * factor * (1.0 + 0.2 * index),
            joint_mm=tuple(float(joint) for joint in range(17)),
            coverage=(0.5 + 0.1 * (factor - 1.0), 0.9, 0.99) if group in ("ours", "oracle") else NONE,
            coverage_occluded=NONE if variant == "clean" or group not in ("ours", "oracle") else (0.45, 0.85, 0.97),
        )
        for variant, factor in FACTORS.items()
        for index, clip in enumerate(clips)
        for method, (group, error_mm) in METHODS.items()
    ]


@pytest.fixture(scope="module")
def summaries() -> Summaries:
    return summarise(all_scores())


def bars_of(axes: Axes) -> list[ErrorbarContainer]:
    return [container for container in axes.containers if isinstance(container, ErrorbarContainer)]


def drawn(draw: Callable[[Summaries], Figure | None], summaries: Summaries) -> Figure:
    figure = draw(summaries)
    assert figure is not None
    return figure


def test_pictures_show_the_best_of_each_group_and_who_has_a_name(summaries):
    assert list(shown(summaries, ["occluded"])) == [
        "the paper's method",
        "RANSAC",
        "AdaFuse",
        "RANSAC + Butterworth",
        "aniposelib, best setting",
        "fgpose online, lag 0.2 s",
        "fgpose batch",
        "oracle",
    ]
    assert SELF_CALIBRATED in shown(summaries, ["occluded"], also=(SELF_CALIBRATED,))


def test_the_looks_of_one_picture_differ(summaries):
    styles = list(shown(summaries, ["occluded"], also=(SELF_CALIBRATED,)).values())
    assert len({(look.colour, look.style) for look in styles}) == len(styles)


def test_a_method_that_misses_a_variant_is_not_drawn(summaries):
    without = {key: summary for key, summary in summaries.items() if key != ("desync_2", "RANSAC")}
    assert "RANSAC" not in shown(without, ["clean", "desync_2"])
    # The next best of its group takes its place.
    assert "the paper's method" in shown(without, ["clean", "desync_2"])


@pytest.mark.slow
def test_every_picture_is_written_as_a_png_of_150_dots_per_inch(tmp_path, summaries):
    written = write_figures(summaries, tmp_path)
    assert {path.name for path in written} == {"cameras.png", "desynchronised.png", "joints.png", "calibration.png"}
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert all(written.values())
    for path in written:
        image = cv2.imread(str(path))
        assert image is not None
        # Lines and letters cover some of a picture, white most of it.
        assert 0.01 < (image.min(axis=-1) < 200).mean() < 0.3
    cameras = cv2.imread(str(tmp_path / "cameras.png"))
    assert cameras is not None
    assert cameras.shape[1] == 7.5 * 150


def test_pictures_without_their_variants_are_left_out(tmp_path, summaries):
    clean = {key: summary for key, summary in summaries.items() if key == ("clean", "RANSAC")}
    assert write_figures(clean, tmp_path) == {}
    assert list(tmp_path.iterdir()) == []
    no_third = {key: summary for key, summary in summaries.items() if key[0] != "occluded_3_cameras"}
    assert error_against_cameras(no_third) is None
    assert error_against_desynchronised_cameras(no_third) is not None


def test_lines_go_through_the_means_with_bars_of_their_intervals(summaries):
    axes = drawn(error_against_cameras, summaries).axes[0]
    ends = {text.get_text(): text.xy for text in axes.texts}  # pyrefly: ignore[missing-attribute]
    # Two recordings, the second 20 % harder: the mean is 1.1 times the first, and the interval reaches to both.
    assert ends["fgpose batch"][1] == pytest.approx(14.0 * 2.0 * 1.1)
    means_mm = np.array([14.0, 21.0, 28.0]) * 1.1
    (batch,) = (bars for bars in bars_of(axes) if np.allclose(bars.lines[0].get_ydata(), means_mm))
    assert batch.lines[2][0].get_segments()[0][:, 1] == pytest.approx([14.0, 14.0 * 1.2])
    assert [label.get_text() for label in axes.get_xticklabels()] == ["4", "3", "2"]
    assert axes.get_ylim()[0] == 0.0
    assert axes.get_title("left") == "Mean over 2 recordings; bars: from the best to the worst"


def test_offsets_are_estimated_by_the_self_calibrated_batch_which_is_shown_then(summaries):
    axes = drawn(error_against_desynchronised_cameras, summaries).axes[0]
    assert SELF_CALIBRATED in {text.get_text() for text in axes.texts}


def test_one_recording_draws_lines_without_bars():
    figure = drawn(error_against_cameras, summarise(all_scores(clips=("walk",))))
    assert figure.axes[0].get_title("left") == "One recording"
    segments = [segment for bars in bars_of(figure.axes[0]) for segment in bars.lines[2][0].get_segments()]
    assert not [segment for segment in segments if len(segment) and np.isfinite(segment).all()]


@pytest.mark.parametrize("draw", [error_against_cameras, error_against_desynchronised_cameras])
def test_labels_are_whole_and_do_not_overlap(summaries, draw):
    figure = drawn(draw, summaries)
    figure.draw_without_rendering()
    # Of the text alone, without the line that leads to it.
    boxes = [Text.get_window_extent(text) for text in figure.axes[0].texts]
    assert len(boxes) >= 8
    assert not [pair for pair in itertools.combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_joints_are_means_of_left_and_right_by_name(summaries):
    axes = drawn(error_of_joints, summaries).axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names[:2] == ["pelvis", "hip"]
    assert len(names) == 11
    values_mm = np.asarray(axes.lines[0].get_xdata())
    # The error of every made-up joint is its index: the hips are the joints 1 and 4, the wrists 13 and 16.
    assert values_mm[names.index("hip")] == pytest.approx(2.5)
    assert values_mm[names.index("wrist")] == pytest.approx(14.5)


def test_joints_of_another_skeleton_go_by_their_index():
    scores = [made_up(joint_mm=(3.0, 4.0, np.nan)), made_up(clip="run", joint_mm=(5.0, 6.0, np.nan))]
    axes = drawn(error_of_joints, summarise(scores)).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["joint 0", "joint 1", "joint 2"]
    assert axes.lines[0].get_xdata() == pytest.approx([4.0, 5.0, np.nan], nan_ok=True)


def test_calibration_is_the_mean_and_range_over_the_variants(summaries):
    figure = drawn(calibration_curves, summaries)
    panes = {axes.get_title("left"): axes for axes in figure.axes}
    assert set(panes) == {"fgpose online, lag 0.2 s", "fgpose batch", SELF_CALIBRATED, "oracle"}
    every, occluded = panes["oracle"].lines[:2]
    mean_factor = np.mean(list(FACTORS.values()))
    assert every.get_ydata() == pytest.approx([100 * (0.5 + 0.1 * (mean_factor - 1.0)), 90.0, 99.0])
    assert occluded.get_ydata() == pytest.approx([45.0, 85.0, 97.0])
    first_bar = panes["oracle"].collections[0].get_segments()[0]  # pyrefly: ignore[missing-attribute]
    assert first_bar == pytest.approx(np.array([[50.0, 45.0], [50.0, 60.0]]))


def test_an_overconfident_method_stays_inside_its_pane():
    figure = drawn(calibration_curves, summarise([made_up(coverage=(0.1, 0.3, 0.5), coverage_occluded=NONE)]))
    assert figure.axes[0].get_ylim()[0] < 10.0


def test_nothing_is_drawn_of_covariances_that_nobody_states():
    assert calibration_curves(summarise([made_up(coverage=NONE, coverage_occluded=NONE)])) is None
