"""Conflicting demands at a step without a solution, as data and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any


class DemandKind(Enum):
    """The source of a demand."""

    CONSTRAINT = "constraint"  # of the task or of the stance
    OBSTACLE = "obstacle"  # a piece of the scene or a moved mechanism, that links keep clear of
    LINKS = "links"  # two links of the robot that keep clear of each other
    LIMITS = "limits"  # joints stay within their limits


class FilterOutcome(Enum):
    """How far the deletion filter reduced the demands."""

    REDUCED = "reduced"  # each remaining demand was left out once
    CUT_SHORT = "cut_short"  # out of time before that
    NO_HELP = "no_help"  # leaving them out did not help within a few steps
    GIVES_WAY = "gives_way"  # all were met with required constraints only


@dataclass(frozen=True)
class Demand:
    """A demand in conflict with others at the best attempt.

    Attributes:
        kind: its source.
        name: of the constraint, the piece or the two links; ``joint limits``.
        multiplier: summed over its rows, as a share of the largest demand's.
        shortfall: largest violation of its rows in ``unit``, 0 where it is just met.
        text: a clause for the user.
        links, joints: of the robot, the most loaded first.
        waypoints: first and last waypoint of the worst row; None where there is no waypoint to name.
        is_decisive: whether all other demands were met without it; None where that was not tried.
    """

    kind: DemandKind
    name: str
    multiplier: float
    shortfall: float
    unit: str
    text: str
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    waypoints: tuple[int, int] | None = None
    is_decisive: bool | None = None


@dataclass(frozen=True)
class Conflict:
    """The conflicting demands at the best attempt at a step: local evidence, no proof.

    Attributes:
        step: of the plan that found no solution.
        n_attempts: number of attempts at it.
        standing_on: planted links.
        demands: at least one, the most loaded first.
        search: how far they were reduced.
        n_solves: problems solved by the filter.
        cut_short_after_s: seconds spent where the filter was cut short, else None.
    """

    step: str
    n_attempts: int
    standing_on: tuple[str, ...]
    demands: tuple[Demand, ...]
    search: FilterOutcome
    n_solves: int
    cut_short_after_s: float | None = field(default=None, compare=False)

    def sentences(self) -> tuple[str, ...]:
        """Return sentences for the user: the step, each demand, the effect of leaving demands out, and a caveat."""
        tried = "the one attempt failed; at its end"
        if self.n_attempts > 1:
            both = "both" if self.n_attempts == 2 else f"all {self.n_attempts}"
            tried = f"{both} attempts failed; at the end of the best"
        stance = f", standing on {join_names(self.standing_on)}" if self.standing_on else ""
        stand = (
            f"{len(self.demands)} demands stand against each other"
            if len(self.demands) > 1
            else "one demand is not met"
        )
        clauses = [f"{demand.text};" for demand in self.demands[:-1]] + [f"{self.demands[-1].text}."]
        return (
            f"{self.step}{stance}: {tried}, {stand}:",
            *clauses,
            f"{self._describe_outcome()} This was met there; it does not prove that there is no motion.",
        )

    @property
    def brief(self) -> str:
        """The step and its demands in one line, for a table."""
        return f"{self.step}: {'; '.join(demand.text for demand in self.demands)}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data (docs/result-format.md)."""
        return {
            "step": self.step,
            "attempts": self.n_attempts,
            "standing_on": list(self.standing_on),
            "search": self.search.value,
            "solves": self.n_solves,
            "cut_short_after_s": self.cut_short_after_s,
            "demands": [{**asdict(demand), "kind": demand.kind.value} for demand in self.demands],
        }

    def _describe_outcome(self) -> str:
        """Return a sentence about the effect of leaving demands out."""
        if self.search is FilterOutcome.GIVES_WAY:
            return "Asked for nothing else, the robot kept all of it there: more options.starts may help."
        if self.search is FilterOutcome.CUT_SHORT:
            return self._describe_cut_short()
        if self.search is FilterOutcome.NO_HELP:
            return "Giving them up did not help within a few steps."
        decisive = [demand.name for demand in self.demands if demand.is_decisive]
        if not decisive:
            given_up = "it" if len(self.demands) == 1 else "any of them"
            return f"Giving up {given_up} is not enough: what is not listed then stands in the way."
        if len(self.demands) == 1:
            return "Without it everything else was kept."
        if len(decisive) == len(self.demands):
            return f"Without {'either' if len(decisive) == 2 else 'any one'} of them everything else was kept."
        return f"Without {' or without '.join(decisive)} everything else was kept."

    def _describe_cut_short(self) -> str:
        """Return a sentence about the effects that were tried in time."""
        if not self.n_solves:
            return "There was no time to find out which of them to give up."
        spent = f"{self.cut_short_after_s or 0.0:.1f} s"
        decisive = [demand.name for demand in self.demands if demand.is_decisive]
        if decisive:
            return (
                f"Without {' or without '.join(decisive)} everything else was kept; whether that is so of the others "
                f"was not found out within {spent}."
            )
        return f"Which of them to give up was not found out within {spent}."


def join_names(words: tuple[str, ...] | list[str]) -> str:
    """Return ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
