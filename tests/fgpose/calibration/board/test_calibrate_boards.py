"""Cameras from simulated corners of a board, against the truth."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.lens import LensKind, camera_of, numbers_of
from fgpose.calibration.board.lenses import fit_lens
from fgpose.calibration.board.problem import BoardBundle, BoardProblem, moved_poses
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.calibration.board.world import parse_origin
from fgpose.calibration.from_people.calibrated import Grade
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.lens import LensModel
from fgpose_benchmarks.synthetic.boards import BoardScene, seen_px, simulate_boards


def simulated(n_cameras: int, seed: int, noise_px: float = 0.2, model: LensModel = "pinhole") -> BoardScene:
    """Small, so that it is quickly calibrated."""
    return simulate_boards(n_cameras, seed, noise_px=noise_px, n_common=12, n_near=6, model=model)


@pytest.fixture(scope="module")
def scene() -> BoardScene:
    return simulated(3, 5)


@pytest.fixture(scope="module")
def result(scene: BoardScene) -> CalibratedFromBoards:
    return calibrate_from_boards(scene.sightings)


def errors_m(rig: CameraRig, true: CameraRig) -> np.ndarray:
    """Of the positions, but for a motion of the whole rig."""
    return np.linalg.norm(rig_similarity(rig, true, with_scale=False).rig(rig).positions_m - true.positions_m, axis=1)


def bundle_of(scene: BoardScene) -> BoardBundle:
    poses = np.stack([camera.world_T_camera for camera in scene.rig.cameras])
    return BoardBundle.on_time(
        poses, np.stack([numbers_of(camera) for camera in scene.rig.cameras]), scene.world_T_board
    )


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_jacobians_are_those_of_differences(model: LensModel) -> None:
    scene = simulate_boards(2, 1, n_common=2, n_near=1, model=model)
    kinds = [LensKind(model, 4 if model == "fisheye" else 5, square=square) for square in (True, False)]
    problem = BoardProblem(scene.sightings, kinds, np.array([1e3, 2e3]))  # so large that the kernel is quadratic
    rng = np.random.default_rng(0)
    truth = bundle_of(scene)
    moved = moved_poses(truth.world_T_board, rng.normal(0, 0.01, (len(truth.world_T_board), 6)))
    state = replace(truth, world_T_board=moved)
    gradient, step = problem.gradient(state), 1e-6
    for unknown in range(len(gradient)):
        change = np.zeros(len(gradient))
        change[unknown] = step
        ahead, behind = (problem.error(problem.moved(state, sign * change)) for sign in (1, -1))
        # Central differences are exact to the third derivative: 1e-12 of numbers of the size of the gradient.
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient[unknown], rel=1e-4, abs=1e-5)


def test_moments_disagree_as_far_as_corners_of_a_view_err_together(scene: BoardScene) -> None:
    """The image of each board bends along it, at its ends by twice the noise of a corner."""
    kinds = [LensKind(n_distortion=5, square=False)] * 3
    problem = BoardProblem(scene.sightings, kinds, np.full(3, 0.2))
    solved = problem.solve(bundle_of(scene)).state
    # With some 350 degrees of freedom, chance makes it 4 % more or less: three times that.
    assert problem.disagreement(solved) == pytest.approx(1, abs=0.12)
    along = scene.sightings.board.points_m[:, 0]
    bend = ((along - along.mean()) / np.ptp(along)) ** 2
    bent_px = np.random.default_rng(1).normal(0, 8 * 0.2, (len(scene.sightings.time_s), 3, 1, 2)) * bend[:, None]
    bent = BoardProblem(replace(scene.sightings, points_px=scene.sightings.points_px + bent_px), kinds, np.full(3, 0.2))
    assert bent.disagreement(bent.solve(solved).state) > 1.5


def test_moments_cannot_disagree_about_what_is_held(scene: BoardScene) -> None:
    problem = BoardProblem(scene.sightings.of_camera(0), [LensKind(held=True)], np.full(1, 0.2))
    bundle = bundle_of(scene)
    state = BoardBundle.on_time(
        bundle.world_T_camera[:1], bundle.lenses[:1], bundle.world_T_board[scene.sightings.shows_board[:, 0]]
    )
    assert problem.disagreement(state) == 1


def test_the_solution_is_that_of_the_whole_matrix() -> None:
    """The Schur complement against the normal equations of all unknowns, whose rows are differences of gradients. There
    is no noise, so that Gauss-Newton's are all of them."""
    scene = simulate_boards(3, 5, noise_px=0.0, n_common=6, n_near=0)
    part = replace(scene.sightings, time_s=scene.sightings.time_s[:5], points_px=scene.sightings.points_px[:5])
    problem = BoardProblem(part, [LensKind(held=True)] * 3, np.full(3, 1.0))
    truth = bundle_of(scene)
    state = replace(truth, world_T_board=truth.world_T_board[:5])
    damping = 7.0
    system = problem.equations(state, damping)
    n = len(problem.damping_scale)
    right = np.random.default_rng(0).normal(size=n)
    solved = system.solve(right)
    step = 0.01  # of steps of 2 mm: small enough to be linear, and large beside rounding
    product = (
        problem.gradient(problem.moved(state, step * solved)) - problem.gradient(problem.moved(state, -step * solved))
    ) / (2 * step)
    np.testing.assert_allclose(product + damping * problem.damping_scale * solved, right, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("model", ["pinhole", pytest.param("fisheye", marks=pytest.mark.slow)])
def test_without_noise_the_truth_is_found(model: LensModel) -> None:
    scene = simulated(3, 5, 0.0, model)
    result = calibrate_from_boards(scene.sightings)
    assert [camera.lens for camera in result.rig.cameras] == [model] * 3
    # Where the steps of the adjustment end: a micrometre.
    assert errors_m(result.rig, scene.rig).max() < 1e-5
    for found, true in zip(result.rig.cameras, scene.rig.cameras, strict=True):
        np.testing.assert_allclose(found.K, true.K, atol=1e-3)
        np.testing.assert_allclose(found.distortion, true.distortion, atol=1e-5)


@pytest.mark.parametrize("n_distortion", [0, 1, 5])
def test_a_lens_has_the_coefficients_that_it_shows(n_distortion: int) -> None:
    """All of those that are there; one by one, chance makes a needless one likely once in six."""
    scene = simulate_boards(1, 2, noise_px=0.0, n_common=0, n_near=12)
    (camera,) = scene.rig.cameras
    distortion = np.where(np.arange(5) < n_distortion, camera.distortion, 0.0)
    rig = CameraRig((replace(camera, distortion=distortion),))
    points_px = np.stack([seen_px(rig, pose, scene.sightings.board) for pose in scene.world_T_board])
    sees = np.isfinite(points_px).any(axis=(1, 2, 3))
    noisy_px = points_px[sees] + np.random.default_rng(4).normal(0, 0.2, points_px[sees].shape)
    seen = replace(scene.sightings, time_s=scene.sightings.time_s[sees], points_px=noisy_px)
    fitted = fit_lens(seen, "pinhole")
    assert fitted.kind.n_distortion >= n_distortion
    assert fitted.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.15)


