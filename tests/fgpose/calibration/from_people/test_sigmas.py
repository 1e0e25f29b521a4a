from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjusted_rigs import moved

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.verdict.alignment import aligned
from fgpose.calibration.from_people.verdict.sigmas import RigEstimate, camera_sigmas, disagreement
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(4)
NONE = np.zeros(4)


def covariance_of(scale: float = 1.0) -> np.ndarray:
    """(4, 6, 4, 6) in which rotation and position of a camera are correlated, as those of a camera that keeps the
    person in its image are: 20 mm and 0.25 degrees."""
    one = np.diag(np.repeat([0.004, 0.02], 3) ** 2)
    one[0, 4] = one[4, 0] = 0.9 * 0.004 * 0.02
    one[1, 3] = one[3, 1] = -0.9 * 0.004 * 0.02
    return scale * np.einsum("cd,ij->cidj", np.eye(4), one)


def estimate(rng: np.random.Generator, stated: np.ndarray, true_sigmas: float) -> RigEstimate:
    """With errors that are so many times what the covariance states."""
    root = np.linalg.cholesky(stated.reshape(24, 24))
    errors = true_sigmas * (root @ rng.standard_normal(24)).reshape(4, 6)
    return RigEstimate(moved(RIG, errors), stated, NONE, NONE)


