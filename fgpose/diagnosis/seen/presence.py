"""Who is seen, and when: nobody, by one camera only, somebody else than before, or far from where others are."""

from __future__ import annotations

import warnings
from collections.abc import Collection

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.identity.likeness import RECOGNISED
from fgpose.association.successive import Replacement, successive
from fgpose.diagnosis.body.joint_names import in_words_by_part
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.consistency import consistency
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.changing_rig import of_whole_cameras
from fgpose.observations import Observations
from fgpose.sampling import stretches, usual_step_s

# Less is a detector that misses somebody in a few images.
_LEAST_S, _LEAST_SHARE = 1.0, 0.02
_FEWEST_JOINTS = 3  # fewer are no body
_AT_MOST = 4  # intervals that are listed
_SWITCHED_S = 0.2  # for less it is a detection that failed
# Higher, cameras are named that only have the person partly hidden; lower, some of little use are not.
_FEW_SEEN = 0.5
_AS_FEW = 0.75  # of what the others see: where all of them see as little, it is no camera's fault
_NOW_AND_THEN = 0.05  # who is shown less is outside of the view, or a reflection that others show

Interval = tuple[float, float]
_CUT = "With --people all each has a result of their own, with their own bone lengths; or cut the recording there."
# Of undamaged recordings, occluded or not, one frame in a hundred at most has a camera most of whose joints are so far
# from those of the others.
_FAR_M, _OFTEN_FAR = 0.3, 0.04
_LEAST_JOINTS = 4
_LEAVE_OUT = (
    "Is somebody else in its images then, a reflection, a picture? Detect everybody and use --people all, or leave "
    "such cameras out with --cameras."
)
_MISSED = "Does the detector miss the person now and then? A larger network, or boxes around people, may miss fewer."
_AS_WELL = 2.0  # times as far do the rays of some cameras pass each other as those of others


def nobody(examined: Examined) -> list[Finding]:
    """Stretches of time without anybody, and those that one camera sees alone."""
    time_s, n_cameras = cameras_with_somebody(examined)
    # Of one person, others may have been there.
    who = "The person is in no image" if examined.association is None else "Nobody is in any image"
    if examined.rig.n_cameras < 2:
        return _absent(time_s, n_cameras, who)
    return [*_absent(time_s, n_cameras, who), *_alone(time_s, n_cameras)]


def cameras_with_somebody(examined: Examined) -> tuple[Float[np.ndarray, " frame"], Int[np.ndarray, " frame"]]:
    """The time of each frame of the whole recording, and how many cameras see somebody then."""
    if examined.association is None:
        return examined.main.frame_time_s, _shows(examined.main.seen).sum(axis=1)
    time_s = examined.association.frames.frame_time_s
    shown = np.zeros((len(time_s), examined.rig.n_cameras), dtype=bool)
    for person, seen in examined.people.items():
        shown[examined.association.people[person].frames] |= _shows(seen.seen)
    return time_s, shown.sum(axis=1)


def _shows(seen: Bool[np.ndarray, "frame camera joint"]) -> Bool[np.ndarray, "frame camera"]:
    return np.asarray(seen.sum(axis=-1) >= min(_FEWEST_JOINTS, seen.shape[-1]))


def _absent(time_s: Float[np.ndarray, " frame"], n_cameras: Int[np.ndarray, " frame"], who: str) -> list[Finding]:
    intervals, share = _intervals(time_s, np.asarray(n_cameras == 0))
    if not intervals:
        return []
    return [
        Finding(
            Code.NOBODY,
            Severity.NOTE,
            f"{who} in {100 * share:.0f} % of the time: {_listed(intervals)}",
            "There are no results there. If that is not true, is the detector's threshold too high?",
            0.3 * share,
            from_s=intervals[0][0],
            to_s=intervals[-1][1],
            numbers={"share": share},
        )
    ]


