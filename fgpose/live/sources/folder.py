"""Images in a folder, played as a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fgpose.live.cameras.image import ArrayPicture, Picture, SourceImage
from fgpose.live.sources.frame_dropping import Dropping, Lateness
from fgpose.live.sources.playback import Playback
from fgpose.live.sources.source import SourceError
from fgpose.monocular.image_files import image_files
from fgpose.plain_files import check_plain


class FolderSource:
    """The images of a folder in natural order.

    Raises:
        SourceError: there are none, or the first cannot be read.
    """

    is_recording = True

    def __init__(
        self, name: str, folder: str, fps: float, playback: Playback, *, in_real_time: bool, loop: bool
    ) -> None:
        self._name, self._folder, self._fps = name, folder, fps
        self._playback, self._in_real_time, self._loop = playback, in_real_time, loop
        self._lateness, self._n_left_out = Lateness(), 0
        try:
            self._files = image_files(Path(folder))
        except OSError as error:
            raise SourceError(name, folder, error.strerror or "it cannot be listed") from None
        if not self._files:
            raise SourceError(name, folder, "there are no images in it")
        first = _read(self._files[0])
        if first is None:
            raise SourceError(name, str(self._files[0]), "not an image, or a damaged one")
        self.size_px = first.size_px
        playback.join(len(self._files) / fps)

    def images(self) -> Iterator[SourceImage]:
        return self._playback.play(self._frames, in_real_time=self._in_real_time, loop=self._loop)

    def hurry(self, late_s: float) -> None:
        if self._lateness.dropping(late_s) is not Dropping.NONE:
            self._n_left_out = int(late_s * self._fps)

    def close(self) -> None:
        pass

    def _frames(self) -> Iterator[tuple[float, Picture | None]]:
        for k, path in enumerate(self._files):
            if self._n_left_out:
                self._n_left_out -= 1
            else:
                yield k / self._fps, _read(path)


def _read(path: Path) -> ArrayPicture | None:
    import cv2

    try:
        check_plain(path)
        array = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except (OSError, cv2.error):
        # A pipe, or an image of more pixels than plain_files.MAX_IMAGE_PX.
        return None
    return None if array is None else ArrayPicture(cv2.cvtColor(array, cv2.COLOR_BGR2RGB))
