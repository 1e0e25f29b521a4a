"""Calibrations in XML: Qualisys' .qca.txt and Vicon's .xcp, told apart by their root."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from fgpose.io.calibration import qualisys, vicon
from fgpose.io.calibration.calibrated_view import CalibratedView


def is_xml(content: bytes) -> bool:
    """By its beginning."""
    return content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<") or content.startswith(
        (b"\xff\xfe<", b"\xfe\xff\x00<")
    )


def read(content: bytes) -> list[CalibratedView]:
    """Video cameras of the file in natural order of their serial, translations in millimetres.

    Raises:
        ValueError: the XML is damaged, is of neither program, has no cameras, or lacks a value of one; the message
            names it.
    """
    try:
        root = ElementTree.fromstring(content)
    # LookupError: the header names an encoding that does not exist.
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"not a Qualisys or Vicon calibration, or a truncated one: {error}") from None
    return vicon.read(root) if root.tag.lower() == "cameras" else qualisys.read(root)
