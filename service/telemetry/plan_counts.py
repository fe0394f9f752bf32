"""Phases of finished plans, their verdicts, and how long their solves took."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

MAX_SOLVES = 1024  # latest solves that percentiles are computed from
SOLVE = "solve"

# Phase of each planner step; all other steps belong to the solve.
_PHASES = {
    "queue": "queue",
    "load_robot": "set-up",
    "build_scene": "set-up",
    "check_start": "set-up",
    "perceive": "perceive",
    "curve and timing": "timing",
    "certificate": "certificate",
    "explain": "explain",
    "total": "total",
}


def sum_phases(timings: Mapping[str, float]) -> dict[str, float]:
    """Sum seconds by step to seconds by phase."""
    sums: dict[str, float] = {}
    for step, seconds in timings.items():
        phase = _PHASES.get(step, SOLVE)
        sums[phase] = sums.get(phase, 0.0) + seconds
    return sums


@dataclass
class PlanCounts:
    """Finished plans of a server since its start.

    Attributes:
        verdicts: number of plans by verdict.
        solves: seconds that the latest plans spent in their solves, without set-up, perception, timing and certificate.
    """

    verdicts: Counter[str] = field(default_factory=Counter)
    solves: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_SOLVES))

    def add(self, verdict: str, timings: Mapping[str, float]) -> None:
        """Count a plan; one that ended before its first solve has no solve time."""
        self.verdicts[verdict] += 1
        solve = sum_phases(timings).get(SOLVE)
        if solve is not None:
            self.solves.append(solve)

    def solve_percentile(self, share: float) -> float:
        """Return the time that ``share`` percent of the latest solves do not exceed [s]; 0 without any."""
        values = sorted(self.solves)
        return values[min(int(0.01 * share * len(values)), len(values) - 1)] if values else 0.0
