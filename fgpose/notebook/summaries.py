"""The summary of each kind of thing that shows itself."""

from __future__ import annotations

from dataclasses import is_dataclass
from functools import partial, singledispatch

import numpy as np
from jaxtyping import Float

from fgpose.assessment.evaluation import Evaluation
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.estimation.estimator import Estimator
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.kinematics.quantities import Quantities
from fgpose.notebook.by_fields import by_fields
from fgpose.notebook.picture import strip, views, views_of_people
from fgpose.notebook.rig_picture import from_above
from fgpose.notebook.summary import Summary, counted, listed, percent
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.sampling import frames_per_second
from fgpose.skeleton import Skeleton
from fgpose.tracking.batch import SmoothedPeople
from fgpose.tracking.online import Tracker
from fgpose.trajectory import Estimate, Status, Trajectory

_DIGITS = {"angle": 1, "speed": 2}  # by the kind of quantity


@singledispatch
def summary(shown: object) -> Summary:
    """Of a thing that shows itself: what is said of its kind here, else by its fields."""
    if not is_dataclass(shown):
        raise TypeError(f"{type(shown).__name__} does not show itself")
    return by_fields(shown, summary)


@summary.register
def _(trajectory: Trajectory) -> Summary:
    shares = {status: trajectory.status_share(status) for status in reversed(Status)} if trajectory.n_frames else {}
    facts = {"": ", ".join(f"{percent(share)} {status.name.lower()}" for status, share in shares.items() if share > 0)}
    facts["sigma"] = _median(_sigmas_mm(trajectory), "mm")
    facts["reprojection error"] = _median(trajectory.residual_px, "px")
    facts["cameras"] = listed(trajectory.camera_names)
    if trajectory.convergence is not None:
        ended = "converged" if trajectory.convergence.converged else "not converged"
        facts["optimiser"] = f"{ended} after {counted(trajectory.convergence.iterations, 'iteration')}"
    if trajectory.implausible_frames:
        facts["left out"] = counted(len(trajectory.implausible_frames), "implausible frame")
    title = f"Trajectory: {_span(trajectory.time_s)}, {_skeleton(trajectory)}"
    return Summary(title, _known(facts), picture=partial(strip, trajectory))


@summary.register
def _(estimate: Estimate) -> Summary:
    observed = percent(float(np.mean(estimate.status == Status.OBSERVED)))
    sigma_mm = None if estimate.covariance_m2 is None else _sigma_mm(estimate.covariance_m2)
    lagged = "" if estimate.smoothed is None else f"of {estimate.smoothed.time_s:.3f} s"
    facts = {"": f"{observed} observed", "sigma": _median(sigma_mm, "mm"), "smoothed": lagged}
    title = f"Estimate: frame {estimate.frame} at {estimate.time_s:.3f} s, {_skeleton(estimate)}"
    return Summary(title, _known(facts))


@summary.register
def _(observations: Observations) -> Summary:
    seen = observations.seen
    n_views = seen.sum(axis=1).mean()
    facts = {
        "": f"{percent(float(seen.mean()))} of the joints detected, by {n_views:.1f} cameras on average",
        "confidence": _median(np.where(seen, observations.confidence, np.nan), ""),
        "per-view 3D": "" if observations.points3d_m is None else "yes",
        "clocks": "one for each camera" if observations.time_s.ndim == 2 else "",
        "remarks": str(len(observations.remarks) or ""),
    }
    rows = []
    for camera, name in enumerate(observations.camera_names):
        confidence = observations.confidence[:, camera][seen[:, camera]]
        frames = percent(float(seen[:, camera].any(axis=1).mean()))
        cells = frames, percent(float(seen[:, camera].mean())), _median(confidence, "")
        rows.append((name, *cells))
    title = f"Observations: {_span(observations.frame_time_s)}, {counted(observations.n_cameras, 'camera')}"
    columns = ("camera", "frames", "joints", "confidence")
    return Summary(f"{title}, {_skeleton(observations)}", _known(facts), columns, rows, partial(views, observations))


