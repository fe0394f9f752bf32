"""The plan part of a kind of task: how it is planned, and what the stages after planning ask of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.errors import RequestError, would_do
from service.request.schema import PlanRequest
from service.request.tasks.kind import TaskSection, load_part
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings
from service.verify import Target

if TYPE_CHECKING:
    from service.tasks.stances.poses import StanceTask

S = TypeVar("S", bound=TaskSection)


@dataclass(frozen=True)
class RequestedEnd:
    """End of a motion as the request has it, to be shown where no motion was found.

    Attributes:
        targets: of frames and joints.
        q: (n,) requested configuration, other joints as at the start; None if no joint is requested.
        poses: frame, place in the world (3,) [m], and orientation (3, 3) where one is requested.
    """

    targets: tuple[Target, ...] = ()
    q: Float[np.ndarray, "n"] | None = None
    poses: tuple[tuple[str, Float[np.ndarray, "3"], Float[np.ndarray, "3 3"] | None], ...] = ()


class PlanPart(ABC, Generic[S]):
    """How a kind of task is planned; a kind overrides what applies to it."""

    @property
    def leaves_start(self) -> bool:
        """Whether phases that leave an unfit start come first."""
        return True

    @abstractmethod
    def plan(self, section: S, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans of the whole task; the next is made on demand.

        Raises:
            RequestError: the request does not fit its robot or scene.
            StaticRegionError: the ground does not hold the robot under the loads of the task.
        """

    @property
    def has_stances(self) -> bool:
        """Whether a place to stand can be searched for."""
        return False

    def find_stance_task(
        self, section: S, setup: PlanSetup, body: WholeBody
    ) -> tuple[StanceTask, tuple[str, ...]] | str:
        """Return what a search for a place to stand needs, with notes; a sentence where nothing is found to move."""
        return f"{setup.request.kind.field} moves no mechanism"

    def get_end(self, section: S, setup: PlanSetup) -> RequestedEnd | None:
        """Return the end that the request names; None if it names none."""
        return None

    def displace(
        self, request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
    ) -> tuple[PlanRequest, Surroundings | None]:
        """Return a request, and what its scan shows, with one of its targets displaced by ``offset`` [m].

        Raises:
            RequestError: there is no such target, or the record does not show it.
        """
        check_displaceable(target, ())
        return request, around


def find_plan_part(request: PlanRequest) -> PlanPart[Any]:
    """Return the plan part of a request's kind."""
    part: PlanPart[Any] = load_part(request.kind.plan)
    return part


def check_displaceable(target: str, known: Sequence[str]) -> None:
    """Refuse a target that cannot be displaced (RequestError)."""
    if target not in known:
        expected = f"expected {would_do(target, known)}" if known else "only poses of a goal, valves and doors can be"
        raise RequestError(f"adjust: this plan has no target {target!r} that can be displaced; {expected}")


def displace_place(place: tuple[float, float, float], offset: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Return a place of a request moved by an offset in world axes [m]."""
    x, y, z = (np.asarray(place) + offset).tolist()
    return x, y, z
