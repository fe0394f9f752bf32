"""How far a plan of steps goes: up to the first at which somebody, a check or a force decides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from service.request.tasks.hand_steps import MoveStep
from service.request.tasks.steps import ENDING, StepRequest, StepsSection

GUARDED = ("touch",)  # steps that end where something is felt: the plan ends after them


@dataclass(frozen=True)
class NamedStep:
    """A step with its place in the list.

    Attributes:
        index, name: of it.
        step: the step.
        lands: object that the next step puts down.
        sets_down: objects that a later step puts down, before which nothing may bring them out of level.
        puts_down: whether it lets go of an object that no other hand holds.
        entered_m: from the corner with the line before to where this line begins, if that corner is rounded [m].
        leads_to: line into which this one goes without a rest.
    """

    index: int
    name: str
    step: StepRequest
    lands: str | None = None
    sets_down: frozenset[str] = frozenset()
    puts_down: bool = False
    entered_m: float = 0.0
    leads_to: MoveStep | None = None

    @staticmethod
    def list_all(section: StepsSection) -> tuple[NamedStep, ...]:
        """Return all steps of a list."""
        named, lands, later = list[NamedStep](), None, frozenset[str]()
        put_down = frozenset(_list_put_down(section))
        for k, step in reversed(list(enumerate(section.steps))):
            before = section.steps[k - 1].move if k else None
            entered = 0.0 if before is None else before.blend_m
            blends = step.move is not None and step.move.blend_m > 0.0 and k + 1 < len(section.steps)
            leads_to = section.steps[k + 1].move if blends else None
            named.append(NamedStep(k, section.names[k], step, lands, later, k in put_down, entered, leads_to))
            lands = step.release.object if step.release is not None and k in put_down else None
            later = later if lands is None else later | {lands}
        return tuple(reversed(named))


def _list_put_down(section: StepsSection) -> Iterator[int]:
    """Yield the indices of the releases after which no hand holds the object."""
    hands: dict[str, int] = {}
    for k, step in enumerate(section.steps):
        if step.taken is not None:
            hands[step.taken.object] = hands.get(step.taken.object, 0) + (2 if step.taken.hand == "both" else 1)
        elif step.release is not None:
            name = step.release.object
            hands[name] = 0 if step.release.hand == "both" else hands.get(name, 0) - 1
            if hands[name] <= 0:
                yield k


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
        steps = NamedStep.list_all(section)
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