@summary.register
def _(observations: PeopleObservations) -> Summary:
    n_people = [image.n_people for image in observations.images]
    most, mean = max(n_people, default=0), float(np.mean(n_people)) if n_people else 0.0
    rows = []
    for name, images in observations.by_camera.items():
        own = [image.n_people for image in images]
        rows.append((name, f"{len(own):,}", str(max(own, default=0)), f"{np.mean(own):.2f}" if own else "-"))
    facts = {
        "": f"{mean:.1f} people in an image on average, {most} at most",
        "cameras": listed(observations.camera_names),
        "remarks": str(len(observations.remarks) or ""),
    }
    title = f"PeopleObservations: {_span(observations.frame_time_s)}, {counted(len(n_people), 'image')}"
    columns = ("camera", "images", "most people", "mean")
    picture = partial(views_of_people, observations)
    return Summary(f"{title}, {_skeleton(observations)}", _known(facts), columns, rows, picture)


@summary.register
def _(rig: CameraRig) -> Summary:
    rows = []
    for camera, focal_px in zip(rig.cameras, rig.focal_px.tolist(), strict=True):
        place = ", ".join(f"{axis:.2f}" for axis in camera.position_m.tolist())
        size = "{} x {}".format(*camera.size_px)
        rows.append((camera.name, size, f"{focal_px:.0f}", place, camera.lens, f"{1000 * camera.time_offset_s:.1f}"))
    focal_px, late_ms = rig.focal_px, 1000 * rig.time_offsets_s
    apart_m = np.linalg.norm(rig.positions_m[:, None] - rig.positions_m, axis=-1).max()
    facts = {
        "": listed(rig.names),
        "focal lengths": f"{focal_px.min():.0f} to {focal_px.max():.0f} px",
        "farthest apart": f"{apart_m:.2f} m",
        "time offsets": f"{late_ms.min():.1f} to {late_ms.max():.1f} ms" if late_ms.any() else "",
    }
    columns = ("camera", "size [px]", "focal length [px]", "position [m]", "lens", "time offset [ms]")
    title = f"CameraRig: {counted(rig.n_cameras, 'camera')}"
    return Summary(title, _known(facts), columns, rows, partial(from_above, rig))


@summary.register
def _(camera: Camera) -> Summary:
    (fx, fy), (cx, cy) = camera.K[[0, 1], [0, 1]].tolist(), camera.K[:2, 2].tolist()
    facts = {
        "focal length": f"{fx:.1f}, {fy:.1f} px",
        "principal point": f"{cx:.1f}, {cy:.1f} px",
        "distortion": ", ".join(f"{each:.3g}" for each in camera.distortion.tolist()),
        "position": ", ".join(f"{axis:.2f}" for axis in camera.position_m.tolist()) + " m",
        "looks along": ", ".join(f"{axis:.2f}" for axis in camera.world_T_camera[:3, 2].tolist()),
        "time offset": f"{1000 * camera.time_offset_s:.1f} ms" if camera.time_offset_s else "",
        "clock drift": f"{1000 * camera.clock_drift:.3g} ms/s" if camera.clock_drift else "",
        "moved": counted(len(camera.moves), "time") if camera.moves else "",
        "clock jumps": str(len(camera.clock_jumps) or ""),
    }
    size = "{} x {} px".format(*camera.size_px)
    return Summary(f"Camera: {camera.name}, {size}, {camera.lens}", _known(facts))


@summary.register
def _(skeleton: Skeleton) -> Summary:
    rows = [(str(number), joint) for number, joint in enumerate(skeleton.joints)]
    facts = {
        "": listed(skeleton.joints),
        "root": " and ".join(skeleton.joints[joint] for joint in skeleton.root),
        "parts": ", ".join(f"{part.name} ({counted(len(part.joints), 'joint')})" for part in skeleton.parts),
    }
    what = f"{counted(skeleton.n_joints, 'joint')}, {counted(len(skeleton.bones), 'bone')}"
    return Summary(f"Skeleton: {skeleton.name}, {what}", _known(facts), ("number", "joint"), rows)


