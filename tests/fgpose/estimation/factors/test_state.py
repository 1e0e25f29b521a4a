"""The information matrix in linkages: the same numbers as one of all joints, and nothing between two."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.factors.state import Information

N_FRAMES, N_SLOTS, N_KINDS = 3, 5, 2
LINKAGES = (np.array([3, 0]), np.array([1, 2, 4]))


def nothing(linkages: tuple[np.ndarray, ...]) -> Information:
    frames = [np.zeros((N_FRAMES, *2 * (len(slots), 3, N_KINDS))) for slots in linkages]
    return Information(linkages, frames, 0)


def filled(linkages: tuple[np.ndarray, ...]) -> Information:
    """Something of every kind."""
    information, rng = nothing(linkages), np.random.default_rng(0)
    information.single_positions[:] += rng.normal(size=(N_FRAMES, N_SLOTS, 3, 3))
    information.single_axes[1:] += rng.normal(size=(N_FRAMES - 1, N_KINDS, N_KINDS, N_SLOTS, 1))
    information.single_unknowns[:] += rng.normal(size=(N_FRAMES, N_KINDS, N_SLOTS, 3))
    rows = np.array([0, 1]), np.array([3, 4])
    information.add_rows(rows, [rng.normal(size=(N_FRAMES, 2, 3)) for _ in rows])
    at = np.array([0, 2, 2]), np.array([0, 1, 4]), np.array([3, 2, 1])
    information.add_between_velocities(*at, rng.normal(size=3))
    information.spread()
    return information


def test_linkages_are_blocks_of_the_matrix_of_all_joints() -> None:
    (whole,) = filled((np.arange(N_SLOTS),)).frames
    for slots, frames in zip(LINKAGES, filled(LINKAGES).frames, strict=True):
        np.testing.assert_array_equal(frames, whole[:, slots][:, :, :, :, slots])
    first, second = LINKAGES
    assert not whole[:, first][:, :, :, :, second].any(), "no row joins the two"


def test_what_is_spread_is_not_spread_again() -> None:
    information = filled(LINKAGES)
    before = [frames.copy() for frames in information.frames]
    information.spread()
    for frames, as_before in zip(information.frames, before, strict=True):
        np.testing.assert_array_equal(frames, as_before)


def test_a_factor_that_joins_two_linkages_is_an_error() -> None:
    """It would be added in the place of other joints."""
    with pytest.raises(ValueError, match="two linkages"):
        nothing(LINKAGES).add_between_positions(np.array([0]), np.array([1]), np.ones((N_FRAMES, 1, 3, 3)))
