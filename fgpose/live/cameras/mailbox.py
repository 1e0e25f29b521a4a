"""A place for one thing: the newest."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

Letter = TypeVar("Letter")


class Mailbox(Generic[Letter]):
    """Holds the newest of what is put into it; what nobody took before is overwritten.

    Args:
        changed: notified when something is put in. Mailboxes that share one can be waited for together.
    """

    def __init__(self, changed: threading.Condition | None = None) -> None:
        self.changed = changed or threading.Condition()
        self._letter: Letter | None = None

    def put(self, letter: Letter) -> None:
        with self.changed:
            self._letter = letter
            self.changed.notify_all()

    def wait_until_empty(self, timeout_s: float) -> bool:
        """False if it was not within this time."""
        with self.changed:
            return self.changed.wait_for(lambda: self._letter is None, timeout_s)

    def peek(self) -> Letter | None:
        """What is in it, which stays there."""
        with self.changed:
            return self._letter

    def take(self) -> Letter | None:
        """What is in it; None if it is empty."""
        with self.changed:
            letter, self._letter = self._letter, None
            self.changed.notify_all()
            return letter