def _alone(time_s: Float[np.ndarray, " frame"], n_cameras: Int[np.ndarray, " frame"]) -> list[Finding]:
    intervals, share = _intervals(time_s, np.asarray(n_cameras == 1))
    if not intervals:
        return []
    return [
        Finding(
            Code.FEW_CAMERAS,
            Severity.DOUBTFUL,
            f"One camera alone sees anybody in {100 * share:.0f} % of the time: {_listed(intervals)}",
            "How far away somebody is, one camera hardly tells. Did the others stop, or was the person outside?",
            0.5 * share,
            from_s=intervals[0][0],
            to_s=intervals[-1][1],
            numbers={"share": share},
        )
    ]


def _intervals(time_s: Float[np.ndarray, " frame"], chosen: Bool[np.ndarray, " frame"]) -> tuple[list[Interval], float]:
    """Those that are no single frames, which may have the image of one camera only whose others were lost, and their
    share of the recording; none if those of at least a second have a small one."""
    step_s = usual_step_s(time_s) if len(time_s) > 1 else 0.0
    found = [(float(time_s[a]), float(time_s[b - 1] + step_s)) for a, b in stretches(chosen)]
    found = [(begin_s, end_s) for begin_s, end_s in found if end_s - begin_s >= _SWITCHED_S]
    duration_s = max(float(time_s[-1] - time_s[0]) + step_s, 1e-9)
    lasting_s, total_s = (sum(b - a for a, b in found if b - a >= least_s) for least_s in (_LEAST_S, 0.0))
    return (found, total_s / duration_s) if lasting_s > _LEAST_SHARE * duration_s else ([], 0.0)


def _listed(intervals: list[Interval]) -> str:
    longest = sorted(sorted(intervals, key=lambda each: each[0] - each[1])[:_AT_MOST])
    more = len(intervals) - len(longest)
    listed = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in longest)
    return listed + (f" and {more} shorter one{'s' * (more > 1)}" if more else "")


def blind(examined: Examined) -> list[Finding]:
    """Cameras that see little in their images while somebody is there, and less than the others do; or that show people
    whom nobody else sees."""
    shares = of_whole_cameras(examined.rig.names, _shares_seen(examined).tolist())
    found = []
    for name, share in shares.items():
        others = [each for other, each in shares.items() if other != name and np.isfinite(each)]
        if share < min(_FEW_SEEN, _AS_FEW * float(np.median(others)) if others else np.inf):
            found.append(_blind(name, share, name in examined.unfollowed))
    return found


def _blind(name: str, share: float, is_unfollowed: bool) -> Finding:
    """Of a camera that sees so much; and whether its images show people, and mostly none who is followed."""
    reason, remedy = f"{name} sees only {100 * share:.0f} % of the joints", "is the person in them, and not hidden?"
    if is_unfollowed:
        reason += ", and most of its images show people whom other cameras do not see there"
        remedy = "do they show somebody else? If not, was it moved, is it late, or is its calibration another camera's?"
    return Finding(
        Code.BLIND_CAMERA,
        Severity.NOTE,
        reason,
        f"Look at its images: {remedy}",
        0.2 * (1 - share),
        camera=name,
        numbers={"share": share},
    )


def _shares_seen(examined: Examined) -> Float[np.ndarray, " camera"]:
    """Of the joints of those whom a camera shows now and then, or of everybody if it shows nobody, in the images that
    it has while they are there: cameras of other rates have images of other frames. NaN where it has none."""
    n_cameras, people = examined.rig.n_cameras, list(examined.sampled.items())
    seen, of_images = np.zeros((2, len(people), n_cameras))
    for k, (person, own) in enumerate(people):
        has_image = np.isfinite(np.broadcast_to(own.time_s.T, (n_cameras, own.n_frames)).T)
        has_image &= _is_there(examined.people[person], own.frame_time_s)[:, None]
        seen[k] = (own.seen & has_image[..., None]).sum(axis=(0, 2))
        of_images[k] = own.seen.shape[2] * has_image.sum(axis=0)
    shown = seen > _NOW_AND_THEN * of_images
    shown |= ~shown.any(axis=0)
    seen, of_images = np.where(shown, seen, 0).sum(axis=0), np.where(shown, of_images, 0).sum(axis=0)
    return np.divide(seen, of_images, out=np.full(n_cameras, np.nan), where=of_images > 0)


