"""A picture of a skeleton that stands, seen from the front, as SVG."""

from __future__ import annotations

from html import escape

import numpy as np
from jaxtyping import Float

from fgpose.kinematics.proportions import standing
from fgpose.skeleton import Skeleton

# Only where to draw them: how far from the middle and how high, as shares of the stature. Feet are turned outwards.
_PLACES = {
    "head_top": (0.0, 1.0),
    "head": (0.0, 0.975),
    "neck_base": (0.0, 0.875),
    "nose": (0.0, 0.915),
    "eye_inner": (0.014, 0.938),
    "eye": (0.022, 0.938),
    "eye_outer": (0.03, 0.938),
    "ear": (0.05, 0.925),
    "mouth": (0.015, 0.89),
    "collar": (0.035, 0.8),
    "spine3": (0.0, 0.745),
    "spine2": (0.0, 0.665),
    "spine1": (0.0, 0.59),
    "hand": (0.115, 0.42),
    "hand_root": (0.105, 0.478),
    "thumb": (0.08, 0.43),
    "index": (0.1, 0.4),
    "pinky": (0.13, 0.415),
    "thumb_cmc": (0.09, 0.466),
    "thumb_mcp": (0.08, 0.447),
    "thumb_ip": (0.074, 0.43),
    "thumb_tip": (0.07, 0.415),
    "index_mcp": (0.095, 0.435),
    "index_pip": (0.092, 0.412),
    "index_dip": (0.091, 0.397),
    "index_tip": (0.09, 0.384),
    "middle_mcp": (0.107, 0.432),
    "middle_pip": (0.107, 0.407),
    "middle_dip": (0.107, 0.391),
    "middle_tip": (0.107, 0.377),
    "ring_mcp": (0.118, 0.434),
    "ring_pip": (0.121, 0.411),
    "ring_dip": (0.122, 0.396),
    "ring_tip": (0.123, 0.382),
    "pinky_mcp": (0.129, 0.439),
    "pinky_pip": (0.134, 0.421),
    "pinky_dip": (0.136, 0.41),
    "pinky_tip": (0.138, 0.399),
    "olecranon": (0.118, 0.632),
    "cubital_fossa": (0.093, 0.636),
    "acromion": (0.1, 0.84),
    "heel": (0.06, 0.005),
    "foot": (0.1, -0.02),
    "foot_index": (0.11, -0.03),
    "big_toe": (0.095, -0.035),
    "small_toe": (0.13, -0.02),
}
# Points of a face, twice as large as the face that they are in.
_OF_FACE = {
    "chin": (0.0, 0.793),
    "nose_base": (0.0, 0.887),
    "nose_tip": (0.0, 0.912),
    "upper_lip": (0.0, 0.862),
    "inner_upper_lip": (0.011, 0.856),
    "inner_lower_lip": (0.011, 0.852),
    "lower_lip": (0.0, 0.842),
    "nose_bridge_1": (0.0, 0.958),
    "nose_bridge_2": (0.0, 0.943),
    "nose_bridge_3": (0.0, 0.928),
    "jaw_1": (0.091, 0.944),
    "jaw_2": (0.089, 0.914),
    "jaw_3": (0.084, 0.886),
    "jaw_4": (0.075, 0.86),
    "jaw_5": (0.064, 0.837),
    "jaw_6": (0.05, 0.818),
    "jaw_7": (0.035, 0.804),
    "jaw_8": (0.018, 0.796),
    "brow_1": (0.062, 0.992),
    "brow_2": (0.05, 0.992),
    "brow_3": (0.039, 0.989),
    "brow_4": (0.028, 0.984),
    "brow_5": (0.016, 0.983),
    "nostril_1": (0.008, 0.891),
    "nostril_2": (0.016, 0.894),
    "eye_outer": (0.057, 0.96),
    "eye_inner": (0.023, 0.96),
    "pupil": (0.04, 0.963),
    "eye_upper_1": (0.047, 0.968),
    "eye_upper_2": (0.034, 0.968),
    "eye_lower_1": (0.047, 0.955),
    "eye_lower_2": (0.034, 0.955),
    "mouth_corner": (0.031, 0.855),
    "inner_mouth_corner": (0.025, 0.855),
    "upper_lip_1": (0.02, 0.861),
    "upper_lip_2": (0.009, 0.865),
    "lower_lip_1": (0.02, 0.847),
    "lower_lip_2": (0.009, 0.843),
}
_HEIGHT_PX, _WIDTH_PX, _MARGIN_PX, _LINE_PX = 900, 720, 60, 15
# Seen on light and on dark, and by the colour-blind (Okabe and Ito).
LEFT, RIGHT, MIDDLE = "#0072b2", "#d55e00", "#808890"


