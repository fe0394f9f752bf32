"""The registry of task kinds. No other module knows them all: every stage asks the kind of its request."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from pydantic.dataclasses import dataclass

from costs.entry_points import load_entry_points
from service.errors import ServiceError
from service.request.fields import SECTION, PlainData, Section, require_exactly_one
from service.request.tasks.contacts import ContactsRequest
from service.request.tasks.door import DoorRequest
from service.request.tasks.egress import EgressRequest
from service.request.tasks.kind import ENTRY_POINTS, TaskKind, TaskSection
from service.request.tasks.mechanism import MechanismRequest
from service.request.tasks.pick_place import PickRequest
from service.request.tasks.reach import GoalRequest
from service.request.tasks.steps import Steps, StepsSection
from service.request.tasks.trajopt import ProblemSection
from service.request.tasks.valve import ValveRequest

T = TypeVar("T")

SHIPPED = (
    TaskKind("valve", ValveRequest, "service.demands.valve.kind:PART", "service.tasks.valve.kind:PART"),
    TaskKind("door", DoorRequest, "service.demands.door.kind:PART", "service.tasks.door.kind:PART"),
    TaskKind("mechanism", MechanismRequest, "service.demands.mechanism.kind:PART", "service.tasks.mechanism.kind:PART"),
    TaskKind("contacts", ContactsRequest, "service.demands.contacts.kind:PART", "service.tasks.contacts.kind:PART"),
    TaskKind("egress", EgressRequest, "service.demands.egress.kind:PART", "service.tasks.egress.kind:PART"),
    TaskKind("pick_place", PickRequest, "service.demands.steps.pick_place:PART", "service.tasks.steps.kind:PICK_PLACE"),
    TaskKind("steps", StepsSection, "service.demands.steps.kind:PART", "service.tasks.steps.kind:PART"),
    TaskKind("trajopt", ProblemSection, "service.trajopt.kind:PART", "service.tasks.trajopt.kind:PART"),
)
REACH = TaskKind(
    "reach",
    GoalRequest,
    "service.demands.reach:PART",
    "service.tasks.reach.kind:PART",
    field="goal",
    variants=("joint_goal", "pose_goal", "posture"),
)


class TaskKindError(ServiceError):
    """A kind of another package cannot be used."""


def _find_added() -> Iterator[TaskKind]:
    """Yield the kinds that other packages add.

    Raises:
        TaskKindError: a package fails, gives something else, or takes a name that is taken.
    """
    taken = {kind.name for kind in (*SHIPPED, REACH)}
    for name, kind in load_entry_points(ENTRY_POINTS, TaskKind, taken, TaskKindError):
        if kind.name != name or not name.isidentifier():
            raise TaskKindError(f"entry point {name!r} of {ENTRY_POINTS}: {kind!r}; expected a TaskKind named {name!r}")
        yield kind


ADDED = tuple(_find_added())
"""Kinds of other packages."""

TASKS: Mapping[str, TaskKind] = {kind.name: kind for kind in (*SHIPPED, *ADDED)}
"""Kinds by their field of ``task``."""

KINDS = (*TASKS.values(), REACH)


def _with_added_fields(section: type[T]) -> type[T]:
    """Add a field to ``TaskRequest`` for every kind of another package."""
    for kind in ADDED:
        section.__annotations__[kind.name] = kind.section | None
        setattr(section, kind.name, None)
    return section


@dataclass(config=SECTION)
@_with_added_fields
class TaskRequest(Section):
    """The task, in the field of its kind; ``trajopt`` is a problem as in its files (docs/trajopt.md)."""

    valve: ValveRequest | None = None
    door: DoorRequest | None = None
    contacts: ContactsRequest | None = None
    egress: EgressRequest | None = None
    trajopt: PlainData | None = None
    mechanism: MechanismRequest | None = None
    pick_place: PickRequest | None = None
    steps: Steps | None = None

    def __post_init__(self) -> None:
        require_exactly_one(self, tuple(TASKS))

    @property
    def kind(self) -> TaskKind:
        """The kind of the task."""
        return next(kind for kind in TASKS.values() if getattr(self, kind.name) is not None)

    @property
    def section(self) -> TaskSection:
        """The section of its kind."""
        section = getattr(self, self.kind.name)
        return section if isinstance(section, TaskSection) else self.kind.section(section)  # type: ignore[call-arg]

    def replace_mechanisms(self, change: Callable[[str, MechanismRequest], MechanismRequest]) -> TaskRequest:
        """Return the task with other mechanisms.

        Args:
            change: of the field's name and the mechanism in it.
        """
        if self.mechanism is not None:
            return replace(self, mechanism=change("task.mechanism", self.mechanism))
        if self.steps is None:
            return self
        steps = tuple(
            step
            if step.mechanism is None
            else replace(step, mechanism=change(f"task.steps[{index}].mechanism", step.mechanism))
            for index, step in enumerate(self.steps)
        )
        return replace(self, steps=steps)