# Of the colour camera of a Kinect, whose fifth coefficient alone leaves a pixel near the corners.
RATIONAL = np.array([0.47, -2.5, 8e-4, -2e-4, 1.45, 0.35, -2.33, 1.38])


def seen_by(distortion: np.ndarray, focal_px: float, n_cameras: int = 1) -> tuple[CameraRig, BoardSightings]:
    """A board before cameras with this lens, with 0.2 px of noise."""
    scene = simulate_boards(n_cameras, 1, noise_px=0.0, n_common=0 if n_cameras == 1 else 16, n_near=24)
    K = np.array([[focal_px, 0, 960], [0, focal_px, 540], [0, 0, 1]])
    rig = CameraRig(tuple(replace(camera, distortion=distortion, K=K) for camera in scene.rig.cameras))
    points_px = np.stack([seen_px(rig, pose, scene.sightings.board) for pose in scene.world_T_board])
    noisy_px = points_px + np.random.default_rng(4).normal(0, 0.2, points_px.shape)
    sees = np.isfinite(points_px).any(axis=(1, 2, 3))
    return rig, replace(scene.sightings, time_s=scene.sightings.time_s[sees], points_px=noisy_px[sees])


@pytest.mark.slow
def test_a_rational_lens_is_found_where_views_show_it() -> None:
    rig, seen = seen_by(RATIONAL, 900.0)
    fitted = fit_lens(seen)
    assert fitted.kind.text == "pinhole, k1 k2 p1 p2 k3 k4 k5 k6"
    assert fitted.numbers[0] == pytest.approx(rig.cameras[0].K[0, 0], rel=2e-3)
    assert fitted.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.15)
    # The same rays, whatever the coefficients are; but for the turn that a principal point 2 px off makes.
    (camera,) = rig.cameras
    found = camera_of("cam", camera.size_px, fitted.numbers, fitted.kind, np.eye(4))
    points_px = seen.points_px[np.isfinite(seen.points_px).all(axis=-1)]
    rays = [(each.undistort(points_px) - each.K[:2, 2]) / np.diag(each.K)[:2] for each in (found, camera)]
    assert np.median(np.linalg.norm(rays[0] - rays[1], axis=1)) < 2 / 900


