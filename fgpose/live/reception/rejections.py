"""Messages that are refused: counted by kind and camera, and said once for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace


class MessageError(ValueError):
    """A message is refused."""

    def __init__(self, kind: str, reason: str, camera: str = "") -> None:
        super().__init__(f"camera {camera}: {reason}" if camera else reason)
        self.reason = reason
        """Without the name of the camera."""
        self.camera = camera
        """Whose message it is, if that is known."""
        self.kind = kind
        """What is wrong, in a word or two: size, content, camera, skeleton, image size, shape, time, unit, values,
        link, connection or unexpected."""


@dataclass(frozen=True)
class Rejected:
    """Messages that were refused for one kind of reason."""

    kind: str
    camera: str
    """Whose they are; empty: nobody's, or nobody knows."""
    n: int
    first: str
    """What the first of them said."""


class Rejections:
    """What a socket has refused.

    Args:
        source: of the messages, for people.
        tell: called with one line for the first message of each kind of each camera.
    """

    def __init__(self, source: str, tell: Callable[[str], None] | None) -> None:
        self._source, self._tell = source, tell
        self._by_kind: dict[tuple[str, str], Rejected] = {}

    def add(self, error: MessageError) -> None:
        """Count a message."""
        key = error.kind, error.camera
        before = self._by_kind.get(key)
        if before is not None:
            self._by_kind[key] = replace(before, n=before.n + 1)
            return
        self._by_kind[key] = Rejected(*key, 1, str(error))
        if self._tell is not None:
            self._tell(f"{self._source} refused ({error.kind}): {error}")

    def so_far(self) -> tuple[Rejected, ...]:
        """By kind and camera."""
        return tuple(self._by_kind.values())

    def in_words(self) -> str:
        """All in one line; empty: nothing was refused."""
        return "; ".join(f"{rejected.n} refused ({rejected.kind}): {rejected.first}" for rejected in self.so_far())
