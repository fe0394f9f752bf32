"""How far a plan of steps goes: up to the first at which somebody, a check or a force decides."""

from __future__ import annotations

from collections.abc import Collection, Iterator
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
        lands: objects that rest at its end: no later step moves them before they are put down.
        rests: those of them that it does not move either.
        waits: objects that hands have taken, and that no step up to this one has moved.
        sets_down: objects that a later step puts down, before which nothing may bring them out of level.
        puts_down: whether it lets go of an object that no other hand holds.
        entered_m: from the corner with the line before to where this line begins, if that corner is rounded [m].
        leads_to: line into which this one goes without a rest.
    """

    index: int
    name: str
    step: StepRequest
    lands: tuple[str, ...] = ()
    rests: tuple[str, ...] = ()
    waits: tuple[str, ...] = ()
    sets_down: frozenset[str] = frozenset()
    puts_down: bool = False
    entered_m: float = 0.0
    leads_to: MoveStep | None = None

    @staticmethod
    def list_all(section: StepsSection) -> tuple[NamedStep, ...]:
        """Return all steps of a list."""
        named, lands, later = list[NamedStep](), tuple[str, ...](), frozenset[str]()
        put_down, waiting = frozenset(_list_put_down(section)), list(_list_waiting(section))
        for k, step in reversed(list(enumerate(section.steps))):
            before = section.steps[k - 1].move if k else None
            entered = 0.0 if before is None else before.blend_m
            blends = step.move is not None and step.move.blend_m > 0.0 and k + 1 < len(section.steps)
            leads_to = section.steps[k + 1].move if blends else None
            rests = tuple(name for name in lands if not _may_move(step, name, section.carried))
            named.append(
                NamedStep(k, section.names[k], step, lands, rests, waiting[k], later, k in put_down, entered, leads_to)
            )
            if step.release is not None and k in put_down:
                lands, later = (*lands, step.release.object), later | {step.release.object}
            else:
                lands = rests
        return tuple(reversed(named))


def _may_move(step: StepRequest, name: str, objects: Collection[str]) -> bool:
    """Return whether a step may move an object that a hand holds: all do but those that say which others they move."""
    if step.taken is not None or step.release is not None:
        return step.taken is not None and step.taken.object == name
    if step.move is not None and step.move.poses:
        moved = [pose.link for pose in step.move.poses]
    elif step.fit is not None:
        moved = [step.fit.object]
    else:
        own = step.move or step.screw or step.follow or step.touch
        moved = [] if own is None or own.frame is None else [own.frame]
    return not moved or name in moved or not set(moved) <= set(objects)


def _list_waiting(section: StepsSection) -> Iterator[tuple[str, ...]]:
    """Yield for each step the objects that hands have taken before, and that no step has moved."""
    waiting: tuple[str, ...] = ()
    for step in section.steps:
        waiting = tuple(name for name in waiting if not _may_move(step, name, section.carried))
        if step.release is not None:
            waiting = tuple(name for name in waiting if name != step.release.object)
        yield waiting
        if step.taken is not None:
            waiting = (*waiting, step.taken.object)


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
