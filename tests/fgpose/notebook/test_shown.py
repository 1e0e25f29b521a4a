"""What is seen of things in a notebook: short texts, HTML that is well-formed, pictures of what is there."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest

import fgpose
from fgpose import calibration
from fgpose.notebook.picture import strip, views, views_of_people
from fgpose.notebook.rig_picture import from_above
from fgpose.shown import Shown
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic.boards import simulate_boards


@cache
def recording() -> tuple[fgpose.CameraRig, fgpose.Observations]:
    rig, observations = fgpose.files.load_recording("balance_openpose")
    return rig, observations.frames(slice(0, 12))


@cache
def smoothed() -> Trajectory:
    rig, observations = recording()
    return fgpose.smooth(observations, rig)


@cache
def things() -> dict[str, Any]:
    (rig, observations), trajectory = recording(), smoothed()
    people = fgpose.people.PeopleObservations.of_one(observations)
    return {
        "CameraRig": rig,
        "Camera": rig["cam_01"],
        "Skeleton": fgpose.load_skeleton("coco_wholebody_133"),
        "Observations": observations,
        "PeopleObservations": people,
        "Trajectory": trajectory,
        "JointAngles": fgpose.joint_angles(trajectory),
        "JointSpeeds": fgpose.kinematics.joint_speeds(trajectory),
        "Evaluation": fgpose.evaluate(trajectory, fgpose.refine(observations, rig)),
        "SmoothedPeople": fgpose.smooth_people(people, rig),
        "Estimate": fgpose.Estimator(rig, observations.skeleton).update(observations.frames(slice(0, 1))),
        **results(),
    }


def results() -> dict[str, Any]:
    """What has no summary of its own kind, and what works on a recording."""
    (rig, observations), trajectory = recording(), smoothed()
    people = fgpose.people.PeopleObservations.of_one(observations)
    sightings = simulate_boards(2, 1, n_common=6, n_near=3).sightings
    calibrated = calibration.self_calibrate(observations, rig)
    estimator = fgpose.Estimator(rig, observations.skeleton)
    estimator.update(observations.frames(slice(0, 1)))
    return {
        "Fusion": fgpose.fuse(observations, rig),
        "BoneLengths": trajectory.bones,
        "RigRefinement": calibrated.refinement,
        "TimeOffsets": calibrated.time_offsets,
        "SelfCalibration": calibrated,
        "BumpedRig": calibration.refine_bumped(observations, rig),
        "BoardSightings": sightings,
        "CalibratedFromBoards": calibration.calibrate_from_boards(sightings),
        "Association": fgpose.smooth_people(people, rig).association,
        "PeopleEvaluation": fgpose.people.evaluate_people({1: trajectory}, {0: trajectory}),
        "Detections": people.images[0],
        "Diagnosis": fgpose.diagnosis.diagnose(observations, rig, trajectory),
        "Config": fgpose.Config(motion={"model": "random_walk"}),
        "Estimator": estimator,
        "Tracker": fgpose.Tracker(rig, observations.skeleton, fgpose.Config(tracking={"max_processes": 1})),
    }


def parsed(html: str) -> ET.Element:
    """Raises ParseError where a tag is not closed or a name is not escaped."""
    return ET.fromstring(html)


KINDS = pytest.mark.parametrize(
    "kind",
    [
        "CameraRig",
        "Camera",
        "Skeleton",
        "Observations",
        "PeopleObservations",
        "Trajectory",
        "JointAngles",
        "JointSpeeds",
        "Evaluation",
        "SmoothedPeople",
        "Estimate",
        "Fusion",
        "BoneLengths",
        "RigRefinement",
        "TimeOffsets",
        "SelfCalibration",
        "BumpedRig",
        "BoardSightings",
        "CalibratedFromBoards",
        "Association",
        "PeopleEvaluation",
        "Detections",
        "Diagnosis",
        "Config",
        "Estimator",
        "Tracker",
    ],
)


@KINDS
def test_a_thing_shows_itself_in_three_lines(kind: str) -> None:
    thing = things()[kind]
    lines = repr(thing).splitlines()
    assert isinstance(thing, Shown)
    assert lines[0].startswith(f"{kind}: ")
    assert 2 <= len(lines) <= 3
    assert max(map(len, lines)) <= 120
    assert "array(" not in repr(thing)


@KINDS
def test_its_html_is_well_formed_and_says_the_same(kind: str) -> None:
    thing = things()[kind]
    page = parsed(thing._repr_html_())
    texts = " ".join(page.itertext())
    assert repr(thing).splitlines()[0] in texts
    assert page.find(".//table") is not None


def test_no_public_name_shows_its_arrays() -> None:
    modules = (fgpose, calibration, fgpose.diagnosis, fgpose.kinematics, fgpose.people, fgpose.files)
    kinds = {getattr(module, name) for module in modules for name in module.__all__}
    with_arrays = [
        kind for kind in kinds if is_dataclass(kind) and any("np.ndarray" in str(field.type) for field in fields(kind))
    ]
    assert len(with_arrays) > 20
    assert [kind for kind in with_arrays if not issubclass(cast(type, kind), Shown)] == []


def test_a_config_says_what_is_not_as_by_default() -> None:
    assert repr(fgpose.Config()).startswith("Config: all parameters as by default\n")
    changed = fgpose.Config(motion={"model": "random_walk"}, online={"lag_s": 0.5 + fgpose.Config().online.lag_s})
    assert repr(changed) == (
        "Config: 2 parameters not as by default\n"
        "  motion.model random_walk (constant_velocity by default); online.lag_s 1.0 (0.5 by default)"
    )


def test_a_result_shows_verdict_ranges_and_a_table_by_camera() -> None:
    """The numbers are those of the fields, with the digits that the largest has."""
    bumped = things()["BumpedRig"]
    angles = bumped.rotation_deg
    assert repr(bumped).startswith(f"BumpedRig: {bumped.grade.value}, 4 cameras\n")
    assert f"rotation {angles.min():.3f} to {angles.max():.3f} deg" in repr(bumped).replace("\n ", "")
    table = parsed(bumped._repr_html_()).findall(".//table")[-1]
    head = [cell.text for cell in table.findall("./thead/tr/th")]
    first = [cell.text for cell in table.findall("./tbody/tr")[0]]
    assert first[0] == "cam_01"
    assert first[head.index("rotation [deg]")] == f"{angles[0]:.3f}"
    assert first[head.index("moved")] == ("yes" if bumped.moved[0] else "no")


def test_the_facts_are_those_of_the_thing() -> None:
    trajectory = smoothed()
    assert trajectory.covariance_m2 is not None
    assert repr(trajectory).startswith("Trajectory: 12 frames, 0.00 to 0.18 s (60 Hz), 25 joints (body_25b)\n")
    sigma_mm = 1000 * np.sqrt(np.trace(trajectory.covariance_m2, axis1=2, axis2=3) / 3)
    assert f"sigma {np.nanmedian(sigma_mm):.3g} mm" in repr(trajectory)
    assert "cam_01, cam_02" in repr(trajectory).replace("\n ", "")
    assert "12.00" not in repr(recording()[0])
    assert "4 cameras" in repr(recording()[0])
    assert repr(recording()[0]["cam_01"]).startswith("Camera: cam_01, 1088 x 1920 px, pinhole\n  focal length 1681.2,")
    assert repr(trajectory.skeleton).startswith("Skeleton: body_25b, 25 joints, 24 bones\n  nose, left_eye, ")


def test_long_lists_and_empty_things_have_three_lines_too() -> None:
    trajectory = smoothed()
    many = tuple(f"camera_{n}" for n in range(40))
    crowded = replace(trajectory, camera_names=many, residual_px=None, visibility=None)
    assert len(repr(crowded).splitlines()) == 3
    assert "34 more" in repr(crowded)
    nothing = trajectory[:0]
    assert repr(nothing).startswith("Trajectory: no frame, 25 joints")
    parsed(nothing._repr_html_())
    unknown = replace(
        trajectory,
        positions_m=np.full(trajectory.positions_m.shape, np.nan),
        status=np.full(trajectory.status.shape, Status.UNOBSERVABLE),
        covariance_m2=None,
    )
    assert "100 % unobservable" in repr(unknown)
    assert strip(unknown) == ""


def test_names_are_escaped() -> None:
    rig, _ = recording()
    evil = "<script>alert(1)</script>"
    named = fgpose.CameraRig((replace(rig.cameras[0], name=evil), *rig.cameras[1:]))
    assert "<script" not in named._repr_html_()
    assert evil in " ".join(parsed(named._repr_html_()).itertext())


def test_shares_that_are_not_whole_are_not_rounded_to_it() -> None:
    trajectory = smoothed()
    status = np.full((12, 25), Status.OBSERVED)
    status[0, 0] = Status.PREDICTED  # 1 of 300
    assert "> 99 % observed, < 1 % predicted" in repr(replace(trajectory, status=status))


def test_the_picture_shows_poses_upright_with_left_and_right() -> None:
    """A stick figure, 1.8 m high and 1 m wide, in a world with y down: the head is on top, both sides are coloured, and
    lengths have one scale."""
    joints = ("pelvis", "head", "left_shoulder", "right_shoulder", "left_hip", "right_hip", "left_ankle", "right_ankle")
    bones = [("pelvis", "head"), ("left_hip", "left_ankle"), ("right_hip", "right_ankle")]
    sides = [(f"left_{part}", f"right_{part}") for part in ("shoulder", "hip", "ankle")]
    skeleton = Skeleton("stick", joints, bones, "pelvis", sides)
    across_m = np.array([0.0, 0.0, 0.5, -0.5, 0.1, -0.1, 0.1, -0.1])
    height_m = np.array([1.0, 1.8, 1.5, 1.5, 1.0, 1.0, 0.0, 0.0])
    pose_m = np.stack([across_m, -height_m, np.full(8, 3.0)], axis=1)
    positions_m = np.repeat(pose_m[None], 50, axis=0)
    trajectory = Trajectory(skeleton, np.arange(50) / 50, positions_m, np.full((50, 8), Status.OBSERVED))
    circles = parsed(strip(trajectory)).findall("{*}circle")
    assert len(circles) == 5 * 8
    x_px, y_px = (np.array([float(circle.attrib[axis]) for circle in circles]).reshape(5, 8) for axis in ("cx", "cy"))
    assert (y_px.argmin(axis=1) == 1).all()
    np.testing.assert_allclose(np.ptp(x_px, axis=1) / np.ptp(y_px, axis=1), 1 / 1.8, atol=0.01)  # rounded to 0.1 px
    # Side by side, none over another.
    assert (x_px.min(axis=1)[1:] > x_px.max(axis=1)[:-1]).all()
    colours = [circle.attrib["fill"] for circle in circles[:8]]
    assert colours[2] == colours[4] == colours[6] != colours[3] == colours[5] == colours[7]


def test_observations_show_the_keypoints_of_each_image() -> None:
    """In the frame in which most are seen, each image to its own scale: ratios are those of the pixels."""
    _, observations = recording()
    frame = int(observations.seen.sum(axis=(1, 2)).argmax())
    drawing = parsed(views(observations))
    assert [text.text for text in drawing.findall("{*}text")] == list(observations.camera_names)
    circles = [[float(each.attrib[axis]) for axis in ("cx", "cy")] for each in drawing.findall("{*}circle")]
    counts = observations.seen[frame].sum(axis=1)
    for camera, drawn_px in enumerate(np.split(np.array(circles), np.cumsum(counts)[:-1])):
        points_px = observations.points2d_px[frame, camera][observations.seen[frame, camera]]
        scale = np.ptp(drawn_px[:, 1]) / np.ptp(points_px[:, 1])
        expected_px = (points_px - points_px[0]) * scale
        np.testing.assert_allclose(drawn_px - drawn_px[0], expected_px, atol=0.2)  # both rounded to 0.1 px
    people = fgpose.people.PeopleObservations.of_one(observations)
    assert views_of_people(people).count("<circle") == len(circles)
    nothing = replace(observations, points2d_px=np.full_like(observations.points2d_px, np.nan),
                      confidence=np.zeros_like(observations.confidence))  # fmt: skip
    assert views(nothing) == ""
    parsed(nothing._repr_html_())


def test_a_rig_shows_its_cameras_from_above() -> None:
    """Dots lie as places do, at the scale of the line; fields of view open towards what all look at."""
    rig, _ = recording()
    drawing = parsed(from_above(rig))
    dots_px = np.array([[float(each.attrib[axis]) for axis in ("cx", "cy")] for each in drawing.findall("{*}circle")])
    *views_of, line = [each.attrib["d"] for each in drawing.findall("{*}path")]
    *names, length = [text.text for text in drawing.findall("{*}text")]
    assert names == list(rig.names)
    px_per_m = float(line.partition("h")[2]) / float(str(length).removesuffix(" m"))
    places_m = rig.positions_m[:, :2] * (1, -1)  # its world has z up
    np.testing.assert_allclose(dots_px - dots_px[0], (places_m - places_m[0]) * px_per_m, atol=0.3)
    for view, dot_px, camera in zip(views_of, dots_px, rig.cameras, strict=True):
        corners_px = np.array(re.findall(r"[\d.]+", view), dtype=float).reshape(3, 2)
        axis = camera.world_T_camera[:2, 2] * (1, -1)
        middle = corners_px[1:].mean(axis=0) - dot_px
        assert middle @ axis > 0.99 * np.linalg.norm(middle) * np.linalg.norm(axis)  # the lens is nearly symmetric
        opening = corners_px[1:] - dot_px
        cos = opening[0] @ opening[1] / np.prod(np.linalg.norm(opening, axis=1))
        # At least that of the width; a camera that looks down sees more of the horizon through its corners.
        assert np.arccos(cos) > 0.9 * 2 * np.arctan(camera.size_px[0] / 2 / camera.K[0, 0])
    assert "<script" not in from_above(fgpose.CameraRig((replace(rig.cameras[0], name="<script>"),)))


def test_a_picture_stays_small() -> None:
    page = smoothed()._repr_html_()
    assert len(page) < 40_000
    assert not re.search(r"(href|src)=", page), "nothing is loaded from outside"
