"""Scenes of uncalibrated cameras: exact without errors, each kind of error as large as stated, the clocks as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose_benchmarks.synthetic import (
    NO_CROWD_ERRORS,
    NO_NOISE,
    STUDIOS,
    CrowdErrors,
    CrowdMotion,
    Occlusion,
    SimulatedClocks,
    SimulatedNetwork,
    WalkScene,
    film,
    find_studio,
    positions_at,
    stature_m,
    walkers,
)

EXACT = SimulatedNetwork(
    noise=NO_NOISE,
    min_bias_m=0.0,
    max_bias_m=0.0,
    scale_sigma=0.0,
    depth_bias_scale=0.0,
    tilt_sigma_deg=0.0,
    mistakes=NO_CROWD_ERRORS,
)
APART = SimulatedClocks(fps=(30.0, 25.0), max_start_s=1.5, min_drift_ppm=43.0, max_drift_ppm=145.0)
MIXED = find_studio("mixed_5")


@pytest.fixture(scope="module")
def motion() -> CrowdMotion:
    return walkers(MIXED.floor_m, 3.0, seed=3)


def of_camera(scene: WalkScene, camera: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the images that show one person: times, pixels, 3D in the frame of the camera, true joints in the world."""
    images = [image for image in scene.observations.by_camera[scene.rig.names[camera]] if image.n_people == 1]
    time_s = np.array([image.time_s for image in images])
    points3d_m = np.array([image.points3d_m for image in images])[:, 0]
    true_m = positions_at(scene.motion, scene.true_s(camera, time_s))[0]
    return time_s, np.array([image.points2d_px for image in images])[:, 0], points3d_m, true_m


def test_without_errors_every_view_is_exact(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, EXACT, APART)
    for c, camera in enumerate(scene.rig.cameras):
        _, points2d_px, points3d_m, true_m = of_camera(scene, c)
        seen = np.isfinite(points2d_px)
        assert seen.mean() > 0.8
        np.testing.assert_allclose(points2d_px[seen], camera.distort(camera.project(true_m))[seen], atol=1e-6)
        in_3d = np.isfinite(points3d_m)
        # OpenCV's undistortion iterates until 1e-4 px or so: at 5 m and 640 px that is far less than 10 um.
        np.testing.assert_allclose(points3d_m[in_3d], camera.to_camera_frame(true_m)[in_3d], atol=1e-5)


def test_what_is_given_is_the_lens_alone(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, EXACT)
    for given, true in zip(scene.intrinsics.cameras, MIXED.rig.cameras, strict=True):
        np.testing.assert_array_equal(given.world_T_camera, np.eye(4))
        np.testing.assert_array_equal(given.K, true.K)
        np.testing.assert_array_equal(given.distortion, true.distortion)
        assert given.name == true.name


def test_a_guessed_focal_length_moves_people_away(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, EXACT, focal_guess=1.25)
    np.testing.assert_allclose(scene.intrinsics.focal_px, 1.25 * MIXED.rig.focal_px)
    for c, camera in enumerate(MIXED.rig.cameras):
        assert not scene.intrinsics.cameras[c].distortion.any()
        _, points2d_px, points3d_m, true_m = of_camera(scene, c)
        whole = np.isfinite(points3d_m).all(axis=(1, 2))
        true_depth_m, depth_m = camera.to_camera_frame(true_m)[whole][..., 2], points3d_m[whole][..., 2]
        np.testing.assert_allclose(depth_m.mean(axis=1), 1.25 * true_depth_m.mean(axis=1), atol=1e-9)
        np.testing.assert_allclose(np.ptp(depth_m, axis=1), np.ptp(true_depth_m, axis=1), atol=1e-9)
        # On the rays that the guess gives to the pixels.
        ray = (points2d_px[whole] - scene.intrinsics.cameras[c].K[:2, 2]) / scene.intrinsics.focal_px[c]
        np.testing.assert_allclose(points3d_m[whole][..., :2], ray * depth_m[..., None], atol=1e-9)


def test_clocks_begin_with_the_videos_and_drift(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, EXACT, APART)
    assert scene.start_s.min() == 0.0
    assert 0.5 < scene.start_s.max() <= 1.5
    drift_ppm = 1e6 * np.abs(scene.rate - 1.0)
    assert ((drift_ppm >= 43.0) & (drift_ppm <= 145.0)).all()
    duration_s = (motion.truth_m.shape[1] - 1) / motion.fps
    for c, name in enumerate(scene.rig.names):
        time_s = scene.observations.times_s(name)
        assert time_s[0] == 0.0
        np.testing.assert_allclose(np.diff(time_s), 1 / APART.fps[c % 2], atol=1e-9)
        # All end with the motion, to within an image.
        assert duration_s - 1 / 25 < scene.true_s(c, time_s[-1:])[0] <= duration_s + 1e-9


