from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from built_body import BODY, built, random_angles, trajectory

from fgpose.io.skeletons import load_skeleton
from fgpose.kinematics import angle_names, joint_angles
from fgpose.kinematics.angles import JointAngles
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.synthetic import embedded_motion

# Of angles made of a few rotations in double precision.
EXACT_DEG = 1e-6
MIDLINE = (
    "trunk_lateral_bending",
    "trunk_heading",
    "pelvis_obliquity",
    "spine_lateral_bending",
    "spine_rotation",
    "head_rotation",
    "head_lateral_bending",
)


def angles_of(positions_m: np.ndarray, skeleton: Skeleton = BODY) -> dict[str, np.ndarray]:
    angles = joint_angles(trajectory(positions_m, skeleton))
    return dict(zip(angles.names, angles.angle_deg.T, strict=True))


def difference_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a - b + 180.0) % 360.0 - 180.0


@pytest.fixture(scope="module")
def postures() -> tuple[np.ndarray, list[dict[str, float]]]:
    """Fifty bodies in combined postures, and their angles."""
    rng = np.random.default_rng(4)
    wanted = [random_angles(rng) for _ in range(50)]
    return np.stack([built(angles) for angles in wanted]), wanted


def test_a_body_built_from_angles_has_these_angles(postures: tuple[np.ndarray, list[dict[str, float]]]) -> None:
    positions_m, wanted = postures
    found = angles_of(positions_m)
    assert set(found) == {*wanted[0], "pelvis_obliquity"}
    for name in wanted[0]:
        error_deg = difference_deg(found[name], np.array([angles[name] for angles in wanted]))
        assert np.abs(error_deg).max() < EXACT_DEG, name


@pytest.mark.parametrize(
    ("moved", "by_m", "name", "sign"),
    [
        ("right_ankle", (-0.2, 0, 0), "right_knee_flexion", 1),  # the heel to the back
        ("right_knee", (0.2, 0, 0), "right_hip_flexion", 1),  # the knee to the front
        ("right_knee", (0, -0.1, 0), "right_hip_adduction", -1),  # away from the other one
        ("left_knee", (0, 0.1, 0), "left_hip_adduction", -1),
        ("left_wrist", (0.2, 0, 0), "left_elbow_flexion", 1),
        ("right_big_toe", (0, 0, 0.1), "right_ankle_dorsiflexion", 1),
        ("neck", (0, 0, 0), "trunk_flexion", 0),
        ("right_hip", (0, 0, -0.05), "pelvis_obliquity", 1),
        ("right_ear", (0.05, 0, 0), "head_rotation", 1),  # the nose to the left
        ("right_ear", (0, 0, -0.05), "head_lateral_bending", 1),
    ],
)
def test_signs_are_those_of_the_isb(moved: str, by_m: tuple[float, float, float], name: str, sign: int) -> None:
    # Upright, facing x, the left side to y.
    positions_m = built({})
    assert angles_of(positions_m[None])[name] == pytest.approx(0.0, abs=EXACT_DEG)
    positions_m[BODY.index(moved)] += by_m
    assert np.sign(np.round(angles_of(positions_m[None])[name], 3)) == sign


def test_knee_and_elbow_by_the_law_of_cosines(postures: tuple[np.ndarray, list[dict[str, float]]]) -> None:
    positions_m, _ = postures
    found = angles_of(positions_m)
    for side in ("left", "right"):
        for joints, name in ((("hip", "knee", "ankle"), "knee"), (("shoulder", "elbow", "wrist"), "elbow")):
            a, b, c = (positions_m[:, BODY.index(f"{side}_{joint}")] for joint in joints)
            ab, bc, ac = (np.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (a, c)))
            inner_deg = np.rad2deg(np.arccos((ab**2 + bc**2 - ac**2) / (2 * ab * bc)))
            # arccos loses half of the digits near straight limbs, which these are not.
            np.testing.assert_allclose(found[f"{side}_{name}_flexion"], 180.0 - inner_deg, atol=EXACT_DEG)


def test_mirrored_bodies_have_mirrored_angles(postures: tuple[np.ndarray, list[dict[str, float]]]) -> None:
    positions_m, _ = postures
    plain, mirrored = angles_of(positions_m), angles_of((positions_m * [1.0, -1.0, 1.0])[:, BODY.mirror])
    for name, angle_deg in plain.items():
        other = name.replace("left_", "x_").replace("right_", "left_").replace("x_", "right_")
        expected_deg = -angle_deg if name in MIDLINE else angle_deg
        assert np.abs(difference_deg(mirrored[other], expected_deg)).max() < EXACT_DEG, name


