"""Rerun tells its makers how it is used, unless it is told not to."""

from __future__ import annotations

import os


def leave_out_analytics() -> None:
    """Rerun, in this process and in those that it starts, sends nothing unless FORCE_RERUN_ANALYTICS=1 is set.

    Its own switch is a file in the user's home, which is not ours to write, and is on where nobody was asked. It sends
    nothing either where CI is set, as machines that run tests do.
    """
    os.environ.setdefault("CI", "1")