def test_the_offsets_of_the_rig_take_each_clock_to_the_first(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, EXACT, APART)
    middle_s = (scene.start_s.max() + (motion.truth_m.shape[1] - 1) / motion.fps) / 2
    own_s = (middle_s - scene.start_s) / scene.rate
    np.testing.assert_allclose(own_s + scene.rig.time_offsets_s, own_s[0], atol=1e-12)
    np.testing.assert_allclose(scene.joints_m(own_s[:1]), positions_at(motion, np.array([middle_s]))[0], atol=1e-12)


def test_the_bias_is_the_detectors_and_the_noise_each_cameras(motion: CrowdMotion):
    biased = replace(EXACT, min_bias_m=0.02, max_bias_m=0.04)
    # Two cameras at one place, one of them with another lens and turned upside down.
    camera, other = MIXED.rig.cameras[0], MIXED.rig.cameras[1]
    turned = camera.world_T_camera.copy()
    turned[:3, :3] = turned[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    rig = type(MIXED.rig)((camera, replace(other, world_T_camera=turned)))
    scene = film(motion, rig, 1, biased)
    rays, times_s = [], []
    for c, each in enumerate(rig.cameras):
        time_s, points2d_px, _, true_m = of_camera(scene, c)
        times_s.append(time_s)
        rays.append(each.ray(each.undistort(points2d_px)))
        error_m = np.linalg.norm(rays[c] - each.ray(each.project(true_m)), axis=-1) * 4.5
        assert 0.01 < np.nanmean(error_m) < 0.05
    # One of the two has the person outside of its image now and then.
    rays = [own[np.isin(time_s, other_s)] for own, time_s, other_s in zip(rays, times_s, times_s[::-1], strict=True)]
    both = np.isfinite(rays[0]) & np.isfinite(rays[1])
    assert both.any()
    # Undistortion is exact to 1e-4 px.
    np.testing.assert_allclose(rays[0][both], rays[1][both], atol=1e-6)


def test_a_network_takes_a_body_for_another_size(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 1, replace(EXACT, scale_sigma=0.06))
    ratios = []
    for c, camera in enumerate(scene.rig.cameras):
        _, _, points3d_m, true_m = of_camera(scene, c)
        ratios.append(np.nanmedian(points3d_m / camera.to_camera_frame(true_m)))
    # One person has one size, in whatever view.
    assert np.ptp(ratios) < 1e-6
    assert 0.88 <= ratios[0] <= 1.12
    assert abs(ratios[0] - 1.0) > 1e-3


def test_a_tilt_turns_poses_about_the_horizontal_of_the_image(motion: CrowdMotion):
    scene = film(motion, MIXED.rig, 2, replace(EXACT, tilt_sigma_deg=3.0))
    slopes = []
    for c, camera in enumerate(scene.rig.cameras):
        _, _, points3d_m, true_m = of_camera(scene, c)
        in_camera_m = camera.to_camera_frame(true_m)
        farther_m = (points3d_m - in_camera_m)[..., 2]
        whole = np.isfinite(farther_m).all(axis=1)
        down_m = in_camera_m[whole][..., 1]
        down_m = down_m - down_m.mean(axis=1, keepdims=True)
        slopes.append(np.sum(farther_m[whole] * down_m) / np.sum(down_m**2))
        np.testing.assert_allclose(farther_m[whole], slopes[c] * down_m, atol=1e-9)
    # Five draws of a standard deviation of 3 degrees: their RMS is within a factor of 2.5 in 99 % of the cases.
    assert 3 / 2.5 < np.rad2deg(np.sqrt(np.mean(np.square(slopes)))) < 3 * 2.5


def test_bodies_are_flipped_and_missed(motion: CrowdMotion):
    wrong = CrowdErrors(min_visible_joints=1, missed_share=0.3, flipped_share=0.4, missed_s=0.1, flipped_s=0.1)
    scene = film(motion, MIXED.rig, 1, replace(EXACT, mistakes=wrong))
    n_seen, n_flipped, n_images, mirror = 0, 0, 0, motion.skeleton.mirror
    for c, camera in enumerate(scene.rig.cameras):
        _, points2d_px, points3d_m, true_m = of_camera(scene, c)
        n_images += len(scene.observations.by_camera[camera.name])
        n_seen += len(points2d_px)
        true_px, in_camera_m = camera.distort(camera.project(true_m)), camera.to_camera_frame(true_m)
        off_px = np.linalg.norm(points2d_px - true_px, axis=-1)
        flipped = np.nanmax(off_px, axis=1) > 1.0
        n_flipped += int(flipped.sum())
        # All joints of a body or none, in 3D too.
        np.testing.assert_allclose(
            points2d_px[flipped][:, mirror],
            np.where(np.isfinite(points2d_px[flipped][:, mirror]), true_px[flipped], np.nan),
            atol=1e-6,
        )
        swapped_m = points3d_m[flipped][:, mirror]
        np.testing.assert_allclose(swapped_m, np.where(np.isfinite(swapped_m), in_camera_m[flipped], np.nan), atol=1e-5)
    # About 30 states of 0.1 s in each of five cameras: shares are right to 4 %, given here to four times that.
    assert 0.54 < n_seen / n_images < 0.86
    assert 0.24 < n_flipped / n_seen < 0.56


def test_the_same_seed_gives_the_same_scene(motion: CrowdMotion):
    scenes = [film(motion, MIXED.rig, seed, SimulatedNetwork(), APART) for seed in (5, 5, 6)]
    pixels = [np.concatenate([image.points2d_px.ravel() for image in scene.observations.images]) for scene in scenes]
    np.testing.assert_array_equal(pixels[0], pixels[1])
    assert len(pixels[0]) != len(pixels[2]) or not np.array_equal(pixels[0], pixels[2], equal_nan=True)


@pytest.mark.slow
def test_occluders_and_real_errors_are_worse(motion: CrowdMotion):
    def error_px(network: SimulatedNetwork) -> float:
        errors = []
        scene = film(motion, MIXED.rig, 1, network)
        for c, camera in enumerate(scene.rig.cameras):
            _, points2d_px, _, true_m = of_camera(scene, c)
            errors.append((points2d_px - camera.distort(camera.project(true_m))).ravel())
        return float(np.sqrt(np.nanmean(np.square(np.concatenate(errors)))))

    plain_px = error_px(replace(EXACT, noise=SimulatedNetwork().noise))
    assert error_px(replace(EXACT, noise=SimulatedNetwork().noise, occlusion=Occlusion(n_occluders=1))) > 1.5 * plain_px
    assert error_px(replace(EXACT, real=("blazepose_full",))) > 1.0


@pytest.mark.slow
def test_people_hide_each_other_and_are_known_by_number():
    studio = find_studio("corners_3")
    motion = walkers(studio.floor_m, 4.0, seed=2, n_people=3)
    scene = film(motion, studio.rig, 1, EXACT)
    assert motion.is_there[0].all()
    numbers = {n for who in scene.who for n in who.tolist()}
    assert numbers == {0, 1, 2}
    for image, who in zip(scene.observations.images[::20], scene.who[::20], strict=True):
        camera = scene.rig.cameras[scene.rig.names.index(image.camera)]
        true_px = camera.distort(camera.project(positions_at(motion, np.array([image.time_s]))[:, 0]))
        off_px = np.linalg.norm(image.points2d_px - true_px[who], axis=-1)
        # Joints in sight are exact, those behind somebody hallucinated or missing.
        assert np.nanmedian(off_px) < 1e-6
    shown = np.concatenate([(image.confidence > 0).ravel() for image in scene.observations.images])
    assert shown.mean() < 1.0


def test_one_line_one_spot_and_nothing_at_all():
    line, spot, still = (
        np.ptp(walkers((4.0, 4.0), 8.0, 1, behaviour).truth_m[0, :, 0], axis=0)
        for behaviour in ("line", "spot", "stands")
    )
    assert line[0] > 2.5
    assert line[1] < 0.15  # hips sway by some centimetres
    assert spot.max() < 0.4
    assert still.max() < 1e-3
    with pytest.raises(ValueError, match="only one person can be asked for who line, not 2"):
        walkers((4.0, 4.0), 8.0, 1, "line", n_people=2)


def test_the_stature_is_about_the_highest_point(motion: CrowdMotion):
    highest_m = motion.truth_m[0, :, motion.skeleton.index("head"), 2].max()
    # Nobody is taller when walking than when standing straight, but for the bounce of the gait and the toes.
    assert -0.05 < highest_m - stature_m(motion.truth_m[0], motion.skeleton) < 0.05


def test_studios_see_their_floor():
    for studio in STUDIOS:
        half_x_m, half_y_m = (side_m / 2 - 0.5 for side_m in studio.floor_m)
        corners_m = np.array([(x * half_x_m, y * half_y_m, 0.9) for x in (-1, 1) for y in (-1, 1)])
        for camera in studio.rig.cameras:
            points_px = camera.distort(camera.project(corners_m))
            assert np.all((points_px > 0) & (points_px < camera.size_px), axis=-1).mean() >= 0.5, (
                studio.name,
                camera.name,
            )
    with pytest.raises(ValueError, match="no studio 'hall'"):
        find_studio("hall")


def test_a_camera_turned_upright_shows_the_turned_image():
    from fgpose_benchmarks.synthetic.studios import WEBCAM

    lens, upright = WEBCAM[1], WEBCAM[1].upright
    points_m = np.array([[0.3, -0.2, 2.0], [-0.5, 0.4, 2.5], [0.6, 0.3, 3.0]])
    flat = lens.camera("flat", np.eye(4))
    turn = np.eye(4)
    # The new x is the old y, the new y minus the old x.
    turn[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stood = upright.camera("upright", turn)
    x, y = flat.distort(flat.project(points_m)).T
    np.testing.assert_allclose(stood.distort(stood.project(points_m)), np.stack([y, 1280 - x], axis=-1), atol=1e-9)


@pytest.mark.parametrize(
    "clocks", [{"fps": ()}, {"fps": (0.0,)}, {"max_start_s": -1.0}, {"min_drift_ppm": 2.0, "max_drift_ppm": 1.0}]
)
def test_impossible_clocks_are_refused(clocks: dict):
    with pytest.raises(ValueError, match="Clocks"):
        SimulatedClocks(**clocks)
