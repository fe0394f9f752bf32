"""Rows of the table: target, measurement, and whether the target is met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.tables import print_table


@dataclass(frozen=True)
class Figure:
    """A target and what was measured of it.

    Attributes:
        what: the measured quantity.
        target: in words.
        measured: with units.
        is_met: None for figures without a target.
    """

    what: str
    target: str
    measured: str
    is_met: bool | None = None

    @property
    def word(self) -> str:
        """State of the target as a word."""
        return "" if self.is_met is None else "met" if self.is_met else "MISSED"


@dataclass(frozen=True)
class Options:
    """Amount of measuring.

    Attributes:
        is_short: only check that all parts work; the figures are not meaningful.
        seconds: of overload and of killing workers, where they differ from what the targets say.
        solves: in a row.
        messages: malformed or hostile ones.
        seed: of everything that is random.
    """

    is_short: bool = False
    seconds: float | None = None
    solves: int | None = None
    messages: int | None = None
    seed: int = 0

    def count(self, whole: int, short: int) -> int:
        """How often."""
        return short if self.is_short else whole

    def time_s(self, whole: float, short: float) -> float:
        """How long [s]."""
        return self.seconds if self.seconds is not None else short if self.is_short else whole


def percentile(values: Sequence[float], share: float) -> float:
    """Return the value that ``share`` percent do not exceed; NaN without values."""
    if not values:
        return float("nan")
    return sorted(values)[min(int(0.01 * share * len(values)), len(values) - 1)]


def ms(seconds: float) -> str:
    """Format a time in milliseconds with a sensible precision."""
    value = 1e3 * seconds
    return f"{value:.2f} ms" if abs(value) < 10 else f"{value:.1f} ms" if abs(value) < 100 else f"{value:.0f} ms"


def spread(values: Sequence[float]) -> str:
    """Format the median and upper percentiles of times [s]."""
    return ", ".join(f"p{share} {ms(percentile(values, share))}" for share in (50, 90, 99))


def print_figures(title: str, figures: Sequence[Figure]) -> None:
    """Print the figures as a table."""
    print_table(title, ("", "target", "measured", ""), [(f.what, f.target, f.measured, f.word) for f in figures])