def skeleton_picture(skeleton: Skeleton) -> str:
    """Joints with their indices, which the names at both sides have too: left blue, right orange; bones of constant
    length solid, other lines dashed.

    Raises:
        ValueError: it has joints of other names than the built-in skeletons, whose places are not known.
    """
    places_px = _places_px(skeleton)
    shapes = [
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"{dash}/>'
        for pairs, dash in ((skeleton.bones, ""), (skeleton.lines, ' stroke-dasharray="4 5"'))
        for (x1, y1), (x2, y2) in (places_px[list(pair)] for pair in pairs)
    ]
    for number, (x, y) in enumerate(places_px):
        shapes += _joint(skeleton, number, float(x), float(y))
    shapes += _labels(skeleton, places_px)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH_PX} {_HEIGHT_PX}" font-family="sans-serif" '
        f'fill="{MIDDLE}">\n<title>{escape(skeleton.name)}</title>\n<desc>made by fgpose skeletons</desc>\n'
        f'<g stroke="{MIDDLE}" stroke-width="2" stroke-linecap="round">\n' + "\n".join(shapes) + "\n</g>\n</svg>\n"
    )


def _joint(skeleton: Skeleton, number: int, x: float, y: float) -> list[str]:
    """A dot, whose name browsers show under the mouse, and its number on the outer side, above lines across."""
    name = skeleton.joints[number]
    radius_px, font_px = (2, 3.5) if skeleton.part_names[number] else (5, 10)
    is_right = name.startswith("right_")
    colour = LEFT if name.startswith("left_") else RIGHT if is_right else MIDDLE
    beside_px, anchor = (-radius_px - 1.5, "end") if is_right else (radius_px + 1.5, "start")
    return [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius_px}" fill="{colour}">'
        f"<title>{number} {escape(name)}</title></circle>",
        f'<text x="{x + beside_px:.1f}" y="{y - 0.5 * radius_px:.1f}" text-anchor="{anchor}" stroke="none" '
        f'font-size="{font_px}" fill="{colour}">{number}</text>',
    ]


def _places_px(skeleton: Skeleton) -> Float[np.ndarray, "joint 2"]:
    with_face = _PLACES | _OF_FACE if "face" in skeleton.part_names else _PLACES
    places = np.array([standing(joint, with_face) for joint in skeleton.joints])
    unknown = [joint for joint, place in zip(skeleton.joints, places, strict=True) if np.isnan(place).any()]
    if unknown:
        raise ValueError(f"where to draw {', '.join(unknown)} of skeleton {skeleton.name} is not known")
    high_px = _HEIGHT_PX - 2 * _MARGIN_PX
    # Seen from the front, left is on the right.
    across_px = _WIDTH_PX / 2 + 1.6 * high_px * places[:, 0]
    return np.stack([across_px, _MARGIN_PX + high_px * (1 - places[:, 1]) / 1.04], axis=1)


def _labels(skeleton: Skeleton, places_px: Float[np.ndarray, "joint 2"]) -> list[str]:
    """Beside the body, each at the height of its joint or a line below the one before."""
    shapes = []
    for is_left, x_px, anchor in ((True, _WIDTH_PX - 10, "end"), (False, 10, "start")):
        side = [n for n, name in enumerate(skeleton.joints) if name.startswith("left_") == is_left]
        line_px = min(_LINE_PX, (_HEIGHT_PX - 2 * _MARGIN_PX) / max(len(side), 1))
        y_px = -np.inf
        for n in sorted(side, key=lambda n: places_px[n, 1]):
            y_px = max(float(places_px[n, 1]), y_px + line_px)
            shapes.append(
                f'<text x="{x_px}" y="{y_px + 4:.1f}" text-anchor="{anchor}" stroke="none" '
                f'font-size="{0.8 * line_px:.1f}">'
                f"{n} {escape(skeleton.joints[n])}</text>"
            )
    return shapes
