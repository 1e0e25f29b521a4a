"""What is wrong with the pictures of a camera, compared with what they usually are."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import UInt8

from fgpose.finding import Code
from fgpose.live.cameras.image import Picture
from fgpose.live.cameras.moved import MovedCheck

# Pictures are looked at with about as many pixels as 480 x 270; details that matter to a person survive.
_PIXELS = 480 * 270
# Times a second; in between, pictures are only compared with the one before.
_LOOKS_HZ = 5.0
# A fault is one that lasts: a single picture may be damaged, and somebody may pass close to the camera.
_LASTS_S = 0.45
# And not one picture alone, of a slow camera.
_LASTS_PICTURES = 4
# Averages of what is usual: long against a fault that is noticed, short against daylight.
_USUAL_S = 60.0
# Sensor noise changes more than half of all pixels between two images if the codec leaves it; if so nearly always, its
# absence is a fault. Re-encoding a picture that stands still changes less than this share.
_NOISY_SHARE, _STILL_SHARE, _NEARLY_ALWAYS = 0.5, 0.05, 0.95
# A quarter of the usual contrast: two stops less light, or something before the lens. Less than three grey levels are
# no picture anywhere.
_DARK_SHARE, _NO_CONTRAST = 0.25, 3.0
# Blocks of 8 x 8 samples within two grey levels are blank: lost parts are grey or repeat one colour.
_BLOCK, _BLANK_LEVELS, _BLANK_SHARE = 8, 2, 0.25


class PictureFaults:
    """Follows the pictures of one camera: frozen, black or covered, garbled, moved."""

    def __init__(self) -> None:
        self._frozen, self._moved = _FrozenCheck(), MovedCheck()
        self._usual_contrast: float | None = None
        self._usual_blank: float | None = None
        self._looked_s = -np.inf
        self._since_s: dict[str, float] = {}

    def add(self, picture: Picture, arrived_s: float) -> dict[str, str]:
        """Faults after this picture that have lasted: their names, and reasons in words."""
        luma = picture.luma()
        step = max(round(np.sqrt(luma.size / _PIXELS)), 1)
        small = np.ascontiguousarray(luma[::step, ::step])
        found = {"frozen": self._frozen.add(small[::2, ::2], arrived_s)}
        if arrived_s >= self._looked_s + 1 / _LOOKS_HZ:
            self._look(small, arrived_s)
            self._looked_s = arrived_s
        for name, since_s in self._since_s.items():
            found[name] = arrived_s - since_s >= _LASTS_S
        return {name: _REASONS[name] for name, lasts in found.items() if lasts}

    def restart(self) -> None:
        """Other pictures may come now, e.g. after reconnecting; what is usual stays."""
        self._frozen = _FrozenCheck()

    def _look(self, small: UInt8[np.ndarray, "y x"], arrived_s: float) -> None:
        share = min((arrived_s - self._looked_s) / _USUAL_S, 1.0)
        contrast = float(small.std())
        is_black = contrast < max(_NO_CONTRAST, _DARK_SHARE * (self._usual_contrast or 0.0))
        blank = _blank_share(small)
        is_garbled = not is_black and self._usual_blank is not None and blank > self._usual_blank + _BLANK_SHARE
        is_moved = not is_black and not is_garbled and self._moved.add(small)
        if not is_black:
            self._usual_contrast = _towards(self._usual_contrast, contrast, share)
        if not is_black and not is_garbled:
            self._usual_blank = _towards(self._usual_blank, blank, share)
        for name, is_so in (("black", is_black), ("garbled", is_garbled), ("moved", is_moved)):
            if not is_so:
                self._since_s.pop(name, None)
            else:
                self._since_s.setdefault(name, arrived_s)


_REASONS = {
    "frozen": f"the same picture again and again [{Code.FROZEN_CAMERA}]",
    "black": "black or covered",
    "garbled": "parts of the picture are blank",
    "moved": f"the camera was moved [{Code.BUMPED_CAMERA}]",
}


def _towards(usual: float | None, now: float, share: float) -> float:
    return now if usual is None else usual + share * (now - usual)


def _blank_share(small: UInt8[np.ndarray, "y x"]) -> float:
    """Of the blocks that have one brightness."""
    rows, columns = small.shape[0] // _BLOCK, small.shape[1] // _BLOCK
    if not rows or not columns:
        return 0.0
    blocks = small[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    levels = blocks.max(axis=(1, 3)) - blocks.min(axis=(1, 3))
    return float((levels <= _BLANK_LEVELS).mean())


class _FrozenCheck:
    """Equal pictures for longer than this camera ever gives.

    A still scene of a sensor has noise, but a codec may leave it out and repeat a picture until the next key frame. So
    runs of equal pictures that come often are usual, and their length is what is compared.
    """

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._arrived_s = self._same_since_s = self._still_since_s = -np.inf
        self._n_same = 0
        self._runs: deque[tuple[float, float]] = deque(maxlen=20)
        self._noisy_share = 0.0

    def add(self, sample: UInt8[np.ndarray, "y x"], arrived_s: float) -> bool:
        last, self._last = self._last, sample
        if last is None or last.shape != sample.shape:
            self._same_since_s = self._still_since_s = self._arrived_s = arrived_s
            return False
        changed = np.count_nonzero(sample != last) / sample.size
        if changed > 0:
            length_s = self._arrived_s - self._same_since_s
            if length_s > _LASTS_S:
                self._runs.append((arrived_s, length_s))
            self._same_since_s, self._n_same = arrived_s, 0
        else:
            self._n_same += 1
        if changed > _STILL_SHARE:
            share = min((arrived_s - self._arrived_s) / _USUAL_S, 1.0)
            self._noisy_share += share * (float(changed > _NOISY_SHARE) - self._noisy_share)
            self._still_since_s = arrived_s
        self._arrived_s = arrived_s
        is_quiet = self._noisy_share > _NEARLY_ALWAYS and arrived_s - self._still_since_s > _LASTS_S
        is_same = self._n_same >= _LASTS_PICTURES and arrived_s - self._same_since_s > self._usual_run_s(arrived_s)
        return is_quiet or is_same

    def _usual_run_s(self, now_s: float) -> float:
        lengths_s = [length_s for ended_s, length_s in self._runs if ended_s > now_s - _USUAL_S]
        # Three in a minute are no accident.
        return 2 * float(np.median(lengths_s)) if len(lengths_s) >= 3 else _LASTS_S
