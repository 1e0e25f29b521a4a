"""Rerun files read back without a viewer, and cameras to make them with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fgpose.geometry.camera import Camera

# What is logged in single precision differs by 2^-24 of its size: 1e-3 px of 2000, 1e-6 m of 10.
PIXEL_TOLERANCE = 1e-3
METRE_TOLERANCE = 1e-6


def camera(name: str, x_m: float) -> Camera:
    """A camera at (x, -4, 1) that looks along the world's y axis, z up, with a visible lens distortion."""
    K = np.array([[900.0, 0, 320], [0, 880.0, 240], [0, 0, 1]])
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return Camera.from_world_to_camera(name, (640, 480), K, R, -R @ np.array([x_m, -4.0, 1.0]), (-0.1, 0.02, 0.0, 0.0))


def entities(path: Path) -> set[str]:
    """Those that show something in some frame. What is static, the look of an entity, is there without any data."""
    from rerun.chunk import RrdReader

    chunks = RrdReader(path).stream().to_chunks()
    return {str(chunk.entity_path) for chunk in chunks if "frame" in chunk.to_record_batch().schema.names}


def rows(path: Path, entity: str, component: str) -> dict[int, tuple[float, Any]]:
    """By frame: time in seconds and the component's values."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream().filter(content=entity).to_chunks():
        batch = chunk.to_record_batch()
        if "frame" not in batch.schema.names or component not in batch.schema.names:
            continue
        times = batch["time"].cast("int64").to_pylist()
        for frame, nanoseconds, value in zip(
            batch["frame"].to_pylist(), times, batch[component].to_pylist(), strict=True
        ):
            if value is not None:
                found[frame] = (nanoseconds / 1e9, value)
    return found


def values(path: Path, entity: str, component: str) -> list[np.ndarray]:
    """The component's values in every frame, in order."""
    found = rows(path, entity, component)
    return [np.array(found[frame][1]) for frame in sorted(found)]


def static_value(path: Path, entity: str, component: str) -> Any:
    return static_values(path, entity, component)[0]


def static_values(path: Path, entity: str, component: str) -> list[Any]:
    """As they were logged last."""
    from rerun.chunk import RrdReader

    found = [
        row
        for chunk in RrdReader(path).stream().filter(content=entity).to_chunks()
        if component in (batch := chunk.to_record_batch()).schema.names
        for row in zip(batch.column(0).to_pylist(), batch[component].to_pylist(), strict=True)
    ]
    assert found, f"{entity} has no {component}"
    # The first column counts what is logged.
    return max(found, key=lambda row: row[0])[1]


def layout_value(path: Path, component: str) -> Any:
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    batches = (chunk.to_record_batch() for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks())
    return next(batch[component].to_pylist()[0][0] for batch in batches if component in batch.schema.names)


def view_contents(path: Path) -> list[tuple[str, list[str]]]:
    """Of each view of the layout: the path of its root, and what it shows of it."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    found: dict[str, dict[str, Any]] = {}
    for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
        batch = chunk.to_record_batch()
        view = str(chunk.entity_path).removeprefix("/").split("/")[1:2]
        for component in ("ViewBlueprint:space_origin", "ViewContents:query"):
            if view and component in batch.schema.names:
                found.setdefault(view[0], {})[component] = batch[component].to_pylist()[0]
    return [
        (each["ViewBlueprint:space_origin"][0].removeprefix("/"), each["ViewContents:query"]) for each in found.values()
    ]


def view_origins(path: Path) -> dict[str, set[str]]:
    """Paths of the roots of the views in the layout, by kind of view."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    origins: dict[str, set[str]] = {}
    for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
        batch = chunk.to_record_batch()
        if "ViewBlueprint:class_identifier" in batch.schema.names:
            kinds, at = batch["ViewBlueprint:class_identifier"], batch["ViewBlueprint:space_origin"]
            for (kind,), (where,) in zip(kinds.to_pylist(), at.to_pylist(), strict=True):
                origins.setdefault(kind, set()).add("/" + where.removeprefix("/"))
    return origins