@pytest.mark.parametrize("n_distortion", [1, 5])
def test_a_lens_that_is_not_rational_is_not_taken_for_one(n_distortion: int) -> None:
    _, seen = seen_by(np.array([-0.12, 0.06, 6e-4, -4e-4, -0.01]) * (np.arange(5) < n_distortion), 1100.0)
    assert fit_lens(seen, "pinhole").kind.n_distortion <= 5


@pytest.mark.slow
def test_rational_lenses_make_a_rig_and_are_held() -> None:
    rig, seen = seen_by(RATIONAL, 900.0, 3)
    found = calibrate_from_boards(seen, lens="pinhole")
    assert {camera.distortion.size for camera in found.rig.cameras} == {8}
    assert (errors_m(found.rig, rig) < 3 * found.sigmas.position_m).all()
    held = calibrate_from_boards(seen, intrinsics=rig)
    np.testing.assert_array_equal(held.rig.cameras[0].distortion, RATIONAL)
    assert (errors_m(held.rig, rig) < 3 * held.sigmas.position_m).all()


@pytest.mark.slow
def test_errors_are_as_large_as_is_said() -> None:
    """Of eight rigs of three cameras with 0.2 px of noise: 95 % within two sigmas, and not much larger sigmas."""
    positions, focals = [], []
    for seed in range(8):
        scene = simulated(3, seed)
        result = calibrate_from_boards(scene.sightings)
        positions.append(errors_m(result.rig, scene.rig) / result.sigmas.position_m)
        focals.append((result.rig.focal_px / scene.rig.focal_px - 1) / result.sigmas.focal)
    # 24 numbers, of which 3 axes are in each position: the root mean squares of true claims are 0.7 to 1.3.
    assert 0.5 < np.sqrt(np.mean(np.square(positions))) < 1.3
    assert 0.6 < np.sqrt(np.mean(np.square(focals))) < 1.5
    assert np.mean(np.abs(focals) < 2) >= 0.87


def test_a_good_recording_is_good(result: CalibratedFromBoards, scene: BoardScene) -> None:
    assert [finding for finding in result.findings if finding.grade is Grade.FAILED] == []
    assert result.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    # The same in a single rig: three sigmas.
    assert (errors_m(result.rig, scene.rig) < 3 * result.sigmas.position_m).all()


