"""A possible cause: what would have to be changed, were it the one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from fgpose.diagnosis.hypotheses.scene import CameraView, SynchronousViews
from fgpose.finding import Code


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What a scene would be without this cause."""

    code: Code
    cameras: tuple[int, ...]
    """Whose keypoints or poses it changes."""
    mend: Callable[[SynchronousViews], SynchronousViews]
    reason: str
    """What is the cause, for a sentence of its own; {cameras} stands for their names."""
    remedy: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    preference: int = 0
    """Of causes that explain a recording equally well, the one with the smallest is named: it is commoner."""
    of_many: bool = False
    """Whether it was chosen among so many that one of them nearly makes any two cameras agree."""

    def named(self, names: tuple[str, ...]) -> str:
        """Whom it is about."""
        return in_words(self.cameras, names)


Causes = tuple[Hypothesis, ...]
"""In the order in which they are put right."""


def mended(causes: Iterable[Hypothesis], scene: SynchronousViews) -> SynchronousViews:
    """What a scene would be without all of these causes."""
    for cause in causes:
        scene = cause.mend(scene)
    return scene


def in_words(cameras: Sequence[int], names: tuple[str, ...]) -> str:
    """Some of the cameras of these names, or all."""
    return "all cameras" if len(cameras) == len(names) > 1 else ", ".join(names[c] for c in cameras)


def each_view(
    change: Callable[[CameraView], CameraView], cameras: tuple[int, ...]
) -> Callable[[SynchronousViews], SynchronousViews]:
    """Change the views of some cameras, each by itself."""
    return lambda scene: scene.with_views({c: change(scene.views[c]) for c in cameras})


def with_sides_exchanged(scene: SynchronousViews, cameras: tuple[int, ...]) -> SynchronousViews:
    """Left joints for right ones in some views."""
    return scene.with_views({c: scene.views[c].joints(scene.mirror) for c in cameras})
