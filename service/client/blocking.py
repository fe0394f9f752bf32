"""Blocking client: the asynchronous client's methods over a transport that blocks."""

from __future__ import annotations

import functools
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from service.client.asynchronous import AsyncPlannerClient
from service.client.errors import PlannerError
from service.client.retry import Retry
from service.client.transport import BlockingTransport

P = ParamSpec("P")
R = TypeVar("R")


class _UnsuspendedClient(AsyncPlannerClient):
    """Client whose coroutines run to their end at the first step, without an event loop.

    ``grpc.aio`` in a background loop would do worse than a blocking channel: with grpcio 1.76 it logs
    ``BlockingIOError`` in processes with a second loop (grpc/grpc#42357), and it may lose answers of uploads
    (``errors.ANSWER_LOST``).
    """

    _transport_type = BlockingTransport


def _run(coroutine: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine that never suspends."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: R = end.value
        return result
    raise RuntimeError("a call of the blocking client suspended")


def _block(
    method: Callable[Concatenate[AsyncPlannerClient, P], Coroutine[Any, Any, R]],
) -> Callable[Concatenate[PlannerClient, P], R]:
    """Return the blocking form of a coroutine method, with its signature and docstring."""

    @functools.wraps(method)
    def call(client: PlannerClient, /, *arguments: P.args, **named: P.kwargs) -> R:
        return _run(method(client._calls, *arguments, **named))

    return call


def _iterate(
    method: Callable[Concatenate[AsyncPlannerClient, P], AsyncGenerator[R, None]],
) -> Callable[Concatenate[PlannerClient, P], Generator[R, None, None]]:
    """Return the blocking form of an asynchronous generator method, with its signature and docstring."""

    @functools.wraps(method)
    def call(client: PlannerClient, /, *arguments: P.args, **named: P.kwargs) -> Generator[R, None, None]:
        return _iterate_blocking(method(client._calls, *arguments, **named))

    return call


def _iterate_blocking(events: AsyncGenerator[R, None]) -> Generator[R, None, None]:
    try:
        while True:
            try:
                event = _run(events.__anext__())
            except StopAsyncIteration:
                return
            yield event
    finally:
        _run(events.aclose())


class PlannerClient:
    """Blocking client of a planning server.

    Several threads may use it at the same time, also where an asyncio event loop runs (Jupyter); it starts no loop and
    no thread. Each method has the arguments and errors of its namesake in ``AsyncPlannerClient``. An exception in the
    meantime, ``KeyboardInterrupt`` included, cancels the call on the server.
    """

    def __init__(
        self,
        target: str,
        *,
        tls_ca: str | Path | None = None,
        tls_cert: str | Path | None = None,
        tls_key: str | Path | None = None,
        token: str | None = None,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        on_retry: Callable[[PlannerError, float], None] | None = None,
    ) -> None:
        self._calls = _UnsuspendedClient(
            target,
            tls_ca=tls_ca,
            tls_cert=tls_cert,
            tls_key=tls_key,
            token=token,
            timeout_s=timeout_s,
            retry=retry,
            on_retry=on_retry,
        )

    __init__.__doc__ = AsyncPlannerClient.__init__.__doc__

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    close = _block(AsyncPlannerClient.close)
    plan = _block(AsyncPlannerClient.plan)
    plan_events = _iterate(AsyncPlannerClient.plan_events)
    with_uploads = _block(AsyncPlannerClient.with_uploads)
    upload_cloud = _block(AsyncPlannerClient.upload_cloud)
    build_scene = _block(AsyncPlannerClient.build_scene)
    get_scene = _block(AsyncPlannerClient.get_scene)
    detect = _block(AsyncPlannerClient.detect)
    verify = _block(AsyncPlannerClient.verify)
    simulate = _block(AsyncPlannerClient.simulate)
    robots = _block(AsyncPlannerClient.robots)
    get_plan = _block(AsyncPlannerClient.get_plan)
    list_plans = _iterate(AsyncPlannerClient.list_plans)
    list_scenes = _iterate(AsyncPlannerClient.list_scenes)
    review = _block(AsyncPlannerClient.review)
    revoke = _block(AsyncPlannerClient.revoke)
    pose_session = _iterate(AsyncPlannerClient.pose_session)
    take_control = _block(AsyncPlannerClient.take_control)
    command = _block(AsyncPlannerClient.command)
    execute = _block(AsyncPlannerClient.execute)
    watch = _iterate(AsyncPlannerClient.watch)
    status = _block(AsyncPlannerClient.status)
