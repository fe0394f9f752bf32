"""Logs are lines that machines and people read, and hold no secrets whatever is logged."""

from __future__ import annotations

import asyncio
import io
import json
import logging
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import grpc
import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st
from small_service import end_of, serving

from service.proto.planner.v1 import planner_pb2, planner_pb2_grpc
from service.telemetry import Later, Metrics, TelemetryInterceptor, bind, remove_secrets, set_up_logs
from service.trust import AccessInterceptor, ClientLimiter, Role, Tokens, make_token


@pytest.fixture
def log() -> Iterator[io.StringIO]:
    """What is logged as JSON; how logging was is put back."""
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    stream = io.StringIO()
    set_up_logs(stream, level="debug")
    yield stream
    root.handlers[:], root.level = handlers, level
    structlog.reset_defaults()
    structlog.contextvars.clear_contextvars()


def _lines(log: io.StringIO) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.getvalue().splitlines()]


def test_a_line_is_json_with_time_level_and_what_was_bound_to_the_request(log: io.StringIO) -> None:
    bind(request_id="r1", plan_id="p1")
    structlog.get_logger("scopt.test").info("planned", verdict="CERTIFIED", seconds=1.5)
    (line,) = _lines(log)
    assert line.pop("timestamp").endswith("Z")
    assert line == {
        "event": "planned",
        "level": "info",
        "logger": "scopt.test",
        "request_id": "r1",
        "plan_id": "p1",
        "verdict": "CERTIFIED",
        "seconds": 1.5,
    }


def test_what_libraries_log_is_a_line_of_the_same_kind(log: io.StringIO) -> None:
    logging.getLogger("grpc").warning("went %s", "away", extra={"peer": "x"})
    (line,) = _lines(log)
    assert (line["event"], line["level"], line["logger"], line["peer"]) == ("went away", "warning", "grpc", "x")


def test_only_what_is_at_least_of_the_level_is_logged(log: io.StringIO) -> None:
    set_up_logs(log, level="warning")
    structlog.get_logger("scopt.test").info("quiet")
    structlog.get_logger("scopt.test").warning("loud")
    assert [line["event"] for line in _lines(log)] == ["loud"]


def test_nothing_forges_a_line_or_fills_the_disk(log: io.StringIO) -> None:
    structlog.get_logger("scopt.test").info("a\nb\x1b[31m", value="x" * 10_000, nested={"k\n": ["\r" * 5000]})
    (line,) = _lines(log)
    assert line["event"] == "a\\nb\\x1b[31m"
    assert line["value"].endswith("… (10000 characters)")
    assert len(json.dumps(line)) < 20_000


