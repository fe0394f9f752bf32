"""How far a plan of steps goes: up to the first at which somebody, a check or a force decides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from service.request.tasks.steps import ENDING, StepRequest, StepsSection

GUARDED = ("touch",)  # steps that end where something is felt: the plan ends after them


@dataclass(frozen=True)
class NamedStep:
    """A step with its index and name."""

    index: int
    name: str
    step: StepRequest


@dataclass(frozen=True)
class Extent:
    """How far a plan of steps goes.

    Attributes:
        done: steps that it does.
        rest: steps that are left, for a request from the state that is reached.
    """

    done: tuple[NamedStep, ...]
    rest: tuple[NamedStep, ...]

    @staticmethod
    def of(section: StepsSection) -> Extent:
        """Return the steps up to the first at which somebody, a check or a force decides."""
        steps = tuple(NamedStep(k, section.names[k], step) for k, step in enumerate(section.steps))
        for named in steps:
            if named.step.kind in ENDING:
                return Extent(steps[: named.index], steps[named.index :])
            if named.step.kind in GUARDED:
                return Extent(steps[: named.index + 1], steps[named.index + 1 :])
        return Extent(steps, ())

    def list_notes(self) -> Iterator[str]:
        """Yield a sentence where steps are left."""
        if not self.rest:
            return
        named = ", ".join(f"'{step.name}'" for step in self.rest)
        first = self.rest[0]
        reason = getattr(first.step, first.step.kind) if first.step.kind in ENDING else "what it has touched decides"
        yield f"the plan ends before step '{first.name}' ({reason}); plan from the state then: {named}"
