"""Which tasks can be planned: known without loading what plans them."""

from __future__ import annotations

from service.errors import UnplannedTaskError
from service.request.schema import PlanRequest

UNPLANNED = {"door": "doors", "egress": "getting out of vehicles"}


def check_planned(request: PlanRequest) -> None:
    """
    Raises:
        UnplannedTaskError: the task is one that nothing here can plan yet.
    """
    for name, words in UNPLANNED.items():
        if request.task is not None and getattr(request.task, name) is not None:
            raise UnplannedTaskError(
                f"task.{name}: there is no planner for {words} yet; task.valve, task.trajopt and goals are planned"
            )
