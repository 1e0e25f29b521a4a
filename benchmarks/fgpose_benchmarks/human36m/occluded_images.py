"""The images of Human3.6M-Occluded: objects pasted over the person in three of four views.

The rule is that of the generator that the authors of the paper published (Bragagnolo et al., 2024,
human3.6m-occluded), drawn in the same order from Python's generator with the same seed: per sampled frame three of the
four views; in each two cut-outs, their short side U(0.5, 1) x the short side of the person's box, their centre uniform
in the box; alpha-pasted and clipped. With the same boxes, cut-outs and order of frames, occluders are the same. Pixels
differ at their rims, where this one blends premultiplied colours, and by up to a pixel from the rounding of the corner.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_bytes, write_text
from fgpose_benchmarks.human36m.cutouts import Cutout, Occluder, read_image
from fgpose_benchmarks.human36m.labels import PoseSequence, image_path
from fgpose_benchmarks.human36m.protocol import STEP, scored_frames

# These four numbers (_SCALES is a range) are those of the authors' generator, see the head of this file.
SEED = 42
DESCRIPTION = "occluders.json"
_N_VIEWS = 3
_N_OCCLUDERS = 2
_SCALES = (0.5, 1.0)

Boxes = Literal["joints", "labels"]


@dataclass(frozen=True, eq=False)
class OccludedView:
    """One camera's image of a frame."""

    image: Path
    box_px: Float[np.ndarray, " 4"]
    """Left, top, width and height of the person's box."""
    name: str
    """Path of the result below the output folder."""


@dataclass(frozen=True, eq=False)
class _Placed:
    cutout: str
    occluder: Occluder

    def described(self, box_px: np.ndarray) -> dict[str, Any]:
        centre_px = box_px[:2] + self.occluder.centre * box_px[2:]
        return {"cutout": self.cutout, "scale": self.occluder.scale, "centre_px": centre_px.tolist()}


def generate(
    frames: Sequence[Sequence[OccludedView]],
    cutouts: Mapping[str, Cutout],
    output: str | Path,
    seed: int = SEED,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write the images of these frames with occluders over the person.

    Of every frame three views are occluded, all if it has fewer; the others are copied as they are.

    Args:
        frames: the views of each, see protocol_frames.
        cutouts: by name, see load_cutouts.
        output: folder for the images and for occluders.json, which says what was pasted where.
        seed: of all draws; the authors' is 42.
        progress: called with the number of frames done and of all.

    Returns:
        Path of occluders.json, which is written last.

    Raises:
        ValueError: there is no frame or cut-out, a box is empty, an image is missing or damaged, two images would get
            one name, or one would be overwritten.
        OSError: a file cannot be read or written.
    """
    output = Path(output)
    if not cutouts:
        raise ValueError("there is no cut-out to paste")
    _check(frames, output)
    rng = random.Random(seed)
    described = []
    for number, views in enumerate(frames):
        placed = _draw(rng, len(views), cutouts)
        for view, occluders in zip(views, placed, strict=True):
            _write(view, occluders, output / view.name)
        described.append([_described(view, occluders) for view, occluders in zip(views, placed, strict=True)])
        progress(number + 1, len(frames))
    path = output / DESCRIPTION
    write_text(path, json.dumps({"seed": seed, "frames": described}, indent=1))
    return path


def protocol_frames(
    sequences: Iterable[PoseSequence], images: str | Path, boxes: Boxes = "joints", step: int = STEP
) -> list[list[OccludedView]]:
    """The views of the frames that the protocol scores, in the order of the sequences; views that are missing left out.

    Args:
        sequences: see load_labels and load_annotations.
        images: folder with SUBJECT/ACTION/imageSequence/CAMERA/img_000001.jpg, as h36m-fetch extracts them.
        boxes: joints: around the joints and some flesh. labels: those of the labels, which Learnable Triangulation
            made squares, so that occluders become two to three times as large.
        step: every so many frames.
    """
    frames = []
    for sequence in sequences:
        boxes_px = sequence.joint_boxes_px() if boxes == "joints" else sequence.boxes_px
        for index in scored_frames(sequence.frames, step).tolist():
            views = []
            for c, camera in enumerate(sequence.rig.names):
                if sequence.has_view[index, c]:
                    path = image_path(Path(images), sequence, camera, int(sequence.frames[index]))
                    views.append(OccludedView(path, boxes_px[index, c], path.relative_to(images).as_posix()))
            frames.append(views)
    return frames


def _check(frames: Sequence[Sequence[OccludedView]], output: Path) -> None:
    views = [view for views in frames for view in views]
    if not views:
        raise ValueError("there is no image to occlude")
    missing = [view.image for view in views if not view.image.is_file()]
    if missing:
        raise ValueError(f"{len(missing)} of {len(views)} images are missing, the first is {missing[0]}")
    for view in views:
        if not (np.isfinite(view.box_px).all() and np.all(view.box_px[2:] > 0)):
            raise ValueError(f"{view.image}: the box of the person is empty: {view.box_px.tolist()}")
    targets = {(output / view.name).resolve() for view in views}
    if len(targets) < len(views):
        raise ValueError("two images have one name in the output folder")
    if targets & {view.image.resolve() for view in views}:
        raise ValueError(f"{output}: the images themselves are there; choose another output folder")


def _draw(rng: random.Random, n_views: int, cutouts: Mapping[str, Cutout]) -> list[list[_Placed]]:
    """Occluders of every view of a frame, in the order of the authors' draws."""
    names = list(cutouts)
    placed: list[list[_Placed]] = [[] for _ in range(n_views)]
    for view in rng.sample(range(n_views), min(_N_VIEWS, n_views)):
        for _ in range(_N_OCCLUDERS):
            name, scale = rng.choice(names), rng.uniform(*_SCALES)
            centre = np.array([rng.random(), rng.random()])
            placed[view].append(_Placed(name, Occluder(cutouts[name], scale, centre)))
    return placed


def _write(view: OccludedView, placed: Sequence[_Placed], path: Path) -> None:
    if not placed:
        write_bytes(path, view.image.read_bytes())
        return
    image = read_image(view.image)
    for each in placed:
        image = each.occluder.pasted(image, view.box_px)
    # By its extension; JPEG with OpenCV's own quality of 95, as the authors do.
    encoded, content = cv2.imencode(path.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not encoded:
        raise OSError(f"{path}: the image could not be written")
    write_bytes(path, content.tobytes())


def _described(view: OccludedView, placed: Sequence[_Placed]) -> dict[str, Any]:
    return {
        "image": view.name,
        "box_px": view.box_px.tolist(),
        "occluders": [each.described(view.box_px) for each in placed],
    }
