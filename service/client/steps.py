"""How far a call had come when its time was over."""

from __future__ import annotations

import grpc

from service.client.errors import PlannerError
from service.proto.planner.v1.planner_pb2 import BuildSceneResponse, PlanResponse

# What gRPC and a server say of a deadline that passed; a server that refuses at once for a near one says more.
PASSED = ("Deadline Exceeded", "the deadline passed")


class LastStep:
    """Remembers what the events of a stream say is being done."""

    def __init__(self) -> None:
        self._words = ""

    def take(self, event: object) -> None:
        """The next event."""
        if isinstance(event, BuildSceneResponse) and event.step:
            self._words = f"; it was at {event.step!r}"
        elif isinstance(event, PlanResponse) and event.HasField("queued"):
            self._words = "; it was waiting in the queue"
        elif isinstance(event, PlanResponse) and event.HasField("progress"):
            self._words = f"; it was at {event.progress.step!r}"

    def told(self, error: PlannerError, deadline_s: float | None) -> PlannerError:
        """The error; of a deadline that passed, with what was going on."""
        is_late = error.code is grpc.StatusCode.DEADLINE_EXCEEDED and any(words in error.text for words in PASSED)
        if not is_late or deadline_s is None:
            return error
        return PlannerError(error.code, f"no answer within {deadline_s:.3g} s{self._words}")
