"""Finding the corners of a board in an image, by OpenCV's detectors, and how sharp they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.sightings import MIN_POINTS

if TYPE_CHECKING:
    import cv2

Grey = UInt8[np.ndarray, "height width"]
# Half the window in which an edge of a corner is looked at, as a share of the distance to the next corner, and pixels.
_WINDOW, _MOST_WINDOW_PX = 0.3, 12
_LEAST_WINDOW_PX = 3
_LEAST_SADDLE_PX = 2  # a quadric has six numbers, and 13 pixels lie within two of a corner
_MAX_STEPS, _STEP_PX = 10, 1e-3
_MOST_SEARCHED_PX = 1280
# Of a marker, as a share of the longer side of the image; OpenCV's 0.03 leaves out a board of 0.6 m at 4 m in Full HD.
_LEAST_PERIMETER, _ENLARGED = 0.01, 2
# In which slopes are looked at, over half a turn.
_DIRECTIONS = np.stack([np.sin(np.arange(12) * np.pi / 12), np.cos(np.arange(12) * np.pi / 12)], axis=1)
_CIRCLE_AREA_PX2 = (20.0, 4e4)


@runtime_checkable
class Detector(Protocol):
    """Of one camera."""

    def find(self, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        """Corners in pixels, NaN where one is not found; None: no board."""
        ...


def opencv_charuco(board: Board, *, legacy: bool = False) -> cv2.aruco.CharucoBoard:
    """OpenCV's board; legacy: as OpenCV before 4.6 drew those with an even number of rows."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    charuco = cv2.aruco.CharucoBoard(board.size, board.square_m, board.marker_m, dictionary)
    charuco.setLegacyPattern(legacy)
    return charuco


def detector_of(board: Board) -> Detector:
    """That finds such boards."""
    detector = {"charuco": _Charuco, "chessboard": _Chessboard, "circles": _Circles}[board.kind](board)
    return _Inverted(detector) if board.inverted else detector


