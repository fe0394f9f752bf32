"""The rest of a task from one of its phases on: its phases, and what they demand of a recorded motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism
from service.demands.phase import TaskPhase, list_work
from service.demands.stance import UNSETTLED
from service.errors import RequestError, shown, would_do
from service.verify import Motion

TAKE_HOLD = "take hold"
VALUE_ROUNDING = 2e-3  # by which a measured joint of the mechanism may be outside its travel [rad, m]


class Beginning(Enum):
    """How the rest of a task begins."""

    AT_ONCE = "at once"  # with the phase itself: the hand is free, or at its place
    TAKE_HOLD = "take hold"  # the hand is near its place: a short phase brings it there
    REACH = "reach"  # with the phase that carries the hand to the contact


def find_index(specs: Sequence[TaskPhase], phase: str) -> int:
    """Return the index of a phase.

    Raises:
        RequestError: there is none of that name.
    """
    names = [spec.name for spec in specs]
    if phase not in names:
        raise RequestError(f"resume.phase: unknown phase {shown(phase)}; the task has {', '.join(names)}")
    return names.index(phase)


def find_group(specs: Sequence[TaskPhase], index: int) -> range:
    """Return the indices of the phases of one contact around ``index``: from a free phase to before the next one."""
    first, last = index, index + 1
    while first > 0 and specs[first].hand is not None:
        first -= 1
    while last < len(specs) and specs[last].hand is not None:
        last += 1
    return range(first, last)


def can_reach(specs: Sequence[TaskPhase], index: int) -> bool:
    """Return whether the rest from a phase on may reach for its contact first: nothing has been done at it before."""
    group = find_group(specs, index)
    work = list_work(specs[group.start : group.stop])
    return specs[group.start].hand is None and any(group.start + k >= index for k in work)


def start_mechanism(mechanism: Mechanism, values: Mapping[str, float]) -> Mechanism:
    """Return the mechanism with its joints at the values of ``resume.mechanism``.

    Raises:
        RequestError: a joint is missing or unknown.
    """
    names = [joint.name for joint in mechanism.joints]
    unknown, missing = sorted(values.keys() - set(names)), [name for name in names if name not in values]
    if unknown:
        raise RequestError(
            f"resume.mechanism: unknown joint {shown(unknown[0])}; expected {would_do(unknown[0], names)}"
        )
    if missing:
        raise RequestError(f"resume.mechanism: {', '.join(missing)} missing; expected a value for {', '.join(names)}")
    return replace(mechanism, joints=tuple(replace(joint, start=values[joint.name]) for joint in mechanism.joints))


def check_travel(mechanism: Mechanism, specs: Sequence[TaskPhase], phase: str) -> None:
    """Refuse a mechanism that is not where the rest of the task can move it from.

    Raises:
        RequestError: one line per joint outside the travel of the phase, or of the rest of the task.
    """
    index = find_index(specs, phase)
    rest = specs[find_group(specs, index).start :]
    problems = []
    for k, (joint, value) in enumerate(zip(mechanism.joints, mechanism.start.tolist(), strict=True)):
        own = k in specs[index].moving
        ends = np.array([(spec.first[k], spec.last[k]) for spec in ([specs[index]] if own else rest)])
        low, high = float(ends.min()), float(ends.max())
        if not low - VALUE_ROUNDING <= value <= high + VALUE_ROUNDING:
            of = f"phase '{phase}'" if own else "the rest of the task"
            problems.append(
                f"resume.mechanism.{joint.name}: {_show(joint.kind, value)} is outside the travel of {of}; expected "
                f"{_show(joint.kind, low)} to {_show(joint.kind, high)}"
            )
    if problems:
        raise RequestError(problems)


def _show(kind: str, value: float) -> str:
    return f"{value:.4g} m" if kind == "prismatic" else f"{value:.4g} rad ({np.rad2deg(value):.1f} deg)"


def list_rest_phases(
    specs: Sequence[TaskPhase], phase: str, start: Float[np.ndarray, "k"], beginning: Beginning
) -> tuple[TaskPhase, ...]:
    """Return the rest of a task, with the mechanism at ``start`` [rad, m].

    A joint of the mechanism that a phase moves ends where the task has it; the others stay where they are.

    Raises:
        RequestError: there is no such phase.
    """
    index = find_index(specs, phase)
    rest = list(specs[find_group(specs, index).start if beginning is Beginning.REACH else index :])
    if beginning is Beginning.TAKE_HOLD:
        rest.insert(0, TaskPhase(TAKE_HOLD, start, start, touches=rest[0].touches))
    resumed, at = [], start
    for spec in rest:
        last = at.copy()
        moving = list(spec.moving)
        last[moving] = spec.last[moving]
        resumed.append(replace(spec, first=at, last=last))
        at = last
    return tuple(resumed)


@dataclass(frozen=True)
class RestTask:
    """What the rest of a task demands of any motion.

    Attributes:
        mechanism: with its joints at the start.
        specs: phases of the whole task, with the choices that the request keeps.
        phase: the phase that the rest begins with.
        measure: measures the figures of the rest on a motion.
    """

    mechanism: Mechanism
    specs: tuple[TaskPhase, ...]
    phase: str
    measure: Callable[[Motion], Mapping[str, float]]

    def read_choices(self, recorded: Motion) -> tuple[tuple[TaskPhase, ...], tuple[str, ...]]:
        """Return the phases as the record begins them."""
        names = [phase.name for phase in recorded.phases if phase.name not in UNSETTLED]
        index = find_index(self.specs, self.phase)
        for beginning in Beginning:
            if beginning is Beginning.REACH and not can_reach(self.specs, index):
                continue
            specs = list_rest_phases(self.specs, self.phase, self.mechanism.start, beginning)
            if [spec.name for spec in specs] == names:
                break
        return specs, ()

    def keep_choices(self, recorded: Motion) -> dict[str, Any]:
        """Return nothing: the request keeps the choices of the first plan."""
        return {}