@summary.register
def _(quantities: Quantities) -> Summary:
    value, kind, sigma = quantities.value, quantities.kind, quantities.sigma
    rows, quantiles = [], quantities.quantiles((0.0, 0.5, 1.0))
    for index, name in enumerate(quantities.names):
        cells = [f"{each:.{_DIGITS[kind]}f}" if np.isfinite(each) else "-" for each in quantiles[:, index]]
        share = float(np.isfinite(value[:, index]).sum()) / max(len(value), 1)
        errors = () if sigma is None else (_median(sigma[:, index], "") or "-",)
        rows.append((name, *cells, *errors, percent(share)))
    facts = {
        "": listed(quantities.names),
        "known": percent(float(np.isfinite(value).mean())) if value.size else "",
        "sigma": _median(sigma, quantities.unit),
    }
    title = f"{type(quantities).__name__}: {_span(quantities.time_s)}, {counted(len(quantities.names), kind)}"
    errors = () if sigma is None else ("sigma",)
    columns = (f"{kind} [{quantities.unit}]", "min", "median", "max", *errors, "known")
    return Summary(title, _known(facts), columns, rows)


@summary.register
def _(evaluation: Evaluation) -> Summary:
    coverage = "" if evaluation.coverage_95 is None else percent(evaluation.coverage_95)
    nees = "" if evaluation.nees is None else f"{evaluation.nees:.1f} (3: the covariance is right)"
    facts = {
        "MPJPE": _number(evaluation.mpjpe_absolute_mm, "mm"),
        "relative to the root": _number(evaluation.mpjpe_relative_mm, "mm"),
        "after Procrustes alignment": _number(evaluation.pa_mpjpe_mm, "mm"),
        "within 150 mm": percent(evaluation.pck) if np.isfinite(evaluation.pck) else "",
        "acceleration error": _number(evaluation.acceleration_error_mps2, "m/s²"),
        "missing": percent(evaluation.share_missing),
        "in the 95 % ellipsoids": coverage,
        "NEES": nees,
    }
    rows = [
        (joint.joint, f"{joint.mpjpe_absolute_mm:.1f}", f"{joint.mpjpe_relative_mm:.1f}", percent(joint.share_missing))
        for joint in evaluation.joints
    ]
    title = f"Evaluation: {counted(evaluation.n_joints, 'joint')} in {counted(evaluation.n_frames, 'frame')}"
    return Summary(title, _known(facts), ("joint", "MPJPE [mm]", "relative [mm]", "missing"), rows)


@summary.register
def _(people: SmoothedPeople) -> Summary:
    rows = []
    for person, each in people.trajectories.items():
        observed = percent(each.status_share(Status.OBSERVED)) if each.n_frames else "-"
        rows.append((str(person), *_begin_and_end(each.time_s), f"{each.n_frames:,}", observed))
    observations = people.association.observations
    title = (
        f"SmoothedPeople: {len(rows)} {'person' if len(rows) == 1 else 'people'}, {_span(observations.frame_time_s)}"
    )
    facts = {
        "": listed([f"{person}: {begin} to {end} s" for person, begin, end, *_ in rows]),
        "detections of nobody": f"{people.association.n_unused:,}",
        "events": f"{len(people.association.events):,}",
    }
    return Summary(title, _known(facts), ("person", "from [s]", "to [s]", "frames", "observed"), rows)


@summary.register
def _(detections: Detections) -> Summary:
    n_people, n_joints = detections.confidence.shape
    who = f"{n_people} {'person' if n_people == 1 else 'people'}, {counted(n_joints, 'joint')}"
    seen = detections.confidence > 0
    facts = {
        "": f"{percent(float(seen.mean()))} of the joints detected" if seen.size else "nobody is detected",
        "confidence": _median(detections.confidence[seen], ""),
        "per-view 3D": "" if detections.points3d_m is None else "yes",
        "appearance": "" if detections.appearance is None else f"{detections.appearance.shape[1]} numbers of each",
    }
    return Summary(f"Detections: {detections.camera} at {detections.time_s:.3f} s, {who}", _known(facts))


