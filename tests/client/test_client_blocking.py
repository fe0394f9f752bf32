"""The blocking client over the asynchronous one: signatures, event loops, threads, cancellation, interpreter exit."""

from __future__ import annotations

import asyncio
import gc
import inspect
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from planner_clients import CLIENTS
from planner_stand_in import PLAN_ID, PlannerStandIn, accepted, slow_plan

from service.client import AsyncPlannerClient, PlannerClient, PlannerError, Retry
from service.errors import RequestError
from service.proto.planner.v1 import planner_pb2 as pb
from service.request.file import parse_request

REQUEST = parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}})
ROOT = Path(__file__).parents[2]


def test_both_clients_have_the_same_methods_arguments_and_docstrings() -> None:
    def public(kind: type) -> dict[str, Any]:
        members = inspect.getmembers(kind, inspect.isfunction)
        return {name: member for name, member in members if not name.startswith("_") or name == "__init__"}

    blocking, asynchronous = public(PlannerClient), public(AsyncPlannerClient)
    assert blocking.keys() == asynchronous.keys()
    for name, method in blocking.items():
        assert inspect.signature(method) == inspect.signature(asynchronous[name])
        assert method.__doc__ == asynchronous[name].__doc__
        assert method.__doc__


@pytest.mark.parametrize("kind", CLIENTS)
@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"tls_authority": "ca.pem"}, "unexpected keyword argument 'tls_authority'"),
        ({"token": b"secret"}, "token: expected str, got bytes"),
        ({"tls_ca": 5}, "expected str"),
        ({"timeout_s": "30"}, "not supported between"),
        ({"target": 50051}, "target: expected str, got int"),
    ],
)
def test_arguments_of_a_wrong_name_or_type_are_type_errors(kind: str, arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(TypeError, match=problem):
        CLIENTS[kind](**({"target": "localhost:1"} | arguments))


@pytest.mark.parametrize("kind", CLIENTS)
@pytest.mark.parametrize("seconds", [-1.0, float("inf"), float("nan")])
def test_a_limit_that_is_no_duration_is_refused(kind: str, seconds: float) -> None:
    with pytest.raises(RequestError, match=f"timeout_s: {seconds:g} is no duration; expected seconds, 0 or more"):
        CLIENTS[kind]("localhost:1", timeout_s=seconds)


def test_arguments_of_methods_are_checked_at_the_call(connect: Callable[..., Any]) -> None:
    with connect() as client:
        for method in (client.plan, client.plan_events):
            with pytest.raises(TypeError, match="unexpected keyword argument 'deadline'"):
                method(REQUEST, deadline=1.0)
        with pytest.raises(RequestError, match="deadline_s: -1 is no duration"):
            client.plan(REQUEST, deadline_s=-1.0)


def test_closing_or_dropping_the_iterator_stops_the_plan(stand_in: PlannerStandIn, target: str) -> None:
    for end in ("close", "drop"):
        stand_in.stopped.clear()
        stand_in.plans.append(slow_plan(stand_in))
        with PlannerClient(target) as client:
            events = client.plan_events(REQUEST)
            assert next(events).WhichOneof("event") == "accepted"
            if end == "close":
                events.close()
                assert list(events) == []
            del events
            gc.collect()
            assert stand_in.stopped.wait(60.0)
            assert client.status().queued == 2


def test_an_iterator_that_was_never_started_sends_nothing(stand_in: PlannerStandIn, target: str) -> None:
    with PlannerClient(target) as client:
        client.plan_events(REQUEST).close()
        client.plan_events(REQUEST)
        gc.collect()
        assert client.status().queued == 2
    assert not any(isinstance(message, pb.PlanRequest) for message in stand_in.requests)


def test_a_callback_may_call_the_client(stand_in: PlannerStandIn, target: str) -> None:
    versions: list[str] = []
    with PlannerClient(target) as client:
        plan = client.plan(REQUEST, on_progress=lambda event: versions.append(client.status().version))
    assert plan.verdict == "CERTIFIED"
    assert versions == ["0.1.0"] * 4


def test_closing_the_client_ends_calls_of_other_threads(stand_in: PlannerStandIn, target: str) -> None:
    stand_in.plans.append(slow_plan(stand_in))
    errors: list[PlannerError] = []
    begun = threading.Event()
    client = PlannerClient(target)

    def plan() -> None:
        try:
            client.plan(REQUEST, on_progress=lambda event: begun.set())
        except PlannerError as error:
            errors.append(error)

    thread = threading.Thread(target=plan)
    thread.start()
    assert begun.wait(60.0)
    client.close()
    thread.join(60.0)
    assert not thread.is_alive()
    assert [error.code for error in errors] == [grpc.StatusCode.CANCELLED]
    assert stand_in.stopped.wait(60.0)


def test_a_client_starts_no_thread_of_its_own(stand_in: PlannerStandIn, target: str) -> None:
    names = set[str]()
    before = set(threading.enumerate())
    with PlannerClient(target) as client:
        client.plan(
            REQUEST, on_progress=lambda event: names.update(t.name for t in set(threading.enumerate()) - before)
        )
    assert not {name for name in names if "asyncio" in name.lower() or "loop" in name.lower()}
    left = [thread for thread in set(threading.enumerate()) - before if not thread.name.startswith("ThreadPool")]
    for thread in left:
        thread.join(60.0)
    assert not [thread.name for thread in left if thread.is_alive()]


def test_a_blocking_client_works_where_an_event_loop_runs(
    stand_in: PlannerStandIn, target: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def main() -> list[str]:
        with PlannerClient(target) as client:
            verdicts = [client.plan(REQUEST).verdict]
            events = client.plan_events(REQUEST)
            next(events)
            async with AsyncPlannerClient(target) as other:
                verdicts.append((await other.plan(REQUEST)).verdict)
                verdicts += [client.get_plan(PLAN_ID).verdict]
                verdicts += [event.WhichOneof("event") or "" for event in events][-1:]
            left_open = client.plan_events(REQUEST)
            next(left_open)
        return verdicts

    with caplog.at_level(logging.WARNING):
        assert asyncio.run(main(), debug=False) == ["CERTIFIED"] * 3 + ["finished"]
    assert caplog.records == []


def test_blocking_and_asynchronous_clients_of_several_threads_log_nothing(
    stand_in: PlannerStandIn, target: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def ask() -> None:
        async with AsyncPlannerClient(target) as client:
            for _ in range(20):
                await client.status()

    def block() -> None:
        with PlannerClient(target) as client:
            for _ in range(20):
                client.status()

    threads = [threading.Thread(target=work) for work in (lambda: asyncio.run(ask()), block, block)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(stand_in.requests) == 60
    assert caplog.records == []


@contextmanager
def interrupted() -> Iterator[None]:
    """Ctrl-C while the body waits, which ends the body."""
    timer = threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT))
    try:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012 -- the timer may ring at once
            timer.start()
            yield
    finally:
        timer.cancel()  # nobody else is to be interrupted


def test_ctrl_c_interrupts_a_waiting_iteration_and_a_delay(stand_in: PlannerStandIn, target: str) -> None:
    stand_in.plans.append(slow_plan(stand_in))
    with PlannerClient(target) as client:
        with interrupted():
            list(client.plan_events(REQUEST))
        assert stand_in.stopped.wait(60.0)
    with PlannerClient("localhost:1", retry=Retry(first_delay_s=10.0)) as client, interrupted():
        client.status()


@pytest.mark.parametrize("left_open", ["client", "iterator"])
def test_an_interpreter_with_an_open_client_ends_silently(
    stand_in: PlannerStandIn, target: str, left_open: str
) -> None:
    def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Any:
        yield accepted(request)
        context.add_callback(stand_in.stopped.set)
        stand_in.stopped.wait(120.0)

    stand_in.plans.append(plan)
    program = (
        "from service import parse_request\n"
        "from service.client import PlannerClient\n"
        f"client = PlannerClient({target!r})\n"
        "print(client.status().version)\n"
    )
    if left_open == "iterator":
        program += (
            "goal = {'joints': {'l_arm_elx': 1.2}}\n"
            "events = client.plan_events(parse_request({'robot': {'name': 'atlas'}, 'goal': goal}))\n"
            "next(events)\n"
        )
    command = [sys.executable, "-W", "error", "-X", "dev", "-c", program]
    variables = {**os.environ, "GRPC_VERBOSITY": "NONE", "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=variables)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "0.1.0\n", "")
    assert left_open == "client" or stand_in.stopped.wait(60.0)
