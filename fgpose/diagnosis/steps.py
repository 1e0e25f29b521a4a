"""How far a diagnosis is."""

from __future__ import annotations

from fgpose.association.recording import Progress


class Steps:
    """Steps of about the same length, so many of so many; one that turns out to be several becomes these.

    Args:
        progress: told after each; None: nobody asks.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress, self._done, self._total = progress, 0, 0
        self._of_part = 0, 0

    def expect(self, n: int) -> None:
        """There are so many more."""
        self._total += n

    def one(self) -> None:
        """One is done, with all steps that it was made of."""
        _, of_part = self._of_part
        self._done, self._total, self._of_part = self._done + 1 + of_part, self._total + of_part, (0, 0)
        self._tell()

    def part(self, done: int, total: int) -> None:
        """So many of so many steps are done of which the present one is made."""
        self._of_part = done, total
        self._tell()

    def _tell(self) -> None:
        if self._progress is not None:
            done, total = self._of_part
            self._progress(self._done + done, self._total + total)