def test_only_the_heading_knows_where_the_world_s_axes_point(
    postures: tuple[np.ndarray, list[dict[str, float]]],
) -> None:
    positions_m, _ = postures
    cos, sin = np.cos(0.7), np.sin(0.7)
    world_m = positions_m @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]).T + [3.0, -2.0, 1.0]
    plain, turned = angles_of(positions_m), angles_of(world_m)
    for name, angle_deg in plain.items():
        expected_deg = angle_deg + np.rad2deg(0.7) * (name == "trunk_heading")
        assert np.abs(difference_deg(turned[name], expected_deg)).max() < EXACT_DEG, name


def test_a_world_with_y_up_gives_the_same(postures: tuple[np.ndarray, list[dict[str, float]]]) -> None:
    positions_m, _ = postures
    covariance_m2 = np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (*positions_m.shape[:2], 3, 3)).copy()
    plain = joint_angles(trajectory(positions_m, covariance_m2=covariance_m2))
    axes = [1, 2, 0]
    other = trajectory(positions_m[..., axes], covariance_m2=covariance_m2[..., axes, :][..., axes])
    found = joint_angles(other, world_up="y")
    np.testing.assert_allclose(found.angle_deg, plain.angle_deg, atol=EXACT_DEG)
    np.testing.assert_allclose(found.sigma_deg, plain.sigma_deg, atol=EXACT_DEG)


def test_straight_limbs_have_no_plane() -> None:
    found = angles_of(built({})[None])
    for side in ("left", "right"):
        assert found[f"{side}_knee_flexion"] == pytest.approx(0.0, abs=EXACT_DEG)
        assert found[f"{side}_shoulder_elevation"] == pytest.approx(0.0, abs=EXACT_DEG)
        for name in ("hip_rotation", "shoulder_rotation", "shoulder_elevation_plane"):
            assert np.isnan(found[f"{side}_{name}"]), name
    overhead = angles_of(built({"right_shoulder_elevation": 180.0})[None])
    assert overhead["right_shoulder_elevation"] == pytest.approx(180.0, abs=EXACT_DEG)
    assert np.isnan(overhead["right_shoulder_elevation_plane"])


def test_joints_that_are_missing_take_only_their_angles_away() -> None:
    positions_m = np.stack([built(random_angles(np.random.default_rng(1)))] * 2)
    positions_m[1, BODY.index("left_knee")] = np.nan
    covariance_m2 = np.broadcast_to(1e-4 * np.eye(3), (*positions_m.shape[:2], 3, 3)).copy()
    covariance_m2[1, BODY.index("left_knee")] = np.nan
    angles = joint_angles(trajectory(positions_m, covariance_m2=covariance_m2))
    missing = {name for name, known in zip(angles.names, np.isfinite(angles.angle_deg[1]), strict=True) if not known}
    legs = {"hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion", "ankle_dorsiflexion"}
    assert missing == {f"left_{name}" for name in legs}
    assert np.isfinite(angles.angle_deg[0]).all()
    np.testing.assert_array_equal(np.isfinite(angles.sigma_deg), np.isfinite(angles.angle_deg))


def test_without_a_covariance_no_sigma_is_stated() -> None:
    angles = joint_angles(trajectory(built({"left_knee_flexion": 30.0})[None]))
    assert np.isnan(angles.sigma_deg).all()
    assert angles["left_knee_flexion"] == pytest.approx(30.0)
    with pytest.raises(ValueError, match="there is no angle 'knee'"):
        angles["knee"]


def test_a_recording_without_frames_has_angles_without_frames() -> None:
    angles = joint_angles(trajectory(np.zeros((0, BODY.n_joints, 3)), covariance_m2=np.zeros((0, 25, 3, 3))))
    assert angles.angle_deg.shape == angles.sigma_deg.shape == (0, len(angle_names(BODY)))


@pytest.mark.parametrize(
    ("skeleton", "ankles", "head"),
    [
        ("blazepose_33", True, True),
        ("body_25", True, True),
        ("body_25b", True, True),
        ("coco_17", False, True),
        ("h36m_17", False, False),
        ("h36m_17_lt", False, False),
        ("halpe_26", True, True),
        ("mhr_70", True, True),
        ("smpl_24", False, False),
    ],
)
def test_what_each_skeleton_determines(skeleton: str, ankles: bool, head: bool) -> None:
    names = angle_names(load_skeleton(skeleton))
    # 6 of the trunk; 3 of the hip, 3 of the shoulder, knee and elbow on each side.
    assert len(names) == 6 + 2 * 8 + 2 * ankles + 2 * head
    assert ("right_ankle_dorsiflexion" in names) == ankles
    assert ("head_rotation" in names) == head


def test_a_leg_alone_has_a_knee() -> None:
    leg = Skeleton("leg", ("left_hip", "left_knee", "left_ankle"), bones=((0, 1), (1, 2)), root=(0,))
    assert angle_names(leg) == ("left_knee_flexion",)


