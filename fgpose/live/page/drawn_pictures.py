"""Small pictures with people drawn into them."""

from __future__ import annotations

from fgpose.geometry.camera import Camera
from fgpose.live.pictures_with_people import PictureWithPeople
from fgpose.overlay.drawing import Drawing, Pose

_SIZE_PX = 480  # the longer side
_JPEG_QUALITY = 70


def drawn_jpeg(picture: PictureWithPeople, camera: Camera, drawing: Drawing) -> bytes:
    """A JPEG of a picture, at most 480 pixels wide and high, with its people."""
    import cv2

    height, width = picture.image_rgb.shape[:2]
    scale = min(1.0, _SIZE_PX / max(height, width))
    size_px = max(1, round(scale * width)), max(1, round(scale * height))
    small = cv2.resize(picture.image_rgb, size_px, interpolation=cv2.INTER_AREA)
    for person in picture.people:
        pose = Pose(person.person, person.positions_m, person.status, None)
        drawing.add(small, camera, pose, size_px[0] / camera.size_px[0])
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
