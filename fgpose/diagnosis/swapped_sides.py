"""Cameras whose network exchanges left and right, in words."""

from __future__ import annotations

from collections.abc import Mapping

from fgpose.finding import Code, Finding, Severity

_CORRECTED = "Whole poses that are turned are corrected; if errors stay, use another network."
_NOT_CORRECTED = (
    "No two other cameras tell which side is which, so not all of it is corrected: use a network that looks at more of "
    "the image."
)
# Exchanges of few frames come at other times in each camera: the others are right then.
_OFTEN = 0.1


def swapped_sides(
    shares: Mapping[str, float], n_cameras: int, *, what: str = "", of: str, severities: Mapping[str, Severity]
) -> list[Finding]:
    """One finding for each camera that exchanges sides or, where most of all cameras do, one for these together.

    Args:
        shares: how often each does.
        n_cameras: how many there are.
        what: which sides, as "of the body".
        of: what it is a share of.
        severities: of each camera.
    """
    most = len(shares) > 1 and 2 * len(shares) > n_cameras
    often = sum(share > _OFTEN for share in shares.values())
    remedy = _CORRECTED if n_cameras - often >= 2 or not often else _NOT_CORRECTED
    if not most:
        return [
            _finding(name, f"camera {name} exchanges", (share, share), what, of, remedy, severities[name])
            for name, share in shares.items()
        ]
    who = "all cameras exchange" if len(shares) == n_cameras else f"cameras {', '.join(shares)} exchange"
    span = min(shares.values()), max(shares.values())
    return [_finding("", who, span, what, of, remedy, min(severities.values(), key=list(Severity).index))]


def _finding(
    camera: str, who: str, span: tuple[float, float], what: str, of: str, remedy: str, severity: Severity
) -> Finding:
    low, high = (f"{100 * share:.{0 if share > 0.1 else 1}f}" for share in span)
    share = high if low == high else f"{low} to {high}"
    return Finding(
        Code.EXCHANGED_SIDES,
        severity,
        f"{who} left and right {what + ' ' if what else ''}in {share} % of {of}",
        remedy,
        0.5 * span[1],
        camera=camera,
        numbers={"share": span[1]},
    )