@summary.register
def _(diagnosis: Diagnosis) -> Summary:
    found = [f"{each.subject} {each.code}".strip() for each in diagnosis.findings]
    worst = f", the worst is {diagnosis.worst}" if diagnosis.worst else ""
    facts = {
        "": listed(found) or "nothing seems wrong",
        "judged": counted(len(diagnosis.judged), "cause"),
        "not judged": listed(list(diagnosis.not_judged)),
    }
    rows = [(each.severity, each.subject, each.code, each.reason, each.remedy) for each in diagnosis.findings]
    columns = ("", "of", "finding", "why", "remedy")
    return Summary(f"Diagnosis: {counted(len(found), 'finding')}{worst}", _known(facts), columns, rows)


@summary.register
def _(config: Config) -> Summary:
    default, facts = Config(), dict[str, str]()
    for name, section in vars(config).items():
        for key, own in vars(section).items():
            usual = getattr(getattr(default, name), key)
            if own != usual:
                facts[f"{name}.{key}"] = f"{own} ({usual} by default)"
    differ = f"{counted(len(facts), 'parameter')} not as by default" if facts else "all parameters as by default"
    return Summary(f"Config: {differ}", facts or {"": f"sections {', '.join(vars(config))}"})


@summary.register
def _(estimator: Estimator) -> Summary:
    newest = estimator.newest
    facts = {
        "newest": "no frame yet" if newest is None else f"frame {newest.frame} at {newest.time_s:.3f} s",
        **_online(estimator.config),
        "implausible": counted(estimator.n_implausible, "frame") if estimator.n_implausible else "",
    }
    return Summary(f"Estimator: {counted(estimator.rig.n_cameras, 'camera')}, {_skeleton(estimator)}", _known(facts))


@summary.register
def _(tracker: Tracker) -> Summary:
    facts = {
        **_online(tracker.config),
        "restarted processes": f"{tracker.n_restarts:,}" if tracker.n_restarts else "",
        "cameras left out": listed(sorted(tracker.set_clocks)),
    }
    return Summary(f"Tracker: {counted(tracker.rig.n_cameras, 'camera')}, {_skeleton(tracker)}", _known(facts))


def _online(config: Config) -> dict[str, str]:
    return {"solver": config.online.solver, "lag": f"{config.online.lag_s:g} s"}


def _known(facts: dict[str, str]) -> dict[str, str]:
    return {name: fact for name, fact in facts.items() if fact}


def _span(time_s: Float[np.ndarray, " frame"]) -> str:
    """How many frames, when, and how many a second."""
    if not len(time_s):
        return "no frame"
    begin, end = _begin_and_end(time_s)
    rate = f" ({frames_per_second(time_s):.4g} Hz)" if len(time_s) > 1 else ""
    return f"{counted(len(time_s), 'frame')}, {begin} to {end} s{rate}"


def _begin_and_end(time_s: Float[np.ndarray, " frame"]) -> tuple[str, str]:
    return (f"{time_s[0]:.2f}", f"{time_s[-1]:.2f}") if len(time_s) else ("-", "-")


def _skeleton(thing: Trajectory | Estimate | Observations | PeopleObservations | Estimator | Tracker) -> str:
    return f"{counted(thing.skeleton.n_joints, 'joint')} ({thing.skeleton.name})"


def _sigmas_mm(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"] | None:
    return None if trajectory.covariance_m2 is None else _sigma_mm(trajectory.covariance_m2)


def _sigma_mm(covariance_m2: Float[np.ndarray, "*points 3 3"]) -> Float[np.ndarray, "*points"]:
    """Root mean square of the standard deviations along the axes."""
    return 1000 * np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3)


def _median(values: np.ndarray | None, unit: str) -> str:
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    return f"{np.median(known):.3g} {unit}".strip() + (" (median)" if unit else "") if len(known) else ""


def _number(value: float, unit: str) -> str:
    return f"{value:.1f} {unit}" if np.isfinite(value) else ""
