"""What the benchmarks that compare methods on variants of a recording have in common on the command line."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

OutputFolder = Annotated[
    Path,
    arg(metavar="FOLDER", aliases=("-o",), help="Folder for the results; it is made if it is absent."),
]
_CLIPS = "test: the recordings on which results are stated. tuning: those on which defaults may be chosen."


@dataclass(frozen=True, kw_only=True)
class MethodComparison:
    """Which methods are compared on which variants, and how. A benchmark adds output, quick and ablation."""

    quick: bool = False
    ablation: bool = False
    output: OutputFolder = Path("out")
    variants: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Only these variants."""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Only these methods."""
    clips: Annotated[Literal["test", "tuning"], arg(help=_CLIPS)] = "test"
    workers: Annotated[int, arg(metavar="N")] = 2
    """Number of processes. More processes than cores distort the times."""
    cache: bool = True
    """Keep finished results, and use those that were kept. --no-cache measures everything and keeps nothing."""

    def check_comparison(self) -> None:
        """Raise ValueError or OSError for what cannot be, before any work."""
        from fgpose.io.atomic import check_writable

        if self.workers < 0:
            raise ValueError(f"--workers must not be negative, got {self.workers}")
        check_writable(self.output)

    @property
    def cache_folder(self) -> Path | None:
        return self.output / "cache" if self.cache else None

    def command(self, name: str, *more: str) -> str:
        """What gives the same numbers again."""
        words = [name, *(["--quick"] * self.quick), *(["--ablation"] * self.ablation)]
        words += [f"--clips {self.clips}"] if self.clips != "test" else []
        words += more
        for option, chosen in (("--variants", self.variants), ("--methods", self.methods)):
            words += [option, *(shlex.quote(each) for each in chosen)] if chosen else []
        return " ".join(words)
