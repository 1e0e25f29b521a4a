"""What is wrong with a recording and its rig before anything is estimated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fgpose.association.chosen_person import with_unfollowed
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.intrinsics import is_of_another_size
from fgpose.observations import Observations
from fgpose.sampling import is_of_a_camera, other_unit, usual_step_s


def repaired(examined: Examined) -> list[Finding]:
    """What readers of files had to repair or to leave out."""
    return [
        Finding(Code.READ_WITH_REPAIRS, Severity.NOTE, remark, "Nothing is to be done if that is what you expect.", 0.0)
        for remark in examined.remarks
    ]


def unusual_steps(examined: Examined) -> list[Finding]:
    """Images that follow each other by more or less than those of any camera."""
    step_s = usual_step_s(examined.main.frame_time_s)
    if not np.isfinite(step_s) or is_of_a_camera(step_s):
        return []
    return [
        Finding(
            Code.FRAME_RATE,
            Severity.WRONG,
            f"The images follow each other by {step_s:.3g} s: no camera films like that",
            f"Times are in seconds: are these in {other_unit(step_s)}?",
            1.0,
            numbers={"step_s": step_s},
        )
    ]


def off_centre(examined: Examined) -> list[Finding]:
    """Principal points that are no lens's: not given, of images of another size, or of the whole of which these are a
    part. Where cameras agree, the images were cut and the calibration knows."""
    cameras = [camera for camera in examined.rig.cameras if is_of_another_size(camera)]
    if not cameras or examined.geometry.normal:
        return []
    first, names = cameras[0], ", ".join(camera.name for camera in cameras)
    return [
        Finding(
            Code.WRONG_LENS,
            Severity.WRONG,
            f"The principal point of {names} (cx = {first.K[0, 2]:.0f}, cy = {first.K[1, 2]:.0f}) is far from the "
            f"middle of its images of {first.size_px[0]}x{first.size_px[1]}",
            "Was it left out? Then give half the size of the images. Or is the calibration of images of another size, "
            "or of a part of them?",
            1.0,
            camera=first.name if len(cameras) == 1 else "",
        )
    ]


def causes_of_unfollowed(examined: Examined) -> list[Finding]:
    """What is wrong of cameras in which nobody is followed among several people, although they show somebody: what does
    not fit anybody belongs to nobody, and no other check sees it.

    It is the cause that makes cameras agree, with one of those whom each of those cameras sees most taken for the main
    person; none where there is no such cause: they may show somebody else.
    """
    found: list[Finding] = []
    for seen in _with_unfollowed(examined):
        with_them = Examined(examined.rig, {examined.main_person: seen}, examined.config)
        causes = disagreements(with_them) if with_them.geometry.explanation is not None else []
        if causes and not any(each.code is Code.OTHER_PERSON for each in causes):
            return causes
        found = found or causes
    return found


def _with_unfollowed(examined: Examined) -> Iterator[Observations]:
    association = examined.association
    if association is None:
        yield from () if examined.with_unfollowed is None else (examined.with_unfollowed,)
        return
    main = association.people[examined.main_person].in_frames(len(association.frames.image))
    for seen in with_unfollowed(association, main):
        yield association.observations.of_person(seen)
