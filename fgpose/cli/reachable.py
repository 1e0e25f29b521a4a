"""A warning where other computers are let in."""

from __future__ import annotations

import ipaddress
import socket

from fgpose.cli.options import new_console

_EVERY_ADDRESS = ("*", "0.0.0.0", "::")


def warn_if_others_reach(host: str, option: str, what: str) -> None:
    """Say on stderr that other computers reach what is served at this address, and at which of the computer's.

    Args:
        host: the address that is bound.
        option: that gave it.
        what: is reached there, as "the recording, with its pictures".
    """
    if host == "localhost" or _is_loopback(host):
        return
    addresses = ", ".join(_addresses()) if host in _EVERY_ADDRESS else host
    new_console(stderr=True).print(
        f"warning: {option} {host}: every computer in the network reaches {what}, at {addresses}; there is no password",
        soft_wrap=True,
    )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _addresses() -> list[str]:
    """Of this computer, that others may know it by."""
    name = socket.gethostname()
    try:
        known = {str(each[4][0]) for each in socket.getaddrinfo(name, None)}
    except OSError:
        known = set()
    return [name, *sorted(address for address in known if not _is_loopback(address.partition("%")[0]))]