def test_the_world_is_the_board_on_the_floor(result: CalibratedFromBoards, scene: BoardScene) -> None:
    heights_m = result.rig.positions_m[:, 2]
    np.testing.assert_allclose(heights_m, scene.rig.positions_m[:, 2], atol=0.02)
    np.testing.assert_allclose(result.world_T_board[0, :3, :3], np.diag([1, -1, -1]), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("origin", ["camera", "level", "board@3"])
def test_other_worlds(origin: str, scene: BoardScene, result: CalibratedFromBoards) -> None:
    other = calibrate_from_boards(scene.sightings, origin=parse_origin(origin))
    # The same rig but for a motion.
    assert errors_m(other.rig, result.rig).max() < 1e-6
    first = other.rig.cameras[0].world_T_camera
    if origin == "camera":
        np.testing.assert_allclose(first, np.eye(4), atol=1e-9)
    if origin == "level":
        # The cameras of the scene stand level.
        up = rig_similarity(other.rig, scene.rig, with_scale=False).R @ (0, 0, 1)
        assert up == pytest.approx([0, 0, 1], abs=0.01)
        np.testing.assert_allclose(first[:3, 3], 0, atol=1e-9)


def test_a_moment_without_a_board_is_no_origin(scene: BoardScene) -> None:
    with pytest.raises(ValueError, match=r"board@99, where no view of the board is used; one is at \d+\.\d\d s"):
        calibrate_from_boards(scene.sightings, intrinsics=scene.rig, origin=parse_origin("board@99"))


@pytest.mark.parametrize("text", ["floor", "board@", "board@x", "camera@3"])
def test_worlds_that_there_are_not(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape("the origin is board, board@SECONDS, camera, level or people")):
        parse_origin(text)


def test_given_lenses_are_kept(scene: BoardScene) -> None:
    result = calibrate_from_boards(scene.sightings, intrinsics=scene.rig)
    for found, true in zip(result.rig.cameras, scene.rig.cameras, strict=True):
        np.testing.assert_array_equal(found.K, true.K)
    assert result.lenses == ("as given",) * 3
    assert not result.sigmas.focal.any()
    assert errors_m(result.rig, scene.rig).max() < 0.005


@pytest.mark.slow
def test_wrong_views_are_left_out_by_name(scene: BoardScene, result: CalibratedFromBoards) -> None:
    points_px = scene.sightings.points_px.copy()
    t = int(np.flatnonzero(scene.sightings.shows_board[:, 1])[4])
    points_px[t, 1, ::2] += 25.0
    found = calibrate_from_boards(replace(scene.sightings, points_px=points_px))
    assert [(each.camera, each.time_s) for each in found.sightings.left_out] == [("ring_1", scene.sightings.time_s[t])]
    assert errors_m(found.rig, result.rig).max() < 0.005


@pytest.mark.slow
def test_single_corners_that_are_wrong_hardly_matter(scene: BoardScene, result: CalibratedFromBoards) -> None:
    rng = np.random.default_rng(0)
    points_px = scene.sightings.points_px.copy()
    wrong = rng.random(points_px.shape[:3]) < 0.01
    points_px[wrong] += rng.normal(0, 5.0, (int(wrong.sum()), 2))
    found = calibrate_from_boards(replace(scene.sightings, points_px=points_px))
    assert (errors_m(found.rig, scene.rig) < 3 * found.sigmas.position_m).all()
    # Without the kernel they would multiply the errors by five: of one in a hundred the square is 600 times as large.
    assert found.sigmas.position_m.max() < 1.5 * result.sigmas.position_m.max()


@pytest.mark.slow
def test_a_camera_at_other_moments_contradicts_the_others(scene: BoardScene) -> None:
    """Its images are those of the moment after."""
    points_px = scene.sightings.points_px.copy()
    points_px[1:17, 2] = points_px[:16, 2]
    found = calibrate_from_boards(replace(scene.sightings, points_px=points_px))
    said = [finding for finding in found.findings if finding.camera == "ring_2"]
    assert found.grade is not Grade.GOOD
    assert said, found.findings


@pytest.mark.slow
def test_a_camera_on_its_own_is_named(scene: BoardScene) -> None:
    points_px = scene.sightings.points_px.copy()
    points_px[points_px.shape[0] - 9 :, :2] = np.nan
    points_px[:-9, 2] = np.nan
    message = "camera ring_2: never sees the board at the same moment as ring_0 or ring_1"
    with pytest.raises(ValueError, match=message):
        calibrate_from_boards(replace(scene.sightings, points_px=points_px))


@pytest.mark.slow
def test_a_weak_link_says_what_to_film(scene: BoardScene) -> None:
    points_px = scene.sightings.points_px.copy()
    common = np.flatnonzero(scene.sightings.shows_board[:, 2] & scene.sightings.shows_board[:, :2].any(axis=1))
    points_px[common[2:], 2] = np.nan
    found = calibrate_from_boards(replace(scene.sightings, points_px=points_px))
    (weak,) = [finding for finding in found.findings if "moments only" in finding.reason]
    assert weak.camera == "ring_2"
    assert re.fullmatch(r"hold the board where ring_2 and ring_[01] see it at once, in 10 more places", weak.remedy)


@pytest.mark.slow
def test_views_in_the_middle_leave_the_border_open() -> None:
    scene = simulate_boards(3, 5, n_common=40, n_near=0)
    found = calibrate_from_boards(scene.sightings)
    reasons = [finding.reason for finding in found.findings]
    assert any("its lens is a guess beyond" in reason for reason in reasons)
    assert found.grade is Grade.COARSE


def test_too_few_views_name_the_camera(scene: BoardScene) -> None:
    points_px = scene.sightings.points_px.copy()
    points_px[np.flatnonzero(scene.sightings.shows_board[:, 1])[2:], 1] = np.nan
    with pytest.raises(ValueError, match="camera ring_1: the board is seen in 2 of its images, at least 3"):
        calibrate_from_boards(replace(scene.sightings, points_px=points_px))


@pytest.mark.slow
def test_a_board_that_is_printed_too_wide_is_doubted_and_not_the_cameras(scene: BoardScene) -> None:
    """By 2 % along its rows; eleven reasons were given, and none was this."""
    wide = np.diag([1.02, 1.0, 1.0, 1.0])
    wide_px = np.stack([seen_px(scene.rig, pose @ wide, scene.sightings.board) for pose in scene.world_T_board])
    wide_px += np.random.default_rng(3).normal(0, 0.2, wide_px.shape)
    found = calibrate_from_boards(replace(scene.sightings, points_px=wide_px))
    (finding,) = [each for each in found.findings if "images of all cameras seem to be stretched" in each.reason]
    assert re.search(r"stretched by (1\.[5-9]|2\.[0-5])% in width", finding.reason)
    assert "measure the board in both directions" in finding.remedy
    assert not any("known to" in each.reason for each in found.findings)


def test_boards_that_look_the_same_upside_down_are_refused(scene: BoardScene) -> None:
    board = replace(scene.sightings.board, kind="chessboard", size=(6, 4))
    with pytest.raises(ValueError, match="looks the same after half a turn"):
        calibrate_from_boards(replace(scene.sightings, board=board))


def test_one_camera_is_a_lens() -> None:
    scene = simulate_boards(1, 2, n_common=0, n_near=12)
    found = calibrate_from_boards(scene.sightings, origin=parse_origin("camera"))
    assert found.rig.focal_px == pytest.approx(scene.rig.focal_px, rel=0.01)
    assert found.sigmas.position_m == 0


def test_a_fisheye_is_one_although_a_rational_model_fits_its_corners_as_well() -> None:
    scene = simulate_boards(4, 0, model="fisheye")
    assert fit_lens(scene.sightings.of_camera(2)).kind.model == "fisheye"
