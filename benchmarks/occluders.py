"""Cut-outs pasted over the person in videos, by the rule of Human3.6M-Occluded.

That rule is for single images: of four views three are drawn; each gets two cut-outs, their short side a share from
0.5 to 1 of that of the person's box, their centre anywhere in it, clipped where the image ends. In a video an occluder
moves with the box, as in fgpose_benchmarks.synthetic, for as long as the rule says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.monocular.clips import Clip, ClipImage
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection_cache import ViewDetections
from fgpose.monocular.sources import Sources
from fgpose_benchmarks.human36m.cutouts import Cutout, Occluder
from fgpose_benchmarks.human36m.cutouts import load_cutouts as cutouts_in
from fgpose_benchmarks.synthetic import Occlusion

RULE = Occlusion()
"""Of the rule only the numbers about views, occluders, scales and durations are used."""

_FOLDER = Path(__file__).parent / "data" / "occluders"
# Landmarks lie inside the body: 3 % of a standing person's height is about 5 cm of flesh. As in synthetic.
_BOX_MARGIN = 0.03


def load_cutouts() -> list[Cutout]:
    """Those that come with the benchmark, by name."""
    return list(cutouts_in(_FOLDER).values())


@dataclass(frozen=True)
class Period:
    """A while during which the occluders stay."""

    end_s: float
    occluders: tuple[tuple[Occluder, ...], ...]
    """Of every camera; none where its view was not drawn."""


def draw_periods(
    rng: np.random.Generator, duration_s: float, n_cameras: int, cutouts: Sequence[Cutout], rule: Occlusion = RULE
) -> list[Period]:
    """Occluders for a recording of this length."""
    periods: list[Period] = []
    end_s = 0.0
    while end_s < duration_s:
        end_s += rng.uniform(rule.min_duration_s, rule.max_duration_s)
        drawn = rng.permutation(n_cameras) < rule.n_views
        occluders = [
            tuple(
                Occluder(
                    cutouts[int(rng.integers(len(cutouts)))], rng.uniform(rule.min_scale, rule.max_scale), rng.random(2)
                )
                for _ in range(rule.n_occluders if is_drawn else 0)
            )
            for is_drawn in drawn
        ]
        periods.append(Period(end_s, tuple(occluders)))
    return periods


@dataclass(frozen=True, kw_only=True, eq=False)
class OccludedClip(Clip):
    """A clip with occluders pasted into its images."""

    occluders: tuple[tuple[Occluder, ...], ...]
    """In each image."""
    boxes_px: Float[np.ndarray, "image 4"]
    """The person's box in each image: left, top, width, height."""

    def pictures(self, start: int = 0) -> Iterator[ClipImage]:
        for picture in super().pictures(start):
            image = picture.image
            for occluder in self.occluders[picture.number]:
                image = occluder.pasted(image, self.boxes_px[picture.number])
            yield picture._replace(image=image)


def occluded(detected: Detected, seed: int, cutouts: Sequence[Cutout], rule: Occlusion = RULE) -> Sources:
    """The videos with occluders over the most confident person whom a network found in them before."""
    clips = detected.sources.clips
    rng = np.random.default_rng(seed)
    periods = draw_periods(rng, max(clip.end_s for clip in clips), len(clips), cutouts, rule)
    ends_s = np.array([period.end_s for period in periods])
    occluded_clips = []
    for c, (clip, view) in enumerate(zip(clips, detected.views, strict=True)):
        index = np.searchsorted(ends_s, clip.times_s(view.stamps_s), side="right")
        occluders = tuple(periods[i].occluders[c] for i in index)
        occluded_clips.append(OccludedClip(**vars(clip), occluders=occluders, boxes_px=person_boxes_px(view)))
    return Sources(detected.rig, tuple(occluded_clips))


def person_boxes_px(view: ViewDetections) -> Float[np.ndarray, "image 4"]:
    """Left, top, width and height of the box around the most confident person and some flesh, in each image; where
    nobody is found, that of the nearest image with somebody."""
    people = view.unstacked()
    seen = np.array([number for number, each in enumerate(people) if each.n_people])
    boxes_px = np.array([people[number].boxes[0, :4] for number in seen], dtype=float)
    margin_px = _BOX_MARGIN * boxes_px[:, 2:].max(axis=1, keepdims=True)
    boxes_px += np.concatenate([-margin_px, -margin_px, 2 * margin_px, 2 * margin_px], axis=1)
    nearest = np.abs(np.arange(len(people))[:, None] - seen).argmin(axis=1)
    return boxes_px[nearest]
