"""What stands against each other where no solution was found, as data and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any


class DemandKind(Enum):
    """What asks for something."""

    CONSTRAINT = "constraint"  # of the task or of the stance
    OBSTACLE = "obstacle"  # a piece of the scene, or what the task moves: links stay off it
    LINKS = "links"  # two links of the robot stay off each other
    LIMITS = "limits"  # joints stay within their limits


class Search(Enum):
    """How far the demands were narrowed down."""

    REDUCED = "reduced"  # leaving out any one of them, the others were kept
    CUT_SHORT = "cut_short"  # time was up before each had been left out once
    NO_HELP = "no_help"  # leaving them out did not help within a few steps
    GIVES_WAY = "gives_way"  # all of them were kept once nothing else was asked for


@dataclass(frozen=True)
class Demand:
    """One of the demands that stand against each other at the best attempt.

    Attributes:
        kind: what asks.
        name: of the constraint, the piece or the two links; ``joint limits``.
        multiplier: summed over its rows, as a share of the largest there.
        shortfall: how far the worst of its rows is from what is asked, 0 where it is just kept, in ``unit``.
        text: one clause for a person.
        links, joints: of the robot, the most loaded first.
        waypoints: first and last one of the worst row; None where there is a single configuration or nothing to name.
        is_decisive: whether leaving out this one alone, everything else was kept; None where that was not tried.
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
    """The demands that stand against each other at the best attempt at a step: local evidence, no proof.

    Attributes:
        step: of the plan that found no solution.
        n_attempts: how many attempts were made at it.
        standing_on: planted links, which stay where they are.
        demands: at least one, the most loaded first.
        search: how far they were narrowed down.
        n_solves: problems that were solved for it.
        cut_short_after_s: seconds spent on it where the search was cut short, else None.
    """

    step: str
    n_attempts: int
    standing_on: tuple[str, ...]
    demands: tuple[Demand, ...]
    search: Search
    n_solves: int
    cut_short_after_s: float | None = field(default=None, compare=False)

    def sentences(self) -> tuple[str, ...]:
        """For a person: where it failed, each demand, what leaving demands out does, and what this does not show."""
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
            f"{self._learnt()} This was met there; it does not prove that there is no motion.",
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

    def _learnt(self) -> str:
        """What was found by leaving demands out."""
        if self.search is Search.GIVES_WAY:
            return "Asked for nothing else, the robot kept all of it there: more options.starts may help."
        if self.search is Search.CUT_SHORT:
            return self._learnt_in_time()
        if self.search is Search.NO_HELP:
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

    def _learnt_in_time(self) -> str:
        """What was found before the search was cut short."""
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
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
