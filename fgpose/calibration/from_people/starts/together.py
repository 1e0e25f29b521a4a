"""One walker on one clock: the detections of all cameras at the same times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.body_size import STANDING, steady_radius
from fgpose.calibration.from_people.starts.start_findings import in_words
from fgpose.calibration.from_people.starts.starts import Starts
from fgpose.calibration.from_people.walk import Track, Walk
from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.estimation.noise import TELLING_HZ
from fgpose.sampling import between_images, nearest, smaller_around, usual_step_s
from fgpose.skeleton import Skeleton

MAX_FRAMES = 1500
"""A minute: in half a minute a walker shows all that there is to see, but for where he does not come."""
_PART_S = 2.0  # of a long recording, parts are kept or left out


def together(tracks: Sequence[Track], starts: Starts, skeleton: Skeleton, max_frames: int = MAX_FRAMES) -> Walk:
    """The frames in which two cameras or more see the walker.

    The times are those of the reference camera's images, thinned to about 25 Hz, so that the images of synchronised
    cameras are taken as they are. The detections of the others are interpolated between two images, never across a
    gap. Of a recording of more than max_frames the parts are kept in which most cameras see most joints that move.

    Args:
        tracks: one of each camera of the starts, in their order.

    Returns:
        The cameras whose starts are trusted.

    Raises:
        ValueError: fewer than two starts are trusted, or no two cameras ever see the walker at the same time.
    """
    kept = [track for track, is_trusted in zip(tracks, starts.trusted, strict=True) if is_trusted]
    if len(kept) < 2:
        why = in_words(starts.findings)
        raise ValueError(f"the videos of fewer than two cameras can be brought together in time: {why}")
    time_s = _frame_times_s(kept, starts)
    at_s = [starts.own_s(track.camera, time_s) for track in kept]
    views = [seen_at(track, own_s) for track, own_s in zip(kept, at_s, strict=True)]
    points2d_px, confidence = (np.stack([view[part] for view in views], axis=1) for part in (0, 1))
    known = confidence > 0
    frames = _chosen(known, points2d_px, time_s, max_frames)
    if not frames.any():
        raise ValueError(
            f"no two cameras of {', '.join(track.camera for track in kept)} see the same person at the same time; "
            "walk where several cameras see you"
        )
    points3d_m = None
    if any(track.points3d_m is not None for track in kept):
        points3d_m = np.stack([view[2] for view in views], axis=1)[frames]
    names = tuple(track.camera for track in kept)
    return Walk(skeleton, names, time_s[frames], points2d_px[frames], confidence[frames], points3d_m)


def seen_at(
    track: Track, own_s: Float[np.ndarray, " frame"]
) -> tuple[Float[np.ndarray, "frame joint 2"], Float[np.ndarray, "frame joint"], Float[np.ndarray, "frame joint 3"]]:
    """Detections of a track at times by the clock of its camera: pixels and 3D, NaN = missing, and confidence."""
    points2d_px = between_images(track.time_s, track.points2d_px, own_s)
    confidence = smaller_around(track.time_s, track.confidence, own_s)
    known = np.isfinite(points2d_px).all(axis=-1) & (confidence > 0)
    if track.points3d_m is None:
        points3d_m = np.full((*known.shape, 3), np.nan)
    else:
        points3d_m = between_images(track.time_s, track.points3d_m, own_s)
    return np.where(known[..., None], points2d_px, np.nan), np.where(known, confidence, 0.0), points3d_m


def _frame_times_s(tracks: Sequence[Track], starts: Starts) -> Float[np.ndarray, " frame"]:
    """By the common clock, from when the second camera begins to show the walker until only one still does.

    Images of the reference camera, and where it has none, times as far apart as these.
    """
    common_s = [starts.common_s(track.camera, track.time_s) for track in tracks]
    begin_s, end_s = sorted(own_s[0] for own_s in common_s)[1], sorted(own_s[-1] for own_s in common_s)[-2]
    reference_s = next(s for track, s in zip(tracks, common_s, strict=True) if track.camera == starts.reference)
    usual_s = usual_step_s(reference_s)
    every = max(int(1 / (usual_s * TELLING_HZ) + 1e-3), 1)
    images_s, step_s = reference_s[::every], usual_s * every
    first, last = np.ceil((begin_s - images_s[0]) / step_s - 1e-6), np.floor((end_s - images_s[0]) / step_s + 1e-6)
    regular_s = images_s[0] + step_s * np.arange(first, last + 1)
    far = np.abs(regular_s - images_s[nearest(regular_s, images_s)]) > 0.6 * step_s
    time_s = np.sort(np.concatenate([images_s, regular_s[far]]))
    return time_s[(time_s >= begin_s - 1e-9) & (time_s <= end_s + 1e-9)]


def _chosen(
    known: Bool[np.ndarray, "frame camera joint"],
    points2d_px: Float[np.ndarray, "frame camera joint 2"],
    time_s: Float[np.ndarray, " frame"],
    max_frames: int,
) -> Bool[np.ndarray, " frame"]:
    """Frames that two cameras see; of many the parts that tell most."""
    seeing = known.sum(axis=-1) >= MIN_JOINTS
    chosen = seeing.sum(axis=1) >= 2
    if chosen.sum() <= max_frames:
        return chosen
    moves = np.stack([_moves(points2d_px[:, c], time_s) for c in range(known.shape[1])], axis=1)
    worth = np.where(chosen, np.sum(known.sum(axis=-1) * seeing * (STANDING + moves), axis=1), 0.0)
    part = np.floor((time_s - time_s[0]) / _PART_S).astype(int)
    frames_of, worth_of = np.bincount(part, chosen), np.bincount(part, worth)
    best = np.argsort(-worth_of / np.maximum(frames_of, 1), kind="stable")
    taken = best[np.cumsum(frames_of[best]) <= max_frames]
    return chosen & np.isin(part, taken)


def _moves(points2d_px: Float[np.ndarray, "frame joint 2"], time_s: Float[np.ndarray, " frame"]) -> np.ndarray:
    """Speed of the joint in the middle, in radii of the body per second, 1 at most; 0 where not known."""
    radius_px = steady_radius(time_s, points2d_px)
    speed_pxps = np.linalg.norm(np.gradient(points2d_px, time_s, axis=0), axis=-1)
    known = np.isfinite(speed_pxps)
    # The median of those that are known, without a warning where there are none.
    ordered = np.sort(np.where(known, speed_pxps, np.inf), axis=1)
    middle = np.take_along_axis(
        ordered, (np.maximum(known.sum(axis=1), 1) // 2)[:, None].clip(max=ordered.shape[1] - 1), axis=1
    )[:, 0]
    return np.where(known.any(axis=1), np.minimum(np.nan_to_num(middle / radius_px, posinf=0.0), 1.0), 0.0)
