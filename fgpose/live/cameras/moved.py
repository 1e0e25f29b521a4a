"""Whether a camera was moved: its background is elsewhere in the picture."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

_TILES = (3, 4)
# A tile with less contrast has no place.
_TEXTURE_LEVELS = 4.0
# Peak of the phase correlation of two pictures of one thing; of different things it is about 0.05.
_RESPONSE = 0.15
# Correlation of a tile with its background if nobody hides more than a part of it.
_SAME = 0.7
# In pixels of the small picture, at most a five-hundredth of its width: phase correlation is off by a fifth of that.
_SHIFT = 0.5
# Of the tiles with texture. People hide some of them, but they do not shift what is behind them.
_SHIFTED_SHARE, _HOLDING_SHARE = 0.5, 0.15
_FEWEST_TILES = 3
# A few looks to begin with; then things that are put elsewhere become background in some minutes.
_FIRST_LOOKS, _LEARNED_SHARE = 4, 0.005


class MovedCheck:
    """Compares tiles of the picture with the background, by phase correlation.

    Moved: half of the tiles have shifted, or hardly any is where it was. Shifts that grow more slowly than the
    background is learned are not seen.
    """

    def __init__(self) -> None:
        self._background: np.ndarray | None = None
        self._n_looks = 0

    def add(self, picture: UInt8[np.ndarray, "y x"]) -> bool:
        """Whether the camera is not where it was when the background was learned."""
        import cv2

        small = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._background is None or self._background.shape != small.shape:
            self._background, self._n_looks = small, 1
            return False
        moved = self._n_looks >= _FIRST_LOOKS and _has_moved(self._background, small)
        if not moved:
            self._n_looks += 1
            share = max(1 / self._n_looks if self._n_looks <= _FIRST_LOOKS else 0.0, _LEARNED_SHARE)
            self._background += np.float32(share) * (small - self._background)
        return moved


def _has_moved(background: Float[np.ndarray, "y x"], small: Float[np.ndarray, "y x"]) -> bool:
    height, width = background.shape[0] // _TILES[0], background.shape[1] // _TILES[1]
    if min(height, width) < 8:
        return False
    n_textured, n_holding, n_shifted = 0, 0, 0
    for row in range(_TILES[0]):
        for column in range(_TILES[1]):
            tile = np.s_[row * height : (row + 1) * height, column * width : (column + 1) * width]
            if background[tile].std() < _TEXTURE_LEVELS:
                continue
            shift = _shift_of_tile(background[tile], small[tile])
            n_textured += 1
            n_holding += shift == (0.0, 0.0)
            n_shifted += shift is not None and shift != (0.0, 0.0)
    if n_textured < _FEWEST_TILES:
        return False
    return n_holding <= _HOLDING_SHARE * n_textured or n_shifted >= _SHIFTED_SHARE * n_textured


def _shift_of_tile(background: Float[np.ndarray, "y x"], tile: Float[np.ndarray, "y x"]) -> tuple[float, float] | None:
    """Where the background is now, in pixels; (0, 0) where it was, None if it is hidden.

    Along an edge a shift cannot be seen. So one counts only if it explains half of the difference.
    """
    import cv2

    height, width = background.shape
    here = _correlation(background, tile)
    # OpenCV multiplies pictures of some sizes with the window in place.
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    (x, y), response = cv2.phaseCorrelate(background.copy(), tile.copy(), window)
    margin_x, margin_y = int(np.ceil(abs(x))), int(np.ceil(abs(y)))
    if response > _RESPONSE and np.hypot(x, y) >= _SHIFT and 4 * margin_x < width and 4 * margin_y < height:
        back = np.array([[1, 0, -x], [0, 1, -y]], np.float32)
        inside = np.s_[margin_y : height - margin_y, margin_x : width - margin_x]
        there = _correlation(background[inside], cv2.warpAffine(tile, back, (width, height))[inside])
        if 1 - there < 0.5 * (1 - here):
            return x, y
    return (0.0, 0.0) if here > _SAME else None


def _correlation(one: Float[np.ndarray, "y x"], other: Float[np.ndarray, "y x"]) -> float:
    """Pearson's, whatever the light is."""
    one, other = one - one.mean(), other - other.mean()
    scale = np.sqrt((one**2).sum() * (other**2).sum())
    return float((one * other).sum() / scale) if scale > 0 else 0.0
