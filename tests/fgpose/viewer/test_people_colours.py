"""The colours by which people are told apart."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from rrd_contents import rows, static_value
from shown_people import CAMERAS, LEFT_ELBOW, SECOND, SHOWN, SKELETON, class_colours, classes, packed

from fgpose.viewer.rerun import palette

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")


def test_the_same_colour_everywhere(file: Path) -> None:
    colour, pale = (packed(each(palette.person_colour(SECOND))) for each in (lambda same: same, palette.faded))
    name = f"person_{SECOND}"
    of_class = class_colours(file)
    joints = static_value(file, f"/world/{name}/joints", "Points3D:class_ids")
    assert of_class[joints] == colour
    for camera_name in CAMERAS:
        reprojections = f"/world/camera/{camera_name}/image/reprojections/{name}"
        assert of_class[static_value(file, reprojections, "Points2D:class_ids")] == colour
    assert static_value(file, f"/plots/reprojection_px/{name}", "SeriesLines:colors") == colour
    assert static_value(file, f"/tracks/{name}", "StateConfiguration:colors") == colour
    # Names are white, to be read on the boxes of the light theme too.
    assert static_value(file, f"/world/{name}/label", "Points3D:colors") == packed(palette.TEXT)
    # In the last frame the elbow is predicted, and paler and thinner are its joint and its bones.
    predicted = np.arange(SKELETON.n_joints) == LEFT_ELBOW
    colours, radii = (rows(file, f"/world/{name}/joints", f"Points3D:{what}")[8][1] for what in ("colors", "radii"))
    assert colours == np.where(predicted, pale, colour).tolist()
    assert np.array(radii)[predicted].max() < np.array(radii)[~predicted].min()
    bones = rows(file, f"/world/{name}/bones", "LineStrips3D:colors")[8][1]
    assert bones == [pale if LEFT_ELBOW in bone else colour for bone in (*SKELETON.bones, *SKELETON.lines)]


def test_bones_join_what_was_estimated_and_not_what_was_detected(file: Path) -> None:
    known = classes(file)
    reprojected = static_value(file, SHOWN[-1][0], "Points2D:class_ids")
    assert len(known[reprojected]["keypoint_connections"]) == len((*SKELETON.bones, *SKELETON.lines))
    detected = rows(file, "/world/camera/cam_2/image/detections", "Points2D:class_ids")[2][1]
    assert len(set(detected)) == 3
    assert not any(known[number]["keypoint_connections"] for number in detected)


# Linear RGB as people without the long, middle or short cones see it (Machado, Oliveira and Fernandes, 2009, severity
# 1), and as others do.
VISION = {
    "trichromat": np.eye(3),
    "protanope": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranope": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanope": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


@pytest.mark.parametrize("vision", VISION)
def test_eight_people_and_nobody_can_be_told_apart_by_colour(vision: str) -> None:
    colours = [palette.person_colour(person) for person in range(8)] + [palette.NOBODY, palette.BACKGROUND]
    srgb = np.array(colours) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ VISION[vision].T, 0, 1).astype(np.float32)
    lab = cv2.cvtColor(seen[None], cv2.COLOR_LRGB2Lab)[0]
    # Two patches side by side differ visibly from 2.3 on (Mahy et al., 1994); small points need much more.
    assert min(np.linalg.norm(a - b) for a, b in combinations(lab, 2)) > 15
    assert [palette.person_colour(person + 8) for person in range(8)] == colours[:8]
