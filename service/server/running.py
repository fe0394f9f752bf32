"""Plans that are being worked on, and whoever watches them: any number of calls may wait for one plan."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from typing import Any

from service.proto.planner.v1.planner_pb2 import PlanFinished, PlanProgress, PlanQueued, PlanResponse
from service.server.workshop import Piece, Workshop
from service.trust.rpc import Refusal


class RunningPlan:
    """One plan from its acceptance to its end.

    Watchers get the newest state rather than all of them: one that reads slowly misses steps, and holds nobody up. When
    the last of them goes before the end, the plan is stopped.

    Args:
        workshop: where it is worked on.

    Attributes:
        plan_id: of the store; empty until it is written there.
    """

    def __init__(self, workshop: Workshop) -> None:
        self.plan_id = ""
        self._workshop = workshop
        self._piece: Piece[Any] | None = None
        self._latest: PlanResponse | None = None
        self._version = 0
        self._changed = asyncio.Event()
        self._deadlines: list[float] = []  # of those who watch
        self._was_watched = self._is_stopping = False
        self._end: PlanFinished | Refusal | None = None
        self._at_end: list[Callable[[], object]] = [workshop.on_change(self._tell_place)]

    @property
    def is_stopping(self) -> bool:
        """Whether it was stopped because nobody watched any more, and has not ended yet."""
        return self._is_stopping

    @property
    def has_begun(self) -> bool:
        """Whether a worker is at it."""
        return self._piece is not None and self._piece.job.started is not None

    def worked_on_by(self, piece: Piece[Any]) -> None:
        """It has been handed to the workshop."""
        self._piece = piece
        if self._is_stopping:  # whoever asked has gone while it was handed over
            piece.cancel()
        self._tell_place()

    def progress(self, event: bytes) -> None:
        """What the worker reports: a serialized ``PlanProgress``."""
        self._tell(PlanResponse(progress=PlanProgress.FromString(event)))

    def finish(self, finished: PlanFinished) -> None:
        """It has come to a verdict."""
        self._close(finished)

    def fail(self, refusal: Refusal) -> None:
        """It has come to nothing."""
        self._close(refusal)

    def forget(self) -> None:
        """It has never begun, and nobody waits for it."""
        self._ended()

    @property
    def awaited_until(self) -> float | None:
        """The latest deadline of those who watch, on the clock of ``time.monotonic`` [s]; None where one has none."""
        latest = max(self._deadlines, default=0.0)
        return None if latest == math.inf else latest

    def is_awaited_beyond(self, deadline: float | None) -> bool:
        """Whether somebody has time for more than what had to be done by a deadline."""
        return deadline is not None and max(self._deadlines, default=0.0) > deadline

    @contextmanager
    def watched(self, deadline: float | None) -> Iterator[bool]:
        """Somebody watches while the body runs; yields whether nobody has before."""
        is_first, self._was_watched = not self._was_watched, True
        own = math.inf if deadline is None else deadline
        self._deadlines.append(own)
        try:
            yield is_first
        finally:
            self._deadlines.remove(own)
            if not self._deadlines and self._end is None:
                self._is_stopping = True
                if self._piece is not None:
                    self._piece.cancel()

    async def events(self) -> AsyncIterator[PlanResponse]:
        """What happens from now on, up to the end.

        Raises:
            Refusal: it came to nothing.
        """
        seen = 0
        while self._end is None:
            if self._version > seen and self._latest is not None:
                seen = self._version
                yield self._latest
            else:
                await self._changed.wait()
        if isinstance(self._end, Refusal):
            raise self._end
        yield PlanResponse(finished=self._end)

    def at_end(self, do: Callable[[], object]) -> None:
        """Have something done at the end, before anybody hears of it."""
        self._at_end.append(do)

    async def ended(self) -> None:
        """Wait for the end."""
        while self._end is None:
            await self._changed.wait()

    def _tell_place(self) -> None:
        if not self._workshop.admission.queued:
            return
        place = None if self._piece is None else self._workshop.place(self._piece)
        if place is not None:
            wait = self._workshop.admission.expected_wait_s()
            self._tell(PlanResponse(queued=PlanQueued(place=place, expected_wait_s=wait)))

    def _tell(self, response: PlanResponse) -> None:
        self._latest = response
        self._version += 1
        self._wake()

    def _close(self, end: PlanFinished | Refusal) -> None:
        self._end = end
        self._ended()
        self._wake()

    def _ended(self) -> None:
        for do in self._at_end:
            do()

    def _wake(self) -> None:
        # Everyone who waits has this very event; whoever comes later waits for the next.
        self._changed.set()
        self._changed = asyncio.Event()


class RunningPlans:
    """The plans under way, by id."""

    def __init__(self) -> None:
        self._plans: dict[str, RunningPlan] = {}

    def __len__(self) -> int:
        return len(self._plans)

    def get(self, plan_id: str) -> RunningPlan | None:
        """A plan that is under way."""
        return self._plans.get(plan_id)

    def add(self, plan: RunningPlan) -> None:
        """Keep a plan findable up to its end.

        Whoever waited for the end finds it no more: asking again then is asking for another plan under the same id.
        """
        self._plans[plan.plan_id] = plan
        plan.at_end(lambda: self._plans.pop(plan.plan_id, None))