def test_a_skeleton_without_limbs_is_refused() -> None:
    markers = Skeleton("markers", ("a", "b"), bones=(), root=(0,))
    with pytest.raises(ValueError, match=r"skeleton markers determines no joint angle: .* but a, b"):
        joint_angles(Trajectory(markers, np.zeros(1), np.zeros((1, 2, 3)), np.zeros((1, 2))))


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match=r"angle_deg must be \(2, 2\), got \(2, 1\)"):
        JointAngles(("a", "b"), np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)))


def test_some_frames_and_some_angles() -> None:
    time_s, angle_deg = np.arange(5) / 50, np.arange(10.0).reshape(5, 2)
    angles = JointAngles(("flexion", "rotation"), time_s, angle_deg, angle_deg / 10, np.arange(3, 8))
    for part in (angles[1:3], angles.crop(1 / 50, 2 / 50), angles.frames(np.array([0, 1, 1, 0, 0], dtype=bool))):
        assert len(part) == 2
        np.testing.assert_array_equal(part.time_s, time_s[1:3])
        np.testing.assert_array_equal(part["rotation"], [3, 5])
        np.testing.assert_array_equal(part.sigma_deg, angle_deg[1:3] / 10)
        assert part.frame_numbers is not None
        np.testing.assert_array_equal(part.frame_numbers, [4, 5])
    np.testing.assert_array_equal(angles[["rotation", "flexion"]], angle_deg[:, ::-1])
    with pytest.raises(ValueError, match=r"there are frames from 0 s to 0\.08 s"):
        angles.crop(1.0, 2.0)
    wrong: Any = 1
    with pytest.raises(ValueError, match="frames are taken forward in time"):
        angles[::-1]
    with pytest.raises(TypeError, match=r"frames as a slice, \[1:2\]"):
        angles[wrong]


def test_a_walk_has_the_angles_of_a_walk() -> None:
    """Winter 2009 and Perry 1992: the knee flexes by some 5 to 65 degrees, the hip by -15 to 30. This clip's skeleton
    has its hip joints and knees where a suit's markers put them, and its hips against the trunk: 10 degrees either way.
    """
    positions_m, fps = embedded_motion("cmu_02_01_short")
    angles = joint_angles(trajectory(positions_m, load_skeleton("h36m_17"), fps=fps))
    for side in ("left", "right"):
        knee_deg, hip_deg = angles[f"{side}_knee_flexion"], angles[f"{side}_hip_flexion"]
        assert 0 <= knee_deg.min() < 15
        assert 55 < knee_deg.max() < 75
        assert -27 < hip_deg.min() < -5
        assert 20 < hip_deg.max() < 40
        assert np.abs(angles[f"{side}_hip_adduction"]).max() < 15
    # Legs swing in turns: one knee is bent most while the other is nearly straight.
    swinging = angles["left_knee_flexion"].argmax()
    assert angles["right_knee_flexion"][swinging] < angles["left_knee_flexion"][swinging] - 30
    assert np.abs(angles["trunk_flexion"]).max() < 10


def test_the_trajectory_stays_as_it_was() -> None:
    positions_m = built({})[None].copy()
    before = trajectory(positions_m.copy())
    joint_angles(before)
    np.testing.assert_array_equal(before.positions_m, positions_m)
    assert replace(before) is not before


def test_quantiles_of_a_heading_do_not_depend_on_where_the_world_s_axes_point() -> None:
    """Somebody who faces -x turns from 175 to -175 degrees: by 10, not by 350."""
    spread_deg = np.random.default_rng(0).normal(0.0, 15.0, 400)
    plain_deg = np.quantile(spread_deg, (0.0, 0.5, 1.0))
    for heading_deg in (0.0, 90.0, 179.0, -170.0):
        turned_deg = (spread_deg + heading_deg + 180) % 360 - 180
        found_deg = JointAngles(("a",), np.arange(400.0), turned_deg[:, None], np.ones((400, 1))).quantiles_deg(
            (0.0, 0.5, 1.0)
        )[:, 0]
        off_deg = found_deg - plain_deg - heading_deg
        np.testing.assert_allclose(off_deg, np.full(3, np.round(off_deg[0] / 360) * 360), atol=1e-9)
        assert -180 <= found_deg[1] < 180
    # Mostly at one end of a wide range.
    wide_deg = np.append(np.full(900, -50.0), np.linspace(-60, 175, 100))
    wide = JointAngles(("a",), np.arange(1000.0), wide_deg[:, None], np.ones((1000, 1)))
    np.testing.assert_allclose(wide.quantiles_deg((0.0, 0.5, 1.0))[:, 0], [-60, -50, 175], atol=1e-9)
    nowhere = JointAngles(("a",), np.zeros(1), np.full((1, 1), np.nan), np.ones((1, 1)))
    assert np.isnan(nowhere.quantiles_deg((0.5,))).all()
