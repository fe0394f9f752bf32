"""Every call is counted with its end, and what workers and stores do is told to whoever looks."""

from __future__ import annotations

import asyncio
import re
import urllib.request
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import grpc
import pytest
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from small_service import end_of, serving

from service.executor import PoolStats, WorkerState, WorkerStats
from service.proto.planner.v1 import planner_pb2, planner_pb2_grpc
from service.store import CloudStore, Store
from service.telemetry import (
    Later,
    Metrics,
    MetricsServer,
    PlanCounts,
    SentSpans,
    TelemetryError,
    TelemetryInterceptor,
    sum_phases,
)
from service.trust import AccessInterceptor, ClientLimiter


def _samples(metrics: Metrics) -> dict[tuple[str, ...], float]:
    """All samples by name and label values."""
    families = text_string_to_metric_families(generate_latest(metrics.registry).decode())
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }


def _count_ended(metrics: Metrics) -> float:
    return sum(value for key, value in _samples(metrics).items() if key[0] == "scopt_requests_total")


async def _until(is_true: Callable[[], bool]) -> None:
    """Wait until something has happened, at most a minute."""
    for _ in range(1200):
        if is_true():
            return
        await asyncio.sleep(0.05)


def _run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, 240))


def test_every_call_is_counted_with_the_code_it_ended_with() -> None:
    metrics, later = Metrics(), Later()
    telemetry = TelemetryInterceptor(metrics, later=later)

    async def calls() -> None:
        async with (
            serving([telemetry, AccessInterceptor(None, ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            await stub.ListRobots(planner_pb2.ListRobotsRequest())
            for request_id in ("good", "abort", "raise"):
                await end_of(stub.Plan(planner_pb2.PlanRequest(request_id=request_id)))
            cancelled = stub.UploadCloud()
            await cancelled.write(planner_pb2.UploadCloudRequest(chunk=b"x"))
            await _until(lambda: _samples(metrics).get(("scopt_requests_open", "UploadCloud")) == 1)
            cancelled.cancel()
            await _until(lambda: _count_ended(metrics) >= 5)
            for n_late in range(1, 40):  # the server may hear of the client's own deadline first, and counts a cancel
                await stub.UploadCloud(timeout=0.1).code()
                await _until(lambda count=5 + n_late: _count_ended(metrics) >= count)
                if ("scopt_requests_total", "DEADLINE_EXCEEDED", "UploadCloud") in _samples(metrics):
                    break
            await end_of(channel.unary_unary("/planner.v1.PlannerService/MadeUp")(b""))

    _run(calls())
    later.finish()
    samples = _samples(metrics)
    ended = {key[1:]: value for key, value in samples.items() if key[0] == "scopt_requests_total"}
    assert ended.pop(("CANCELLED", "UploadCloud")) >= 1
    assert ended == {
        ("OK", "ListRobots"): 1,
        ("OK", "Plan"): 1,
        ("INVALID_ARGUMENT", "Plan"): 1,
        ("INTERNAL", "Plan"): 1,
        ("DEADLINE_EXCEEDED", "UploadCloud"): 1,
    }
    assert samples["scopt_request_seconds_count", "Plan"] == 3
    assert all(value == 0 for key, value in samples.items() if key[0] == "scopt_requests_open")


def test_an_exception_nobody_expected_tells_the_client_only_where_to_find_it() -> None:
    async def calls() -> None:
        async with (
            serving([TelemetryInterceptor(Metrics())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            call = planner_pb2_grpc.PlannerServiceStub(channel).Plan(planner_pb2.PlanRequest(request_id="raise"))
            code, words = await end_of(call)
            assert code is grpc.StatusCode.INTERNAL
            assert re.fullmatch(r"internal error [0-9a-f]{8}, please report it; the server's log tells more", words)

    _run(calls())


def test_steps_of_a_plan_are_told_as_phases() -> None:
    timings = {"queue": 1.0, "load_robot": 2.0, "build_scene": 3.0, "perceive": 4.0, "reach": 5.0, "sampling": 6.0}
    timings |= {"certificate": 7.0, "curve and timing": 8.0, "total": 36.0}
    expected = {"queue": 1.0, "set-up": 5.0, "perceive": 4.0, "solve": 11.0, "certificate": 7.0}
    assert sum_phases(timings) == expected | {"timing": 8.0, "total": 36.0}


def test_verdicts_and_phases_are_counted_by_kind() -> None:
    metrics = Metrics()
    metrics.plan_finished("valve", "CERTIFIED", {"turn": 2.0, "certificate": 0.3, "total": 2.5})
    metrics.plan_finished("valve", "NOT_FOUND", {"turn": 60.0, "total": 60.0})
    metrics.plan_finished("goal", "CERTIFIED", {})
    metrics.upload_finished(1000)
    samples = _samples(metrics)
    assert samples["scopt_verdicts_total", "valve", "CERTIFIED"] == 1
    assert samples["scopt_verdicts_total", "valve", "NOT_FOUND"] == 1
    assert samples["scopt_plan_phase_seconds_sum", "valve", "solve"] == 62.0
    assert samples["scopt_plan_phase_seconds_count", "valve", "certificate"] == 1
    assert samples["scopt_upload_bytes_total",] == 1000
    assert samples["process_resident_memory_bytes",] > 0


def test_workers_and_stores_are_asked_when_somebody_looks(tmp_path: Path) -> None:
    metrics = Metrics()
    workers = (
        WorkerStats(11, WorkerState.BUSY, 5, 1000),
        WorkerStats(12, WorkerState.IDLE, 6, 2000),
        WorkerStats(None, WorkerState.STARTING, 0, 0),
    )
    with Store(tmp_path / "plans") as store, CloudStore(tmp_path / "clouds") as clouds:
        metrics.watch(pool=lambda: PoolStats(workers, 3, 7, 1, 11), store=store, clouds=clouds)
        plan_id = store.plans.begin("ann", "r", "a" * 64, "goal").plan_id
        store.plans.finish(plan_id, "CERTIFIED", b"reply")
        with clouds.upload("ann", ".pcd") as upload:
            upload.write(b"0123")
            samples = _samples(metrics)
    assert samples["scopt_queue_length",] == 7
    assert samples["scopt_jobs_running",] == 1
    assert samples["scopt_worker_restarts_total",] == 3
    assert [samples["scopt_workers", state] for state in ("busy", "idle", "starting")] == [1, 1, 1]
    assert [samples["scopt_worker_rss_bytes", str(number)] for number in range(3)] == [1000, 2000, 0]
    assert samples["scopt_store_bytes", "plans"] == 5
    assert samples["scopt_store_bytes", "clouds"] == 4
    assert samples["scopt_store_entries", "plans"] == 1
    assert samples["scopt_uploads_open",] == 1


def test_metrics_are_shown_on_this_machine() -> None:
    metrics = Metrics()
    metrics.upload_finished(7)
    with MetricsServer("127.0.0.1:0", metrics.registry) as server:
        with urllib.request.urlopen(f"http://{server.address}/metrics", timeout=60) as answer:
            assert b"scopt_upload_bytes_total 7.0" in answer.read()
        with pytest.raises(TelemetryError, match=r"cannot listen there \(Address already in use\)"):
            MetricsServer(server.address, metrics.registry)


@pytest.mark.parametrize(
    "address", ["0.0.0.0:9464", "10.0.0.7:9464", ":9464", "9464", "localhost:http", "127.0.0.1:70000"]
)
def test_metrics_are_shown_to_no_other_machine(address: str) -> None:
    with pytest.raises(TelemetryError, match=r"such as 127\.0\.0\.1:9464"):
        MetricsServer(address, Metrics().registry)


def test_metrics_are_shown_to_other_machines_on_request_only() -> None:
    with MetricsServer("0.0.0.0:0", Metrics().registry, is_remote=True) as server:
        assert server.address.startswith("0.0.0.0:")
    with pytest.raises(TelemetryError, match=r"--metrics ':0': expected HOST:PORT"):
        MetricsServer(":0", Metrics().registry, is_remote=True)


def test_times_of_solves_have_nothing_else_in_them() -> None:
    counts = PlanCounts()
    others = {"load_robot": 10.0, "perceive": 20.0, "curve and timing": 30.0, "certificate": 40.0, "queue": 50.0}
    for seconds in (1.0, 2.0, 3.0):
        counts.add("CERTIFIED", {**others, "reach": seconds / 2, "sampling": seconds / 2, "total": 100.0})
    counts.add("INFEASIBLE", {**others, "total": 100.0})
    assert [counts.solve_percentile(share) for share in (0.0, 50.0, 99.0)] == [1.0, 2.0, 3.0]
    assert counts.verdicts == {"CERTIFIED": 3, "INFEASIBLE": 1}
    assert PlanCounts().solve_percentile(50.0) == 0.0


def test_a_call_is_a_span_of_the_clients_trace_with_its_code_and_no_metadata() -> None:
    exporter = InMemorySpanExporter()
    spans = SentSpans(exporter=exporter)
    trace = "0af7651916cd43dd8448eb211c80319c"

    async def calls() -> None:
        async with (
            serving([TelemetryInterceptor(Metrics(), spans), AccessInterceptor(None, ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            metadata = (("traceparent", f"00-{trace}-b7ad6b7169203331-01"), ("authorization", "Bearer s3cret"))
            await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=metadata)
            await end_of(stub.Plan(planner_pb2.PlanRequest(request_id="raise")))

    _run(calls())
    spans.close()
    good, bad = exporter.get_finished_spans()
    assert good.name == "planner.v1.PlannerService/ListRobots"
    assert format(good.context.trace_id, "032x") == trace
    assert good.attributes["rpc.grpc.status_code"] == "OK"
    assert (bad.attributes["rpc.grpc.status_code"], bad.status.is_ok) == ("INTERNAL", False)
    assert "s3cret" not in good.to_json()
    assert not bad.events


def test_without_opentelemetry_spans_say_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(TelemetryError, match=r"pip install 'scopt\[otel\]'"):
        SentSpans("http://127.0.0.1:4317")
