"""What a worker process of this machine does when it starts; Dask calls dask_setup."""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:
    """Ctrl-C is for the process that began the study: it ends its workers, which would each print a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
