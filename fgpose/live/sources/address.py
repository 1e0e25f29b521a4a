"""Where images come from: devices, URLs, files, and how they are shown to people."""

from __future__ import annotations

import os
import re
from typing import Literal
from urllib.parse import urlsplit

Kind = Literal["device", "url", "folder", "file", "zmq"]

_PREFIX = "FGPOSE_"
# rtsp:/user:password@host, rtsp//..., rtsp:user..., and a file with an @, for it may be user:password@host.
_MISTYPED = re.compile(r"(?:rtsps?|rtps?|https?|rtmps?|udp|tcp|srt)\b[:/]+|(?=[^/]*:[^/]*@)", re.IGNORECASE)
_VARIABLE = re.compile(r"\$\{(\w+)\}")


def kind_of(source: str) -> Kind:
    """What sort of source this is. A path that does not exist is a file, which then cannot be opened."""
    if source == "zmq":
        return "zmq"
    if "://" in source:
        return "url"
    if source.startswith("/dev/video") or source.isdecimal():
        return "device"
    return "folder" if os.path.isdir(source) else "file"


def without_password(source: str) -> str:
    """The source without user, password, path and query: cameras want passwords in any of them. Of what looks like a
    mistyped address with one there is nothing but its beginning."""
    if "://" not in source:
        scheme = _MISTYPED.match(source)
        return f"{scheme[0]}..." if scheme else source
    try:
        parts = urlsplit(source)
        host, port = parts.hostname or "", f":{parts.port}" if parts.port else ""
    except ValueError:
        return f"{source.partition('://')[0]}://..."
    rest = source.partition("://")[2].removeprefix(parts.netloc)
    if "@" in rest:
        # A password with a character that should be escaped: what looks like the host is a part of it.
        return f"{parts.scheme}://..."
    return f"{parts.scheme}://{host}{port}{'/...' if rest.strip('/') else ''}"


def with_environment(source: str) -> str:
    """The source with ``${NAME}`` replaced by what the environment variable holds, so that no file has a password.

    The file may be somebody else's, who could have any variable sent to a host of his: names begin with ``FGPOSE_``.

    Raises:
        ValueError: a variable is not set, or has another name.
    """

    def value(match: re.Match[str]) -> str:
        if not match[1].startswith(_PREFIX):
            raise ValueError(
                f"${{{match[1]}}}: only environment variables whose names begin with {_PREFIX} are sent to a camera; "
                f"call it {_PREFIX}{match[1]}"
            )
        try:
            return os.environ[match[1]]
        except KeyError:
            raise ValueError(f"the environment variable {match[1]} is not set") from None

    return _VARIABLE.sub(value, source)