def test_numbers_that_json_does_not_have_are_texts(log: io.StringIO) -> None:
    structlog.get_logger("scopt.test").info("draining", at_most_s=float("inf"), more=[float("nan"), 1.0])
    line = json.loads(log.getvalue(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert (line["at_most_s"], line["more"]) == ("inf", ["nan", 1.0])


def test_a_traceback_comes_without_the_values_of_variables(log: io.StringIO) -> None:
    hidden = "value of a variable"
    try:
        raise RuntimeError("broke")
    except RuntimeError:
        structlog.get_logger("scopt.test").exception("failed")
    (line,) = _lines(log)
    assert "RuntimeError: broke" in line["exception"]
    assert hidden not in log.getvalue()


def test_at_a_terminal_lines_are_for_people() -> None:
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    stream = io.StringIO()
    try:
        set_up_logs(stream, as_json=False)
        structlog.get_logger("scopt.test").info("planned\x1b[31m", verdict="CERTIFIED")
        try:
            raise RuntimeError("broke")
        except RuntimeError:
            structlog.get_logger("scopt.test").exception("failed")
    finally:
        root.handlers[:], root.level = handlers, level
        structlog.reset_defaults()
    text = stream.getvalue()
    assert "planned\\x1b[31m" in text
    assert "verdict=CERTIFIED" in text
    assert "RuntimeError: broke" in text
    assert not text.startswith("{")


TOKEN = "scopt_" + "Ab1-_" * 8


@pytest.mark.parametrize(
    "text",
    [
        f"the token {TOKEN}.",
        f"authorization: Bearer {TOKEN}",
        "Authorization: bearer abc.def-123",
        '{"authorization": "Bearer abc.def-123"}',
        "(('authorization', 'Bearer abc.def-123'),)",
        "authorization: Basic YWJjLmRlZi0xMjM=",
        "-----BEGIN PRIVATE KEY-----\nabc.def-123\n-----END PRIVATE KEY-----",
        "-----BEGIN EC PRIVATE KEY-----\nabc.def-123",
    ],
)
def test_secrets_are_taken_out_of_any_text(text: str) -> None:
    clean = remove_secrets(text)
    assert "[secret]" in clean
    assert TOKEN not in clean
    assert "abc.def-123" not in clean
    assert "YWJj" not in clean


def test_a_token_that_is_logged_by_mistake_is_not_in_the_line(log: io.StringIO) -> None:
    logger = structlog.get_logger("scopt.test")
    logger.info(f"with {TOKEN}", value=TOKEN, nested={"metadata": [("authorization", f"Bearer {TOKEN}")]})
    logging.getLogger("library").info("got %s", TOKEN)
    try:
        raise RuntimeError(f"broke on {TOKEN}")
    except RuntimeError:
        logger.exception("failed")
    assert len(_lines(log)) == 3
    assert log.getvalue().count("[secret]") >= 5
    assert TOKEN not in log.getvalue()


@given(st.text(), st.text())
def test_a_token_is_found_wherever_it_stands(before: str, after: str) -> None:
    assert TOKEN not in remove_secrets(f"{before}{TOKEN}{after}")


def test_no_token_is_in_the_log_of_calls_good_refused_and_broken(log: io.StringIO, tmp_path: Path) -> None:
    token, line = make_token("ann", [Role.PLAN])
    wrong, _ = make_token("ann", [Role.PLAN])
    path = tmp_path / "tokens.yaml"
    path.write_text(line)
    path.chmod(0o600)
    later = Later()
    telemetry = TelemetryInterceptor(Metrics(), later=later)

    async def calls() -> None:
        async with (
            serving([telemetry, AccessInterceptor(Tokens(path), ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            for value in (token, wrong):
                metadata = (("authorization", f"Bearer {value}"), ("x-api-key", "k3y-0f-a-stranger"))
                for request_id in ("good", "abort", "raise"):
                    await end_of(stub.Plan(planner_pb2.PlanRequest(request_id=request_id), metadata=metadata))

    asyncio.run(asyncio.wait_for(calls(), 20))
    later.finish()
    for secret in (token, wrong, "k3y-0f-a-stranger", "Bearer"):
        assert secret not in log.getvalue()
    ends = [(line["code"], line["client"]) for line in _lines(log) if line["event"] == "rpc"]
    assert ends == [
        ("OK", "ann"),
        ("INVALID_ARGUMENT", "ann"),
        ("INTERNAL", "ann"),
        *[("UNAUTHENTICATED", "127.0.0.1")] * 3,
    ]


def test_what_nobody_waits_for_is_done_later_in_order_and_in_its_own_context() -> None:
    variable = ContextVar("variable", default="none")
    seen: list[tuple[str, str]] = []

    async def run() -> None:
        later = Later()
        for name in ("first", "second", "third"):
            variable.set(name)
            later.call(lambda name=name: seen.append((name, variable.get())))
        assert seen == []
        while not seen:
            await asyncio.sleep(0.002)
        later.finish()
        later.call(seen.clear)  # is not called any more: the loop ends before

    asyncio.run(run())
    assert seen == [("first", "first"), ("second", "second"), ("third", "third")]
