"""Networks of other packages that do not keep to the interface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from fgpose.monocular.detection import detect
from fgpose.monocular.network import People
from fgpose.monocular.sources import Sources, open_sources

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

WRONG_IMAGE = 4


@pytest.fixture(scope="module")
def sources(squares: SquaresScene, tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return open_sources(squares.write_all(tmp_path_factory.mktemp("videos"), 6), squares.rig)


class Changed:
    """Another network, whose answer to one image is changed."""

    name = "mine"

    def __init__(self, network: SquaresNetwork, change: Callable[[People], Any]) -> None:
        self.skeleton, self._network, self._change = network.skeleton, network, change

    def tracker(self, camera: Any) -> Any:
        tracker, n_seen = self._network.tracker(camera), 0

        def answer(image: np.ndarray) -> Any:
            nonlocal n_seen
            n_seen += 1
            found = tracker.detect(image)
            return self._change(found) if n_seen == WRONG_IMAGE + 1 else found

        return SimpleNamespace(detect=answer)


def with_arrays(change: Callable[[np.ndarray], Any], *names: str) -> Callable[[People], People]:
    """Made without the checks of shapes that the tests put into the class."""

    def changed(people: People) -> People:
        for name in names:
            object.__setattr__(people, name, change(getattr(people, name)))
        return people

    return changed


def failing(people: People) -> People:
    raise RuntimeError("CUDA out of memory")


ALL = tuple(People.shapes(3))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (with_arrays(lambda a: np.repeat(a, 2, axis=0), "boxes"), r"gave points2d_px \(1, 3, 2\) for 2 boxes"),
        (with_arrays(lambda a: a[:, :2], *ALL[1:]), r"gave points2d_px \(1, 2, 2\) for 1 box, not \(1, 3"),
        (with_arrays(lambda a: a[:, :4], "boxes"), r"gave boxes \(1, 4\), not \(people, 5\)"),
        (with_arrays(lambda a: a[0], *ALL), r"gave boxes \(5,\), not \(people, 5\)"),
        (with_arrays(lambda a: a[..., [0, 1, 1]], "points2d_px"), r"gave points2d_px \(1, 3, 3\) for 1 box"),
        (with_arrays(lambda a: None, "covariance_m2"), "gave covariance_m2 of object, not of numbers"),
        (with_arrays(lambda a: a.astype(str), "confidence"), "gave confidence of <U32, not of numbers"),
        (with_arrays(lambda a: a + 1j, "points2d_px"), "gave points2d_px of complex128, not of numbers"),
        (with_arrays(lambda a: np.full_like(a, np.inf), "points2d_px"), "gave points2d_px with inf"),
        (with_arrays(lambda a: a * np.nan, "confidence"), r"gave a confidence of nan, not in \[0, 1\]"),
        (with_arrays(lambda a: -np.ones_like(a), *ALL[3:]), "gave a covariance_m2 that is not positive definite"),
        (with_arrays(lambda a: (None,), "problems"), "gave problems that are no texts"),
        (with_arrays(lambda a: a * 100, "confidence"), r"gave a confidence of 90, not in \[0, 1\]"),
        (with_arrays(lambda a: a - 1, "confidence"), r"gave a confidence of -0\.1, not in \[0, 1\]"),
        (lambda people: None, "gave NoneType, not .*People"),
        (lambda people: vars(people), "gave dict, not .*People"),
        (failing, "failed: RuntimeError: CUDA out of memory"),
    ],
)
def test_what_is_wrong_is_said_with_the_image_and_the_network(
    change: Callable[[People], Any], said: str, sources: Sources, squares_network: SquaresNetwork
) -> None:
    with pytest.raises(ValueError, match=rf"ring_\d\.mp4, image {WRONG_IMAGE}: network mine {said}") as raised:
        detect(sources, Changed(squares_network, change), jobs=1)
    assert isinstance(raised.value.__cause__, RuntimeError if change is failing else ValueError)


def test_what_was_found_before_is_kept(sources: Sources, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    network = Changed(squares_network, failing)
    with pytest.raises(ValueError, match="CUDA"):
        detect(sources, network, cache=tmp_path, jobs=1)
    n_seen = len(squares_network.seen)
    network._change = lambda people: people
    assert detect(sources, network, cache=tmp_path).n_new_images == 18 - n_seen + 1


def test_confidences_that_are_rounded_are_taken(sources: Sources, squares_network: SquaresNetwork) -> None:
    for given, taken in ((1.005, 1.0), (-0.005, 0.0)):
        change = with_arrays(lambda a, given=given: np.full_like(a, given), "confidence")
        detected = detect(sources, Changed(squares_network, change), jobs=1)
        confidences = [image.confidence for image in detected.people.images if image.camera == "ring_0"]
        np.testing.assert_array_equal(confidences[WRONG_IMAGE], taken)


def test_a_network_may_fill_the_same_arrays_again(sources: Sources, squares_network: SquaresNetwork) -> None:
    """As programs do that keep their memory."""
    kept: dict[str, np.ndarray] = {}

    def into_kept(people: People) -> People:
        for name in ALL:
            array = kept.setdefault(name, getattr(people, name).copy())
            array[...] = getattr(people, name)
            object.__setattr__(people, name, array)
        return people

    class Keeping(Changed):
        def tracker(self, camera: Any) -> Any:
            tracker = self._network.tracker(camera)
            return SimpleNamespace(detect=lambda image: into_kept(tracker.detect(image)))

    fresh, kept_too = (detect(sources, each, jobs=1) for each in (squares_network, Keeping(squares_network, into_kept)))
    for one, other in zip(fresh.people.images, kept_too.people.images, strict=True):
        np.testing.assert_array_equal(one.points2d_px, other.points2d_px)
