"""Messages that are refused: counted by kind, and said once for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace


class MessageError(ValueError):
    """A message is refused."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind
        """What is wrong, in a word or two: size, content, camera, skeleton, image size, shape, time, values, link,
        connection or unexpected."""


@dataclass(frozen=True)
class Rejected:
    """Messages that were refused for one kind of reason."""

    kind: str
    n: int
    first: str
    """What the first of them said."""


class Rejections:
    """What a socket has refused.

    Args:
        source: of the messages, for people.
        tell: called with one line for the first message of each kind.
    """

    def __init__(self, source: str, tell: Callable[[str], None] | None) -> None:
        self._source, self._tell = source, tell
        self._by_kind: dict[str, Rejected] = {}

    def add(self, error: MessageError) -> None:
        """Count a message."""
        before = self._by_kind.get(error.kind)
        if before is not None:
            self._by_kind[error.kind] = replace(before, n=before.n + 1)
            return
        self._by_kind[error.kind] = Rejected(error.kind, 1, str(error))
        if self._tell is not None:
            self._tell(f"{self._source} refused ({error.kind}): {error}")

    def so_far(self) -> tuple[Rejected, ...]:
        """By kind."""
        return tuple(self._by_kind.values())

    def in_words(self) -> str:
        """All in one line; empty: nothing was refused."""
        return "; ".join(f"{rejected.n} refused ({rejected.kind}): {rejected.first}" for rejected in self.so_far())
