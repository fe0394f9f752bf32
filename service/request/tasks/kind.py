"""A kind of task: what the stages ask of its section of a request, and where its other parts are."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic_core import PydanticCustomError

from service.request.fields import Point, Section

ENTRY_POINTS = "scopt_task_kinds"
"""Group of entry points by which another package adds a kind: ``NAME = module:KIND``, with a ``TaskKind``."""


@dataclass(frozen=True)
class MovedNames:
    """Names that belong to what a task moves, so that nothing else in a request may have them.

    Attributes:
        mechanism: its links and parts are ``NAME/...``.
        joints: names of its joints, as far as the request alone says them.
    """

    mechanism: str
    joints: tuple[str, ...] = ()


LARGEST_MOVE_M = 0.3  # by which a person corrects where a scan shows an object


def check_moved(moved_m: Point | None, given: str) -> None:
    """Refuse a correction of an object that the request gives itself, or that is too large.

    Args:
        moved_m: displacement of what the scan shows, in world axes [m].
        given: field that gives the object; empty where the scan shows it.

    Raises:
        PydanticCustomError: one line that names the field.
    """
    if moved_m is None:
        return
    if given:
        raise PydanticCustomError("moved", f"moved_m is for an object that a scan shows; correct {given} instead")
    if math.hypot(*moved_m) > LARGEST_MOVE_M:
        raise PydanticCustomError(
            "moved",
            f"moved_m: {math.hypot(*moved_m):.3g} m; expected at most {LARGEST_MOVE_M:g} m from the detected object",
        )


class TaskSection(Section):
    """Section of a request that says what to do.

    A kind overrides what applies to it. Nothing here loads a robot, a scan or a file.

    Attributes:
        effort_s: processor time of a plan, where the request states no time limit [s].
    """

    effort_s = 60.0

    @property
    def can_resume(self) -> bool:
        """Whether the rest of a plan can be planned again."""
        return True

    @property
    def takes_trajectories(self) -> bool:
        """Whether trajectories of other planners can be certified for it."""
        return False

    @property
    def moved_names(self) -> MovedNames | None:
        """Names of what it moves."""
        return None

    @property
    def carried(self) -> tuple[str, ...]:
        """Names of the scene's objects that it moves; the others are obstacles."""
        return ()

    @property
    def detected(self) -> tuple[str, ...]:
        """Kinds of objects to find in the scan: what the task moves, whose points are no obstacles."""
        return ()

    @property
    def near(self) -> Point | None:
        """A point near what is to be found in the scan."""
        return None

    @property
    def moved_by(self) -> Point | None:
        """Displacement in world axes by which a person corrected where the scan shows what the task moves [m]."""
        return None

    @property
    def variant(self) -> str | None:
        """Name under which budgets and metrics count the request, if not under that of its kind."""
        return None

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield field and value of each position in the world [m]; fields are named within the section."""
        yield from ()

    def list_paths(self) -> Iterator[tuple[str, str]]:
        """Yield field and path of each file that the section names."""
        yield from ()


@dataclass(frozen=True)
class TaskKind:
    """One kind of task.

    ``demand`` and ``plan`` are written ``module:object`` and imported when they are first needed, since the lower
    stages and the client know requests without what plans them.

    Attributes:
        name: of the kind.
        section: class of its section of a request.
        demand: its ``service.demands.kind.DemandPart``.
        plan: its ``service.tasks.kind.PlanPart``.
        field: of the section in a request; by default ``task.NAME``.
        variants: every ``TaskSection.variant`` of its requests.
    """

    name: str
    section: type[TaskSection]
    demand: str
    plan: str
    field: str = ""
    variants: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.field:
            object.__setattr__(self, "field", f"task.{self.name}")

    @property
    def counted_as(self) -> tuple[str, ...]:
        """Names under which budgets and metrics count its requests."""
        return self.variants or (self.name,)


def load_part(part: str) -> Any:
    """Import the object that ``module:object`` names."""
    module, _, name = part.partition(":")
    return getattr(importlib.import_module(module), name)
