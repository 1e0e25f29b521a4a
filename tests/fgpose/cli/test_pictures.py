"""The images of videos, each in its frame of a recording for the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from fgpose.cli.pictures import show_images
from fgpose.monocular.detection import detect
from fgpose.monocular.sources import open_sources

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

N_IMAGES, FPS = 8, 20.0


class Frames:
    """A recording that keeps which frames have a picture, and which have none any more."""

    def __init__(self) -> None:
        self.images: dict[tuple[str, int], np.ndarray] = {}
        self.none: list[tuple[str, int, float]] = []

    def wants_image(self, camera: str, frame: int) -> bool:
        return True

    def log_image(self, camera: str, frame: int, time_s: float, image: np.ndarray) -> None:
        self.images[camera, frame] = image

    def log_no_image(self, camera: str, frame: int, time_s: float) -> None:
        self.none.append((camera, frame, time_s))


@pytest.mark.parametrize("known", [False, True])
def test_images_are_in_the_frames_of_the_clock_that_was_found(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path, known: bool
) -> None:
    """A camera that began 0.1 s late, also if that was known when the videos were read; and after the last image of
    each one nothing is shown any more, as soon as another one is overdue."""
    videos = squares.write_all(tmp_path / "walk", N_IMAGES, FPS)
    found = squares.rig.with_time_offsets(np.array([0.0, 0.1, 0.0]))
    detected = detect(open_sources(videos, found if known else squares.rig), squares_network)
    recording, time_s = Frames(), np.arange(N_IMAGES + 4) / FPS
    show_images(detected, found, time_s, recording)  # pyrefly: ignore[bad-argument-type]
    first = {name: 2 * (name == "ring_1") for name in squares.rig.names}
    assert set(recording.images) == {(name, n + first[name]) for name in first for n in range(N_IMAGES)}
    assert recording.none == [(name, N_IMAGES + n + 1, (N_IMAGES + n + 1) / FPS) for name, n in first.items()]
    for (name, frame), image in recording.images.items():
        expected = squares.image(squares.rig.names.index(name), (frame - first[name]) / FPS)
        assert np.abs(image.astype(int) - expected).mean() < 3  # as in test_cli_video
