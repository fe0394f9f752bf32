"""Both clients behind one blocking interface, so that a test runs with either."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from service.client import AsyncPlannerClient, PlannerClient


class Blocked:
    """Asynchronous client whose calls are each run to their end."""

    def __init__(self, target: str, **settings: Any) -> None:
        self._loop = asyncio.new_event_loop()

        async def make() -> AsyncPlannerClient:
            return AsyncPlannerClient(target, **settings)

        try:
            self._client = self._loop.run_until_complete(make())
        except BaseException:
            self._loop.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.run_until_complete(self._client.close())
        self._loop.close()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self._client, name)

        def call(*arguments: Any, **named: Any) -> Any:
            async def run() -> Any:
                answer = method(*arguments, **named)
                return [one async for one in answer] if inspect.isasyncgen(answer) else await answer

            return self._loop.run_until_complete(run())

        return call


CLIENTS = {"blocking": PlannerClient, "asyncio": Blocked}