def _is_there(own: Observations, at_s: Float[np.ndarray, " time"]) -> Bool[np.ndarray, " time"]:
    """Whether any camera shows somebody at these times, or shortly before or after: a frame may have but one image, in
    which a camera misses them."""
    shown_s = own.frame_time_s[_shows(own.seen).any(axis=1)]
    if not len(shown_s):
        return np.zeros(len(at_s), dtype=bool)
    after = np.searchsorted(shown_s, at_s)
    around_s = shown_s[np.stack([np.maximum(after - 1, 0), np.minimum(after, len(shown_s) - 1)])]
    return np.asarray(np.abs(around_s - at_s).min(axis=0) < _LEAST_S / 2)


def never_seen(examined: Examined) -> list[Finding]:
    """Joints that two cameras never see at once."""
    seen, joints = examined.main, examined.info.never_seen
    points_m = np.full((1, 1, seen.skeleton.n_joints, 3), np.nan) if seen.points3d_m is None else seen.points3d_m
    in_3d = np.asarray(np.isfinite(points_m).any(axis=(0, 1, 3)))
    of_one_view = tuple(joint for joint in joints if in_3d[seen.skeleton.index(joint)])
    missing = tuple(joint for joint in joints if joint not in of_one_view)
    found = []
    if missing:
        remedy = "Add a camera that sees them, or use a skeleton without them."
        found.append(_never_seen(examined, missing, "so not estimated", remedy))
    if of_one_view and examined.rig.n_cameras > 1:  # of one camera few-cameras tells
        remedy = "How far away they are, one view hardly tells: add a camera that sees them."
        found.append(_never_seen(examined, of_one_view, "so estimated from the 3D of one view alone", remedy))
    return found


def _never_seen(examined: Examined, joints: tuple[str, ...], so: str, remedy: str) -> Finding:
    who = in_words_by_part(examined.main.skeleton, joints)
    return Finding(Code.NEVER_SEEN, Severity.NOTE, f"Never seen by two cameras at once, {so}: {who}", remedy, 0.1)


def somebody_else(examined: Examined) -> list[Finding]:
    """Where several were told apart, each has a result of their own, and nothing is wrong.

    With a calibration that does not fit nobody can be told from somebody else.
    """
    if examined.association is not None or examined.rig.n_cameras < 2 or examined.geometry.explanation is not None:
        return []
    found = successive(examined.main, examined.rig, examined.config.tracking)
    changes = [] if found is None else found.changes
    return [_comes_after(each) for each in changes if each.is_somebody_else or each.log_odds < RECOGNISED]


def _comes_after(change: Replacement) -> Finding:
    reason = str(change)
    return Finding(
        Code.SOMEBODY_ELSE,
        Severity.WRONG if change.is_somebody_else else Severity.DOUBTFUL,
        reason[0].upper() + reason[1:],
        _CUT,
        0.7,
        from_s=change.come_s,
        numbers={"away_m": change.away_m, "log_odds": change.log_odds},
    )


def identity_switches(examined: Examined) -> list[Finding]:
    """Views that leave the person for somebody else for some time."""
    time_s, found = examined.main.frame_time_s, []
    for c, name in enumerate(examined.rig.names):
        images = stretches(examined.gone_over[:, c])
        intervals = [(float(time_s[first]), float(time_s[end - 1])) for first, end in images]
        intervals = [(begin_s, end_s) for begin_s, end_s in intervals if end_s - begin_s >= _SWITCHED_S]
        if intervals:
            found.append(_goes_over(name, intervals))
    return found


def _goes_over(name: str, intervals: list[Interval]) -> Finding:
    return Finding(
        Code.IDENTITY_SWITCH,
        Severity.DOUBTFUL,
        f"{name} shows somebody else from {_listed(intervals)}: the whole body leaves the person there, whom other "
        "cameras see where they were going",
        "These detections are left out. Detect everybody and use --people all, or say who it is with --person-region.",
        0.5,
        camera=name,
        from_s=intervals[0][0],
        to_s=intervals[-1][1],
        numbers={"total_s": sum(end_s - begin_s for begin_s, end_s in intervals)},
    )


