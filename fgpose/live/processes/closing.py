"""The end of what runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import TypeVar

_Opened = TypeVar("_Opened", bound="Closing")


class Closing:
    """What can be used in a ``with`` block, at whose end it is closed."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self: _Opened) -> _Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def all_at_once(works: Iterable[Callable[[], None]]) -> None:
    """Do all of it, each in a thread, and wait until the last is done."""
    threads = [threading.Thread(target=work) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
