"""One row of the table: what was to be reached, what was measured, and whether it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.tables import print_table


@dataclass(frozen=True)
class Figure:
    """A target and what was measured of it.

    Attributes:
        what: is measured.
        target: as it was set, in words.
        measured: with units.
        is_met: None where nothing was set: it is there to be known.
    """

    what: str
    target: str
    measured: str
    is_met: bool | None = None

    @property
    def word(self) -> str:
        """How it stands."""
        return "" if self.is_met is None else "met" if self.is_met else "MISSED"


@dataclass(frozen=True)
class Options:
    """How long to measure.

    Attributes:
        is_short: a look at whether all parts work; its figures mean little.
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
    """The value that ``share`` percent do not exceed; nan of none."""
    if not values:
        return float("nan")
    return sorted(values)[min(int(0.01 * share * len(values)), len(values) - 1)]


def ms(seconds: float) -> str:
    """In milliseconds, as precise as it makes sense."""
    value = 1e3 * seconds
    return f"{value:.2f} ms" if abs(value) < 10 else f"{value:.1f} ms" if abs(value) < 100 else f"{value:.0f} ms"


def spread(values: Sequence[float]) -> str:
    """Median and upper percentiles of times [s]."""
    return ", ".join(f"p{share} {ms(percentile(values, share))}" for share in (50, 90, 99))


def print_figures(title: str, figures: Sequence[Figure]) -> None:
    """As a table."""
    print_table(title, ("", "target", "measured", ""), [(f.what, f.target, f.measured, f.word) for f in figures])