def seen_elsewhere(examined: Examined, explained: Collection[str]) -> list[Finding]:
    """Somebody else, a reflection, a picture: in some images, where cameras agree in others. Of those in which a view
    has gone over to somebody else identity_switches tells.

    Args:
        examined: whose cameras agree as a rule.
        explained: cameras of which it is known already why they see people elsewhere.
    """
    geometry, names = examined.geometry, examined.rig.names
    found = geometry.state.consistency
    if geometry.explanation is not None or geometry.odd or geometry.wrong or len(names) < 3:
        return []
    of_body_m = _median(found.distance_m, found.judged)
    at_s, switched_s = geometry.state.scene.time_s, examined.main.frame_time_s[examined.gone_over.any(axis=1)]
    judged = (found.judged.sum(axis=1) >= _LEAST_JOINTS) & ~np.isin(at_s, switched_s)[:, None]
    far = judged & (of_body_m > _FAR_M)
    often = far.sum(axis=0) > _OFTEN_FAR * np.maximum(judged.sum(axis=0), 1)
    cameras = [c for c in np.flatnonzero(often).tolist() if names[c] not in explained]
    if not cameras:
        return []
    of_chosen = far[:, cameras].any(axis=1)
    untold = _untold(geometry.state.scene, found.distance_m, far, judged)
    when, share, share_untold = at_s[of_chosen], float(of_chosen.mean()), float(np.mean(of_chosen & untold))
    severity, see, believed, remedy = _who_is_believed(cameras, share_untold)
    return [
        Finding(
            Code.DISAGREEING_CAMERA,
            severity,
            f"{', '.join(names[c] for c in cameras)} {see} a body {_FAR_M:.1f} m or more from where others see it in "
            f"{100 * share:.0f} % of the images{believed}",
            remedy,
            0.8,
            camera=names[cameras[0]] if len(cameras) == 1 else "",
            from_s=float(when[0]),
            to_s=float(when[-1]),
            numbers={"share": share, "share_untold": share_untold},
        )
    ]


def _median(
    distance_m: Float[np.ndarray, "frame joint camera"], judged: Bool[np.ndarray, "frame joint camera"]
) -> Float[np.ndarray, "frame camera"]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of images without anybody: NaN
        return np.nanmedian(np.where(judged, distance_m, np.nan), axis=1)


def _who_is_believed(cameras: list[int], share_untold: float) -> tuple[Severity, str, str, str]:
    """What to say of cameras that see people elsewhere, and to do, by in how many images it is not told which of them
    are right."""
    see = "see" if len(cameras) > 1 else "sees"
    if share_untold > _OFTEN_FAR:
        return Severity.WRONG, see, ": which of them is right is not told, and what comes out is wrong then", _LEAVE_OUT
    if len(cameras) == 1:
        return Severity.DOUBTFUL, see, ": the others outvote it", _LEAVE_OUT
    # Who is seen elsewhere by all cameras, each at its own times, is missed by the detector.
    return Severity.NOTE, see, ", each at its own times: the others outvote it", _MISSED


def _untold(
    scene: SynchronousViews,
    distance_m: Float[np.ndarray, "frame joint camera"],
    far: Bool[np.ndarray, "frame camera"],
    judged: Bool[np.ndarray, "frame camera"],
) -> Bool[np.ndarray, " frame"]:
    """In which images those that see a body elsewhere may be right: as many as the others see it there, or two agree on
    another place as well as the others do on theirs. What a detector misses, it misses elsewhere in each view."""
    near, untold = judged & ~far, np.zeros(len(far), dtype=bool)
    some = np.flatnonzero(far.any(axis=1) & (far.sum(axis=1) >= near.sum(axis=1)))
    untold[some] = near[some].sum(axis=1) < 2
    for frame in some[~untold[some]].tolist():
        own, others = np.flatnonzero(far[frame]).tolist(), distance_m[frame][:, near[frame]]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of joints that they do not see
            there = consistency(scene.frames(np.array([frame])).cameras(own))
        untold[frame] = there.median_m < _AS_WELL * np.median(others[np.isfinite(others)])
    return untold
