"""What of the study file a step depends on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fgpose.study import Plan, load_study
from fgpose.study.chain import fingerprints
from fgpose.study.job import Job

OTHERS: dict[str, Any] = {
    "cameras": ("ring_0", "ring_1"),
    "fps": 25.0,
    "unit": "mm",
    "points3d_frame": "world",
    "points3d_unit": "m",
    "min_confidence": 0.7,
}


def changed(file: Path, kind: Any, **settings: Any) -> set[str]:
    """The steps of a recording of this kind that settings of its data change."""
    study = load_study(file)
    recording = replace(next(iter(Plan(study))), kind=kind)
    before = fingerprints(study, recording, {})
    after = fingerprints(replace(study, data=replace(study.data, **settings)), recording, {})
    return {name for name in before if before[name] != after[name]}


def test_all_that_keypoints_are_read_with(study_file: Path, tmp_path: Path) -> None:
    study = load_study(study_file)
    assert Job(study, next(iter(Plan(study))), tmp_path).reading.keys() == OTHERS.keys()


@pytest.mark.parametrize("setting", [*OTHERS, "skeleton"])
def test_a_motion_depends_on_how_its_keypoints_are_read(study_file: Path, setting: str) -> None:
    assert changed(study_file, "keypoints", **{setting: OTHERS.get(setting, "coco_17")}) == {"estimate", "judge"}


def test_nothing_is_detected_again_for_what_is_read_of_it(study_file: Path) -> None:
    """A network takes hours for what the estimate takes minutes for."""
    assert changed(study_file, "videos", min_confidence=0.7) == {"estimate", "judge"}
    assert "detect" in changed(study_file, "videos", fps=25.0)
