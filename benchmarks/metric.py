"""What a benchmark gives: numbers with a unit, a direction and, where one is promised, a limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NOISE_MARGIN = 0.10
"""A limit counts as missed beyond this share of it: medians on a shared machine repeat to 5-10 %."""


@dataclass(frozen=True)
class Metric:
    """One measured number."""

    name: str
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    """Which way is better."""
    limit: float | None = None
    """None: for information only."""
    cpu: float | None = None
    """The same in processor time of the process, which other processes disturb less; for information."""
    exact: bool = False
    """Not a time: repeats to the last digit on one machine, so that the noise margin does not apply."""

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None without one."""
        return None if self.limit is None else self._excess() <= 0.0

    @property
    def missed(self) -> bool:
        """Whether the limit is exceeded by more than noise explains."""
        return self._excess() > (0.0 if self.exact else NOISE_MARGIN)

    def _excess(self) -> float:
        """How far beyond the limit, as a share of it; NaN counts as far beyond."""
        if self.limit is None:
            return 0.0
        ratio = self.value / self.limit if self.direction == "lower" else self.limit / max(self.value, 1e-12)
        return ratio - 1.0 if ratio == ratio else float("inf")


def markdown_table(metrics: list[Metric]) -> str:
    """The metrics as a Markdown table."""
    lines = ["| measured | value | CPU | unit | limit | met |", "|---|---:|---:|---|---:|---|"]
    for metric in metrics:
        cpu = "" if metric.cpu is None else f"{metric.cpu:.3g}"
        sign = "≤" if metric.direction == "lower" else "≥"
        limit = "" if metric.limit is None else f"{sign} {metric.limit:.4g}"
        lines.append(f"| {metric.name} | {metric.value:.4g} | {cpu} | {metric.unit} | {limit} | {_verdict(metric)} |")
    return "\n".join(lines)


def _verdict(metric: Metric) -> str:
    if metric.met is None:
        return ""
    if metric.met:
        return "yes"
    return "**no**" if metric.missed else "within noise"