class _Inverted:
    """A board that is white on black, as one that is black on white."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector

    def find(self, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        return self._detector.find(~image)


class _Charuco:
    """Corners between the markers; parts of the board are enough."""

    def __init__(self, board: Board) -> None:
        import cv2

        self._n_points = board.n_points
        # Beyond it the markers begin.
        self._window = min(_WINDOW, (1 - board.marker_m / board.square_m) / 2)
        parameters = cv2.aruco.DetectorParameters()
        # Those of markers must be good enough to find the corners between them.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        parameters.minMarkerPerimeterRate = _LEAST_PERIMETER
        patterns = (False,) if board.size[1] % 2 else (False, True)
        self._detectors = [
            cv2.aruco.CharucoDetector(opencv_charuco(board, legacy=legacy), detectorParams=parameters)
            for legacy in patterns
        ]

    def find(self, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        for detector in self._detectors:
            points_px = self._found(detector, image)
            if points_px is not None:
                # OpenCV before 4.6 drew boards with an even number of rows otherwise: it is one or the other.
                self._detectors = [detector]
                return _refined(image, points_px, self._window)
        return None

    def _found(self, detector: cv2.aruco.CharucoDetector, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        """In the image, and where not all of the board is found, though a marker is, in an enlarged one: bits of two
        pixels are not read otherwise."""
        import cv2

        corners, ids, _, markers = detector.detectBoard(image)
        n_found, scale = (0 if ids is None else len(ids)), 1
        if markers is not None and n_found < self._n_points:
            larger = cv2.resize(image, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
            finer = detector.detectBoard(larger)
            if finer[1] is not None and len(finer[1]) > n_found:
                corners, ids, n_found, scale = finer[0], finer[1], len(finer[1]), _ENLARGED
        if n_found < MIN_POINTS:
            return None
        points_px = np.full((self._n_points, 2), np.nan)
        # The middle of the first pixel is at 0.
        points_px[np.ravel(ids).astype(int)] = (np.reshape(corners, (-1, 2)) + 0.5) / scale - 0.5
        return points_px


class _Chessboard:
    """All inner corners or none. The first one is told from the last by the colours of the squares."""

    def __init__(self, board: Board) -> None:
        self._size = board.size

    def find(self, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        import cv2

        # The sector-based detector takes 0.3 s for a large image, whether there is a board or not.
        shrunk = min(1.0, _MOST_SEARCHED_PX / max(image.shape))
        small = cv2.resize(image, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA) if shrunk < 1 else image
        found, corners = cv2.findChessboardCornersSB(small, self._size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return None
        # The middle of the first pixel is at 0.
        scale = np.array(image.shape[::-1]) / np.array(small.shape[::-1])
        points_px = (np.reshape(corners, (-1, 2)) + 0.5) * scale - 0.5
        return _refined(image, points_px, _WINDOW)


class _Circles:
    """All circles of a staggered grid or none."""

    def __init__(self, board: Board) -> None:
        import cv2

        self._size = board.size
        parameters = cv2.SimpleBlobDetector.Params()
        parameters.minArea, parameters.maxArea = _CIRCLE_AREA_PX2
        parameters.minDistBetweenBlobs = 5.0
        self._blobs = cv2.SimpleBlobDetector.create(parameters)

    def find(self, image: Grey) -> Float[np.ndarray, "point 2"] | None:
        import cv2

        flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
        found, centres = cv2.findCirclesGrid(image, self._size, flags=flags, blobDetector=self._blobs)
        return np.reshape(centres, (-1, 2)).astype(float) if found else None


def _refined(
    image: Grey, points_px: Float[np.ndarray, "point 2"], window: float
) -> Float[np.ndarray, "point 2"] | None:
    """None: too few of them are corners."""
    fine_px = saddle_points(image, points_px, window)
    return fine_px if np.isfinite(fine_px[:, 0]).sum() >= MIN_POINTS else None


def saddle_points(image: Grey, points_px: Float[np.ndarray, "point 2"], window: float) -> Float[np.ndarray, "point 2"]:
    """Corners where four squares meet, to a few hundredths of a pixel: the saddle of the quadric that fits the grey
    values around each, the nearest ones most (Lucchese and Mitra, Using saddle points for subpixel feature detection
    in camera calibration targets, 2002; the weights of Placht et al., ROCHADE, 2014).

    On rendered boards cv2.cornerSubPix, in whose windows edges far from a corner and markers count too, errs by three
    to seven times as much.

    Args:
        image: with the corners.
        points_px: where they are, to a pixel; NaN: not found.
        window: half its width, as a share of the distance to the next corner. It should hold nothing but the corner.

    Returns:
        NaN where there is no saddle within the window.
    """
    found = np.flatnonzero(np.isfinite(points_px).all(axis=1))
    half = _half_window_px(points_px[found], window, _LEAST_SADDLE_PX)
    y, x = (grid.ravel() for grid in np.mgrid[-half : half + 1, -half : half + 1].astype(float))
    weight = np.maximum(half + 1 - np.hypot(x, y), 0.0)
    quadric = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    fit = np.linalg.pinv(quadric * weight[:, None]) * weight
    grey, fine_px = image.astype(np.float32), np.full_like(points_px, np.nan)
    for i in found:
        saddle_px = _saddle_point(grey, points_px[i], fit, half)
        if saddle_px is not None:
            fine_px[i] = saddle_px
    return fine_px


def _saddle_point(
    grey: Float[np.ndarray, "height width"],
    start_px: Float[np.ndarray, " 2"],
    fit: Float[np.ndarray, "6 pixel"],
    half: int,
) -> Float[np.ndarray, " 2"] | None:
    """Of the quadric around where it is itself."""
    import cv2

    at = start_px.copy()
    for _ in range(_MAX_STEPS):
        window = cv2.getRectSubPix(grey, (2 * half + 1, 2 * half + 1), (float(at[0]), float(at[1])))
        xx, xy, yy, x, y, _ = fit @ window.ravel()
        determinant = 4 * xx * yy - xy**2
        if determinant >= 0:
            return None
        step = np.array([xy * y - 2 * yy * x, xy * x - 2 * xx * y]) / determinant
        at += step
        if np.linalg.norm(at - start_px) > half:
            return None
        if np.linalg.norm(step) < _STEP_PX:
            break
    return at


def blur_px(image: Grey, points_px: Float[np.ndarray, "point 2"]) -> float:
    """Width of the edges at the corners, the median over them: contrast over the steepest slope. 1 to 2 in a sharp
    image, whatever its light."""
    known_px = points_px[np.isfinite(points_px).all(axis=1)]
    height, width = image.shape
    half = _half_window_px(known_px, _WINDOW, _LEAST_WINDOW_PX)
    widths = []
    for x, y in np.rint(known_px).astype(int).tolist():
        if not (half < x < width - half - 1 and half < y < height - half - 1):
            continue
        window = image[y - half : y + half + 1, x - half : x + half + 1].astype(float)
        along = np.tensordot(_DIRECTIONS, np.array(np.gradient(window)), axes=1)
        slopes = np.abs(along).max(axis=(1, 2))
        # Of two edges that cross, motion along one blurs the other alone. Between both a sharp corner has cos 45°.
        slope = min(slopes.max(), np.sqrt(2) * slopes.min())
        widths.append(np.ptp(window) / slope if slope > 0 else np.inf)
    return float(np.median(widths)) if widths else np.inf


def _half_window_px(points_px: Float[np.ndarray, "point 2"], share: float, least_px: int) -> int:
    spacing_px = np.linalg.norm(points_px[:, None] - points_px, axis=-1)
    np.fill_diagonal(spacing_px, np.inf)
    return round(float(np.clip(share * np.median(spacing_px.min(axis=1)), least_px, _MOST_WINDOW_PX)))