def sigmas_of(rng: np.random.Generator, true_sigmas: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of position and rotation, as shares of what is stated."""
    whole = estimate(rng, covariance_of(), true_sigmas)
    halves = estimate(rng, covariance_of(2.0), true_sigmas), estimate(rng, covariance_of(2.0), true_sigmas)
    sigmas = camera_sigmas(whole, halves, 0.01, 0.5, 0.01)
    left = aligned(whole.rig, RIG)[1]
    position, rotation = np.linalg.norm(left[:, 3:], axis=1), np.rad2deg(np.linalg.norm(left[:, :3], axis=1))
    return position / sigmas.position_m, rotation / sigmas.direction_deg


@pytest.mark.slow
@pytest.mark.parametrize("true_sigmas", [1.0, 10.0])
def test_nine_errors_of_ten_are_within_two_sigmas(true_sigmas: float) -> None:
    rng = np.random.default_rng(0)
    shares = np.concatenate([np.concatenate(sigmas_of(rng, true_sigmas)) for _ in range(40)])
    assert np.mean(shares < 2) > 0.9
    assert 0.4 < np.median(shares) < 1.2  # and they are not simply large; 0.9 of independent errors in three axes


def test_what_the_halves_do_not_show_is_not_inflated() -> None:
    stated = RigEstimate(RIG, covariance_of(), NONE, NONE)
    same = camera_sigmas(stated, (stated, stated), 0.01, 0.5, 0.02)
    assert same.position_m == pytest.approx(np.sqrt(stated.variances().position_m2))
    # What no halves check is not believed.
    assert (camera_sigmas(stated, None, 0.01, 0.5, 0.02).position_m > 1.5 * same.position_m).all()
    assert (same.scale, same.vertical_deg, same.floor_m) == (0.01, 0.5, 0.02)


def test_halves_that_share_their_errors_check_nothing() -> None:
    """Of somebody who stays in one place."""
    stated = RigEstimate(RIG, covariance_of(), NONE, NONE)
    one_place = np.arange(RIG.n_cameras) == 1
    same = camera_sigmas(stated, (stated, stated), 0.01, 0.5, 0.02)
    unchecked = camera_sigmas(stated, (stated, stated), 0.01, 0.5, 0.02, None, one_place)
    as_without_halves = camera_sigmas(stated, None, 0.01, 0.5, 0.02)
    assert unchecked.direction_deg[1] == pytest.approx(as_without_halves.direction_deg[1])
    assert unchecked.direction_deg[~one_place] == pytest.approx(same.direction_deg[~one_place])


def test_the_gauge_of_the_halves_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    whole, first, second = (estimate(rng, covariance_of(), 5.0) for _ in range(3))
    other = Similarity(3.0, np.eye(3)[[1, 2, 0]], np.array([1.0, 2.0, 3.0]))
    one = camera_sigmas(whole, (first, second), 0.01, 0.5, 0.02)
    two = camera_sigmas(whole, (first.moved(other), second), 0.01, 0.5, 0.02)
    assert two.position_m == pytest.approx(one.position_m, rel=1e-6)
    assert two.direction_deg == pytest.approx(one.direction_deg, rel=1e-6)


def test_a_camera_that_disagrees_alone_is_less_certain_than_the_others() -> None:
    bumped = np.zeros((4, 6))
    bumped[2, 3:] = 0.2
    stated = RigEstimate(RIG, covariance_of(), NONE, NONE)
    sigmas = camera_sigmas(
        stated, (stated, RigEstimate(moved(RIG, bumped), covariance_of(), NONE, NONE)), 0.0, 0.0, 0.0
    )
    assert sigmas.position_m.argmax() == 2


def test_focal_lengths_and_clocks_disagree_as_well() -> None:
    focal_sigma, offset_sigma_s = np.array([0.01, 0.01, 0.01, 0.0]), np.array([0.0, 0.002, 0.002, 0.002])
    stated = RigEstimate(RIG, covariance_of(), focal_sigma, offset_sigma_s)
    late = RIG.with_time_offsets(np.array([0.0, 0.03, 0.0, 0.0]))
    longer = CameraRig(tuple(with_focal(camera, 1.1) for camera in RIG.cameras))
    sigmas = camera_sigmas(
        stated,
        (
            RigEstimate(late, covariance_of(), focal_sigma, offset_sigma_s),
            RigEstimate(longer, covariance_of(), focal_sigma, offset_sigma_s),
        ),
        0.0,
        0.0,
        0.0,
    )
    assert (sigmas.focal[:3] > 0.03).all()
    assert sigmas.focal[3] == 0  # given
    assert sigmas.offset_s.argmax() == 1
    assert sigmas.offset_s[0] == 0


def test_focal_lengths_that_halves_have_alike_and_the_whole_has_not_are_uncertain() -> None:
    """All that are unknown: one that is the same by chance is known no better."""
    focal_sigma = np.array([0.01, 0.01, 0.01, 0.0])
    stated = RigEstimate(RIG, covariance_of(), focal_sigma, NONE)
    ratios = (1.06, 0.96, 1.0, 1.0)
    other = CameraRig(tuple(with_focal(*pair) for pair in zip(RIG.cameras, ratios, strict=True)))
    half = replace(stated, rig=other)
    common = np.sqrt(np.mean(np.log(ratios[:3]) ** 2))
    sigmas = camera_sigmas(stated, (half, half), 0.0, 0.0, 0.0)
    assert sigmas.focal == pytest.approx([*3 * [np.hypot(0.01, common)], 0.0])


def test_the_walker_is_off_as_the_cameras_are() -> None:
    """The floor is below the walker; two sigmas more of the places of the cameras are two more of that."""
    stated = RigEstimate(RIG, covariance_of(), NONE, NONE)
    alone = camera_sigmas(stated, None, 0.0, 0.0, 0.02)
    both = camera_sigmas(stated, None, 0.0, 0.0, 0.02, walker_m=0.03)
    growth = np.sqrt(np.mean(alone.position_m**2) / np.mean(stated.variances().position_m2))
    assert growth > 1.5
    assert both.floor_m == pytest.approx(np.hypot(0.02, growth * 0.03))


def with_focal(camera: Camera, ratio: float) -> Camera:
    return replace(camera, K=camera.K * np.array([[ratio, 1, 1], [1, ratio, 1], [1, 1, 1]]))


def test_how_far_two_rigs_are_apart() -> None:
    errors = np.zeros((4, 6))
    errors[1, 2] = 0.02  # one camera of four, turned about its axis: the others take a share of it
    apart = disagreement(RIG, moved(RIG, errors))
    assert np.sqrt(apart.rotation_rad2[1]) == pytest.approx(0.02, rel=0.3)
    assert apart.rotation_rad2.argmax() == 1


def test_the_unknowns_of_an_adjustment() -> None:
    unknowns = np.einsum("cd,ij->cidj", np.eye(4), np.diag(np.arange(9.0) ** 2))
    found = RigEstimate.of(RIG, unknowns, focal=6, offset=8)
    assert found.covariance.shape == (4, 6, 4, 6)
    assert found.focal_sigma == pytest.approx(6.0)
    assert found.offset_sigma_s == pytest.approx(8.0)


def test_another_unit_changes_translations_alone() -> None:
    half = RigEstimate(RIG, covariance_of(), NONE, NONE).moved(Similarity(0.5, np.eye(3), np.zeros(3)))
    of_camera = covariance_of()[0, :, 0]
    assert half.covariance[0, :3, 0, :3] == pytest.approx(of_camera[:3, :3])
    assert half.covariance[0, :3, 0, 3:] == pytest.approx(of_camera[:3, 3:] / 2)
    assert half.covariance[0, 3:, 0, 3:] == pytest.approx(of_camera[3:, 3:] / 4)
    assert half.rig.cameras[1].position_m == pytest.approx(RIG.cameras[1].position_m / 2)
