"""The rays of a recording with some changes undone, second by second: what looks for another change goes by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from fgpose.calibration.changes.change import Change
from fgpose.calibration.changes.lag_costs import Blocks, LagCosts, blocks_of, lag_costs
from fgpose.calibration.changes.rays import Rays, grid_step_s, rays_of
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

MAX_LAG_S = 1.5
"""Of one camera behind another that is looked for; what is found may be more."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What cameras saw, on top of changes."""

    people: Sequence[Observations]
    rig: CameraRig
    step_s: float
    """Of the images."""
    changes: tuple[Change, ...]
    rays: Rays
    blocks: Blocks
    _scale: dict[tuple[int, int], float] = field(default_factory=dict, repr=False)
    """Kept of the costs, which are large."""

    @staticmethod
    def of(people: Sequence[Observations], rig: CameraRig, step_s: float, changes: Sequence[Change] = ()) -> Comparison:
        rays = _rays_of(people, rig, changes)
        return Comparison(people, rig, step_s, tuple(changes), rays, blocks_of(rays, rays.direction.shape[2]))

    def beside(self, *more: Change) -> Comparison:
        """The same times on top of more changes."""
        changes = (*self.changes, *more)
        return replace(self, changes=changes, rays=_rays_of(self.people, self.rig, changes), _scale={})

    def costs(self, of_camera: int | None = None) -> LagCosts:
        """Of all pairs of cameras, or of those of one."""
        found = lag_costs(self.rays, self.blocks, _n_lags(self.rays.step_s), of_camera)
        self._scale.update(found.scale)
        return found

    def scale(self) -> dict[tuple[int, int], float]:
        """LagCosts.scale of all pairs."""
        n_pairs = self.rig.n_cameras * (self.rig.n_cameras - 1) // 2
        return self._scale if len(self._scale) == n_pairs else self.costs().scale


def _rays_of(people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change]) -> Rays:
    """Of everybody, with changes undone and room for all lags."""
    hand_back()
    grid_s = grid_step_s(people)
    return rays_of(people, rig, changes, grid_s, _n_lags(grid_s))


def _n_lags(step_s: float) -> int:
    """How many steps of the grid a camera may be behind another."""
    return round(MAX_LAG_S / step_s)
