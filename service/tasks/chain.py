"""Solve phases from any poses in any order: outwards from the poses that are known, until all of them are joined."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from jaxtyping import Float

from service.body.task_plan import PlannedPhase, Stuck
from service.demands.phase import TaskPhase


@dataclass(frozen=True)
class PhaseMotion:
    """The motion of a phase.

    Attributes:
        q: (T, n) waypoints.
        plan: returns it with the promises of the phase.
        stuck: where the phase is stuck; None where it is solved.
    """

    q: Float[np.ndarray, "T n"]
    plan: Callable[[], PlannedPhase]
    stuck: Stuck | None = None

    @staticmethod
    def of(planned: PlannedPhase) -> PhaseMotion:
        """Return a solved phase."""
        return PhaseMotion(planned.q, lambda: planned)


class PhaseWork(Protocol):
    """Solver of single phases between poses."""

    def lead(
        self, phase: TaskPhase, first: Float[np.ndarray, "n"] | None, last: Float[np.ndarray, "n"] | None
    ) -> PhaseMotion:
        """Solve a phase that leads frames from its first configuration, backwards from its last, or between both."""

    def join(self, phase: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> PhaseMotion:
        """Solve a phase that leads nothing between two configurations."""


@dataclass(frozen=True)
class PhaseChain:
    """Phases that were solved.

    Attributes:
        attempts: by index of the phase.
        failed: index of the phase that is stuck; None where all are solved.
    """

    attempts: Mapping[int, PhaseMotion]
    failed: int | None = None

    @property
    def planned(self) -> tuple[PlannedPhase, ...]:
        """The phases in their order: all, or those before the one that is stuck and the attempt at it."""
        last = len(self.attempts) if self.failed is None else self.failed
        return tuple(self.attempts[k].plan() for k in sorted(self.attempts) if k <= last)

    @property
    def stuck(self) -> Stuck | None:
        """Where they are stuck."""
        return None if self.failed is None else self.attempts[self.failed].stuck

    @property
    def q(self) -> Float[np.ndarray, "T n"]:
        """(T, n) waypoints of all that was solved, and of the attempt that is stuck."""
        return np.concatenate([self.attempts[k].q for k in sorted(self.attempts)])


def solve_phases(
    phases: Sequence[TaskPhase],
    start: Float[np.ndarray, "n"],
    poses: Mapping[int, Float[np.ndarray, "n"]],
    work: PhaseWork,
    begun: Mapping[int, PhaseMotion] = MappingProxyType({}),
) -> PhaseChain:
    """Solve phases, as far as the first one that is stuck.

    Phases that lead frames are first solved backwards from what is known, then all others in their order.

    Args:
        phases: in the order of their execution.
        start: (n,) configuration at their beginning.
        poses: (n,) configuration by number of the phase that it is the first of; that number is the count of all phases
            for the end of the last.
        work: solver of single phases.
        begun: phases that are solved already, by number; the others begin and end where these do.

    Raises:
        ValueError: no pose is known where a phase that leads nothing ends.
    """
    borders: dict[int, Float[np.ndarray, "n"]] = {**poses, 0: start}
    attempts: dict[int, PhaseMotion] = {}

    def take(index: int, attempt: PhaseMotion) -> bool:
        attempts[index] = attempt
        borders.setdefault(index, attempt.q[0])
        borders[index + 1] = attempt.q[-1]
        return attempt.stuck is None

    for index, attempt in begun.items():
        if not take(index, attempt):
            return PhaseChain(attempts, index)
    for border in sorted({*poses, *begun}, reverse=True):
        for k in range(border - 1, -1, -1):
            if k in attempts or k in borders or not phases[k].frames:
                break
            if not take(k, work.lead(phases[k], None, borders[k + 1])):
                return PhaseChain(attempts, k)
    for k, phase in enumerate(phases):
        if k in attempts:
            continue
        first, last = borders[k], borders.get(k + 1)
        if phase.frames:
            attempt = work.lead(phase, first, last)
        elif last is not None:
            attempt = work.join(phase, first, last)
        else:
            raise ValueError(f"phase '{phase.name}' leads nothing, and no pose is known where it ends")
        if not take(k, attempt):
            return PhaseChain(attempts, k)
    return PhaseChain(attempts)
