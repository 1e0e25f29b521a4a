"""Running every image of every camera through a network, on all cores, with a cache of the detections."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np

from fgpose.child_process import n_cores
from fgpose.geometry.camera import Camera
from fgpose.io.atomic import check_writable
from fgpose.monocular.clips import Clip, ClipImage
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection_cache import ViewDetections, cache_path, load_detections, store_detections
from fgpose.monocular.network import Network, People, Tracker, people_in
from fgpose.monocular.sources import Sources

Progress = Callable[[int, int], None]
"""Called with the number of images done and the number of images in all."""

# A thread changes to another camera after this many images. So all cores are busy until the end.
_TURN_IMAGES = 10
# A file is written again after this many new images, or after a tenth of those that it has if that is more. So writing
# takes a constant share of the time.
_STORE_IMAGES = 100
_STORE_GROWTH = 0.1
# The number of images that a container states is often off by one or two.
_LOST_IMAGES = 3


def detect(
    sources: Sources,
    network: Network,
    *,
    cache: str | Path | None = None,
    jobs: int | None = None,
    frames: int | None = None,
    progress: Progress | None = None,
) -> Detected:
    """Find the people in every image.

    Several threads take turns with the cameras; the images of one camera are taken in the order of time. What was found
    is kept in one file per camera, also after Ctrl-C or an error, and the next run continues from there. Its tracker
    starts with a detection, as at the beginning of a video, so the joints near that image may differ slightly.

    Args:
        sources: the videos.
        network: detects the people; its sessions should use one thread each.
        cache: folder of the files; None keeps nothing. It is made if it is absent.
        jobs: number of threads; by default as many as there are cores.
        frames: only look at this many images of the fastest camera, and at those of the others up to the same time.
        progress: told how far it is, from the calling thread.

    Warns:
        UserWarning: a file of the cache is damaged or cannot be written, a camera sees nobody at all, a video cannot be
            decoded to its end.

    Raises:
        ValueError: an image cannot be read, the network fails or does not give People of its skeleton (see people_in),
            jobs or frames is not positive, nobody is found in any camera.
        OSError: a video cannot be read, or the cache cannot be written into (before any work).
    """
    jobs = n_cores() if jobs is None else jobs
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    if frames is not None and frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    if cache is not None:
        check_writable(cache)
    pairs = zip(sources.clips, sources.rig.cameras, strict=True)
    views = [_View(clip, camera, network, _limit(clip, sources, frames), cache) for clip, camera in pairs]
    n_known = sum(view.n_done for view in views)
    _work(views, jobs, progress)
    for view in views:
        view.warn_if_lost()
    n_new = sum(view.n_done for view in views) - n_known
    detected = Detected(sources, network.skeleton, tuple(view.detections for view in views), n_new)
    _refuse_nobody(detected)
    return detected


def _limit(clip: Clip, sources: Sources, frames: int | None) -> int | None:
    return None if frames is None else int(np.ceil(frames * clip.fps / sources.fps - 1e-6))


class _View:
    """One camera on its way through the network; one thread at a time works on it."""

    def __init__(
        self, clip: Clip, camera: Camera, network: Network, limit: int | None, cache: str | Path | None
    ) -> None:
        self._clip, self._camera, self._network = clip, camera, network
        self._limit = limit
        self._path = None if cache is None else cache_path(Path(cache), clip, network, camera)
        known = None if self._path is None else load_detections(self._path, network.skeleton.n_joints)
        self._stamps_s: list[float] = [] if known is None else known.stamps_s.tolist()
        self._people: list[People] = [] if known is None else known.unstacked()
        self._ended = known is not None and known.ended
        self._stored = len(self._people), self._ended
        self._pictures: Iterator[ClipImage] | None = None
        self._tracker: Tracker | None = None

    @property
    def n_done(self) -> int:
        return len(self._people) if self._limit is None else min(len(self._people), self._limit)

    @property
    def n_expected(self) -> int:
        if self.finished:
            return self.n_done
        return max(self.n_done, self._clip.n_images if self._limit is None else min(self._limit, self._clip.n_images))

    @property
    def finished(self) -> bool:
        return self._ended or (self._limit is not None and len(self._people) >= self._limit)

    @property
    def detections(self) -> ViewDetections:
        everything = self._stacked()
        return everything if self._limit is None else everything.first(self._limit)

    def take_turn(self, stop: threading.Event) -> None:
        """Look at the next images, and keep what was found from time to time."""
        if self._pictures is None or self._tracker is None:
            self._pictures = self._clip.pictures(len(self._people))
            self._tracker = self._network.tracker(self._camera)
        for _ in range(_TURN_IMAGES):
            if self.finished or stop.is_set():
                break
            picture = next(self._pictures, None)
            if picture is None:
                self._ended = True
                break
            self._people.append(self._found(picture, self._tracker))
            self._stamps_s.append(picture.stamp_s)
        n_stored, _ = self._stored
        if len(self._people) >= n_stored + max(_STORE_IMAGES, _STORE_GROWTH * n_stored):
            self.store()

    def _found(self, picture: ClipImage, tracker: Tracker) -> People:
        try:
            return people_in(picture.image, tracker, self._network)
        except ValueError as error:
            raise ValueError(f"{self._clip.path}, image {picture.number}: {error}") from (error.__cause__ or error)

    def store(self) -> None:
        """Keep what was found. If the disk is full, the work continues without keeping anything."""
        state = len(self._people), self._ended
        if self._path is None or state == self._stored:
            return
        try:
            store_detections(self._stacked(), self._path)
        except OSError as error:
            warnings.warn(f"detections are not kept: {self._path}: {error.strerror or error}", stacklevel=2)
            self._path = None
        self._stored = state

    def warn_if_lost(self) -> None:
        clip, n_images = self._clip, len(self._people)
        if not self._ended or clip.files or n_images >= clip.n_images - _LOST_IMAGES:
            return
        # The number that a container states may be a guess: images are missing where none comes for a while.
        taken_s = [0.0, *self._stamps_s, clip.n_images / clip.own_fps]
        steps_s = np.diff(taken_s)
        longest = int(steps_s.argmax())
        if not steps_s[longest] <= (_LOST_IMAGES + 1) * np.median([*steps_s[1:-1], 1 / clip.own_fps]):
            goes_on = f" to {taken_s[longest + 1]:.2f} s" if longest < n_images else ""
            warnings.warn(
                f"{clip.path}: only {n_images} of {clip.n_images} images can be decoded; "
                f"from {taken_s[longest]:.2f} s{goes_on} the camera sees nothing",
                stacklevel=2,
            )

    def _stacked(self) -> ViewDetections:
        return ViewDetections.stacked(self._stamps_s, self._people, self._network.skeleton.n_joints, self._ended)


def _work(views: list[_View], jobs: int, progress: Progress | None) -> None:
    """Let the threads work on the cameras in turns until all are finished."""
    stop = threading.Event()

    def tell() -> None:
        if progress:
            progress(sum(view.n_done for view in views), sum(view.n_expected for view in views))

    tell()
    try:
        with ThreadPoolExecutor(jobs, "fgpose-detect") as pool:
            try:
                turns: dict[Future[None], _View] = {
                    pool.submit(view.take_turn, stop): view for view in views if not view.finished
                }
                while turns:
                    for turn in wait(turns, return_when=FIRST_COMPLETED).done:
                        view = turns.pop(turn)
                        turn.result()
                        if not view.finished:
                            turns[pool.submit(view.take_turn, stop)] = view
                    tell()
            except BaseException:
                stop.set()
                pool.shutdown(cancel_futures=True)
                raise
    finally:
        # Also after Ctrl-C: the threads have ended, so what they found is complete up to an image.
        for view in views:
            view.store()


def _refuse_nobody(detected: Detected) -> None:
    counts = [int(view.n_people.sum()) for view in detected.views]
    if not any(counts):
        n_images = sum(view.n_images for view in detected.views)
        raise ValueError(f"nobody was found in any of the {n_images} images of {', '.join(detected.rig.names)}")
    for clip, count, view in zip(detected.sources.clips, counts, detected.views, strict=True):
        if not count:
            warnings.warn(f"{clip.path}: nobody was found in its {view.n_images} images", stacklevel=3)
