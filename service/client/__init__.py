"""Clients of a planning server, blocking and for asyncio; they load nothing of the server or the planner."""

from service.client.answers import FinishedPlan, StoredPlan
from service.client.asynchronous import AsyncPlannerClient
from service.client.blocking import PlannerClient
from service.client.errors import FieldViolation, PlannerError
from service.client.retry import Retry

__all__ = [
    "AsyncPlannerClient",
    "FieldViolation",
    "FinishedPlan",
    "PlannerClient",
    "PlannerError",
    "Retry",
    "StoredPlan",
]
