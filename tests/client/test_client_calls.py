"""Both clients against a server that keeps the protocol, and against broken ones."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.protobuf.duration_pb2 import Duration
from google.rpc.error_details_pb2 import BadRequest, RetryInfo
from grpc.aio import AioRpcError, Metadata
from hypothesis import given
from hypothesis import strategies as st
from planner_clients import CLIENTS
from planner_stand_in import (
    FILES,
    PLAN_ID,
    PlannerStandIn,
    accepted,
    chunks,
    finished,
    make_result,
    refused,
    slow_plan,
    write_cloud,
)

from service.client import AsyncPlannerClient, FieldViolation, PlannerClient, PlannerError, Retry
from service.errors import RequestError, ResultError
from service.proto.planner.v1 import planner_pb2 as pb
from service.proto.planner.v1.result_pb2 import FileChunk
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.wire.requests import request_from_message, request_to_message

Code = grpc.StatusCode
REQUEST = parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}})
ROOT = Path(__file__).parents[2]


def _retry_after(seconds: float) -> RetryInfo:
    delay = Duration()
    delay.FromMilliseconds(round(1000 * seconds))
    return RetryInfo(retry_delay=delay)


def _with_scan(folder: Path, *names: str) -> PlanRequest:
    return parse_request(
        {"robot": {"name": "atlas"}, "task": {"valve": {}}, "scene": {"cloud": [{"file": name} for name in names]}},
        folder,
    )


def test_a_plan_comes_with_verdict_progress_and_files(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    seen: list[str | None] = []
    with connect() as client:
        plan = client.plan(
            REQUEST, request_id="mine", out=tmp_path / "plan", on_progress=lambda e: seen.append(e.WhichOneof("event"))
        )
    assert (plan.verdict, plan.plan_id, plan.request_id, plan.is_known) == ("CERTIFIED", PLAN_ID, "mine", False)
    assert plan.result == make_result()
    assert plan.folder == tmp_path / "plan"
    written = {path.relative_to(plan.folder).as_posix(): path.read_bytes() for path in plan.folder.rglob("*.*")}
    assert written == FILES
    assert [path.name for path in tmp_path.iterdir()] == ["plan"]
    assert seen == ["accepted", "queued", "progress", "progress"]
    assert request_from_message(stand_in.requests[0].request) == REQUEST


def test_events_come_in_the_servers_order(connect: Callable[..., Any], stand_in: PlannerStandIn) -> None:
    with connect() as client:
        events = list(client.plan_events(request_to_message(REQUEST), with_waypoints=True))
    assert [event.WhichOneof("event") for event in events] == ["accepted", "queued", "progress", "progress", "finished"]
    assert events[3].progress.iteration.violations["collision"] == 0.02
    assert stand_in.requests[0].with_waypoints
    assert not stand_in.requests[0].with_files
    assert len(stand_in.requests[0].request_id) > 30  # the same id gives the same plan again


def test_local_clouds_are_uploaded_once_and_other_paths_are_sent_unchanged(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    path = write_cloud(tmp_path, 1_200_000)
    request = _with_scan(tmp_path, "scan.pcd", "/robot/scans/other.pcd")
    with connect() as client:
        client.plan(request)
        assert stand_in.n_chunks == 3
        client.plan(request)
    (cloud_id,) = stand_in.clouds
    assert stand_in.clouds[cloud_id] == path.read_bytes()
    plans = [message for message in stand_in.requests if isinstance(message, pb.PlanRequest)]
    for message in plans:
        assert [cloud.file for cloud in message.request.scene.cloud.files.value] == [cloud_id, "/robot/scans/other.pcd"]


def test_a_local_scene_is_uploaded_and_a_built_scene_is_named_by_its_id(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    path = write_cloud(tmp_path, name="scene.json")
    built = "scene:" + "0" * 64
    with connect() as client:
        for file in ("scene.json", built):
            parts = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "scene": {"file": file}}
            client.plan(parse_request(parts, tmp_path))
    (scene_id,) = stand_in.clouds
    assert stand_in.clouds[scene_id] == path.read_bytes()
    plans = [message for message in stand_in.requests if isinstance(message, pb.PlanRequest)]
    assert [message.request.scene.file for message in plans] == [scene_id, built]


def test_the_chunks_of_a_known_cloud_are_not_sent(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_cloud(tmp_path, 40_000_000)
    from service.client import local_files

    read: list[int] = []
    read_chunks = local_files._read_chunks

    def counted(path: Path) -> Iterator[bytes]:
        for chunk in read_chunks(path):
            read.append(len(chunk))
            yield chunk

    cloud = local_files.hash_file(path)
    stand_in.clouds[f"sha256:{cloud.sha256}.pcd"] = b""
    monkeypatch.setattr(local_files, "_read_chunks", counted)
    with connect() as client:
        assert client.upload_cloud(path) == f"sha256:{cloud.sha256}.pcd"
        time.sleep(0.05)
    assert stand_in.n_chunks == 0
    # Once it was read for its hash; of the chunks as much as the connection takes before the server's early answer.
    assert sum(read) - 40_000_000 < 20_000_000


def test_a_cloud_deleted_during_its_upload_is_a_request_error(
    connect: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from service.client import local_files

    cloud = local_files.hash_file(write_cloud(tmp_path))
    monkeypatch.setattr("service.client.asynchronous.hash_file", lambda path: cloud)
    cloud.path.unlink()
    with connect() as client, pytest.raises(RequestError, match=r"scan\.pcd cannot be read: No such file"):
        client.upload_cloud(cloud.path)


def test_scenes_detections_verifications_and_robots(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    path, steps = write_cloud(tmp_path), list[str]()
    (tmp_path / "plan" / "robot").mkdir(parents=True)
    (tmp_path / "plan" / "result.json").write_text('{"format": "scopt-result/1"}')
    (tmp_path / "plan" / "robot" / "robot.urdf").write_text("<robot/>")
    (tmp_path / "plan" / "viewer.html").write_text("large")
    with connect() as client:
        scene = client.build_scene([path], detect=["valve"], unknown="occupied", method="coacd", on_step=steps.append)
        assert (scene.scene_id, steps) == ("s1", ["read cloud"])
        assert client.get_scene(scene.scene_id) == scene
        assert client.detect(str(path), "door", hint=(1.0, 0.0, 1.0)).hits[0].kind == "door"
        client.verify(PLAN_ID)
        client.verify(tmp_path / "plan")
        assert client.simulate(PLAN_ID, {"noise": 0.5, "seed": 3}).has_stood
        assert client.simulate(tmp_path / "plan").has_stood
        with pytest.raises(
            RequestError, match="noize: unknown option of a simulation; expected delay_ms, feed_forward"
        ):
            client.simulate(PLAN_ID, {"noize": 0.5})
        assert client.robots()[0].name == "atlas"
        assert client.status().workers[0].jobs_done == 17
        with pytest.raises(RequestError, match="unknown: expected free, occupied, got 'green'"):
            client.build_scene([path], unknown="green")
    (cloud_id,) = stand_in.clouds
    built, detected, by_id, by_files = (
        next(message for message in stand_in.requests if isinstance(message, kind) and wanted(message))
        for kind, wanted in (
            (pb.BuildSceneRequest, lambda m: True),
            (pb.DetectRequest, lambda m: True),
            (pb.VerifyRequest, lambda m: m.plan_id),
            (pb.VerifyRequest, lambda m: not m.plan_id),
        )
    )
    assert built.clouds.clouds[0].file == detected.clouds.clouds[0].file == cloud_id
    assert (list(built.detect), list(detected.hint), by_id.plan_id) == (["valve"], [1.0, 0.0, 1.0], PLAN_ID)
    assert {file.path: file.is_last for file in by_files.files} == {"result.json": True, "robot/robot.urdf": True}
    by_id, by_files = (message for message in stand_in.requests if isinstance(message, pb.SimulatePlanRequest))
    assert (by_id.plan_id, by_id.noise, by_id.seed, by_id.HasField("friction")) == (PLAN_ID, 0.5, 3, False)
    assert {file.path for file in by_files.files} == {"result.json", "robot/robot.urdf"}


def test_a_review_is_bound_to_the_hashes_of_the_record(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    with connect() as client:
        stored = client.get_plan(PLAN_ID, out=tmp_path / "plan")
        assert (tmp_path / "plan" / "viewer.html").read_bytes() == FILES["viewer.html"]
        review = client.review(stored.record, accept=True, comment="looks right")
        assert (review.decision, review.reviewer) == (pb.DECISION_ACCEPTED, "ada")
        stand_in.result.trajectory.sha256 = "0"
        with pytest.raises(PlannerError, match="FAILED_PRECONDITION: another plan was seen"):
            client.review(stored.record, accept=True)
        stand_in.state = pb.PLAN_STATE_RUNNING
        with pytest.raises(RequestError, match="is not finished"):
            client.review(client.get_plan(PLAN_ID).record, accept=False)


def test_a_wrong_hash_is_refused(connect: Callable[..., Any], stand_in: PlannerStandIn) -> None:
    stand_in.result.trajectory.positions[1] = 0.6
    with connect() as client, pytest.raises(PlannerError, match="DATA_LOSS: the trajectory's hash is") as caught:
        client.get_plan(PLAN_ID)
    assert caught.value.code is Code.DATA_LOSS
    result = make_result()
    result.certificate.json += b" "
    stand_in.plans.append(lambda request, context: iter([accepted(request), finished(result)]))
    with connect() as client, pytest.raises(PlannerError, match="the certificate's hash is"):
        client.plan(REQUEST)


def test_an_error_has_code_text_and_every_field(connect: Callable[..., Any], stand_in: PlannerStandIn) -> None:
    bad = BadRequest(field_violations=[{"field": "request.goal", "description": "goal: is missing"}] * 2)  # type: ignore[list-item]
    stand_in.plans.append(refused(Code.INVALID_ARGUMENT, "goal: is missing", bad))
    with connect() as client, pytest.raises(PlannerError) as caught:
        client.plan(REQUEST)
    assert (caught.value.code, caught.value.text) == (Code.INVALID_ARGUMENT, "goal: is missing")
    assert caught.value.violations == (FieldViolation("request.goal", "goal: is missing"),) * 2
    assert caught.value.problems == ("goal: is missing",) * 2
    assert caught.value.retry_delay_s is None


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff", b"", b"\x1a\x04\x0a\x02aa"])
def test_unreadable_details_leave_code_and_text(
    connect: Callable[..., Any], stand_in: PlannerStandIn, garbage: bytes
) -> None:
    def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        context.set_trailing_metadata((("grpc-status-details-bin", garbage),))
        context.abort(Code.INTERNAL, "incident 42")
        yield

    stand_in.plans.append(plan)
    with connect() as client, pytest.raises(PlannerError) as caught:
        client.plan(REQUEST)
    assert (caught.value.code, caught.value.problems) == (Code.INTERNAL, ("incident 42",))


def test_an_upload_whose_answer_the_client_lost_is_repeated(
    target: str, stand_in: PlannerStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_cloud(tmp_path)

    async def main() -> str:
        async with AsyncPlannerClient(target, retry=Retry(first_delay_s=0.01)) as client:
            stub = client._transport._stub
            upload = stub.UploadCloud
            lost = [AioRpcError(Code.INTERNAL, Metadata(), Metadata(), "Internal error from Core")]

            async def first_lost(*arguments: Any, **named: Any) -> Any:
                if lost:
                    raise lost.pop()
                return await upload(*arguments, **named)

            monkeypatch.setattr(stub, "UploadCloud", first_lost)
            return await client.upload_cloud(path)

    assert asyncio.run(main()) in stand_in.clouds


def test_a_request_to_an_overloaded_server_is_repeated_with_its_id_after_the_servers_delay(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    def lost(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        yield accepted(request)
        yield from (pb.PlanResponse(file=chunk) for chunk in chunks({"trajectory.csv": b"of before"}))
        context.abort(Code.UNAVAILABLE, "restarting")

    stand_in.plans += [refused(Code.RESOURCE_EXHAUSTED, "the queue is full", _retry_after(0.05)), lost]
    retries: list[tuple[Code, float]] = []
    retry = Retry(attempts=3, first_delay_s=0.01)
    with connect(retry=retry, on_retry=lambda error, delay: retries.append((error.code, delay))) as client:
        plan = client.plan(REQUEST, out=tmp_path / "plan")
    assert retries == [(Code.RESOURCE_EXHAUSTED, 0.05), (Code.UNAVAILABLE, 0.01)]
    assert len({message.request_id for message in stand_in.requests}) == 1
    assert len(stand_in.requests) == 3
    assert (plan.folder / "trajectory.csv").read_bytes() == FILES["trajectory.csv"]


def test_the_result_of_a_broken_attempt_does_not_count(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    def cut_off(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        yield accepted(request)
        yield finished()
        context.abort(Code.UNAVAILABLE, "restarting")

    stand_in.plans += [cut_off, lambda request, context: iter([accepted(request)])]
    with (
        connect(retry=Retry(first_delay_s=0.01)) as client,
        pytest.raises(PlannerError, match="ended the call without a plan"),
    ):
        client.plan(REQUEST, out=tmp_path / "plan")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("retry", "deadline_s", "delay_s", "n_requests"),
    [
        (Retry(attempts=1), None, 0.01, 1),
        (Retry(attempts=2), None, 0.01, 2),
        (Retry(max_delay_s=1.0), None, 2.0, 1),
        (Retry(), 5.0, 6.0, 1),
        (Retry(), None, None, 1),  # exhausted for good: too large a message, say
    ],
)
def test_attempts_are_limited(
    connect: Callable[..., Any],
    stand_in: PlannerStandIn,
    retry: Retry,
    deadline_s: float | None,
    delay_s: float | None,
    n_requests: int,
) -> None:
    details = () if delay_s is None else (_retry_after(delay_s),)
    stand_in.plans += [refused(Code.RESOURCE_EXHAUSTED, "the queue is full", *details)] * 9
    with connect(retry=retry) as client, pytest.raises(PlannerError, match="RESOURCE_EXHAUSTED") as caught:
        client.plan(REQUEST, deadline_s=deadline_s)
    assert caught.value.retry_delay_s == delay_s
    assert len(stand_in.requests) == n_requests


def test_a_deadline_ends_a_plan_and_its_error_names_the_last_step(
    connect: Callable[..., Any], stand_in: PlannerStandIn
) -> None:
    for deadline_s in (0.2, 2.0, 20.0):  # a busy machine comes to its first step later
        stand_in.plans.append(slow_plan(stand_in))
        with connect() as client, pytest.raises(PlannerError, match=f"no answer within {deadline_s:g} s") as caught:
            client.plan(REQUEST, deadline_s=deadline_s)
        assert stand_in.stopped.wait(60.0)
        if str(caught.value).endswith("last step: 'waiting'"):
            return
        stand_in.stopped.clear()
    pytest.fail(str(caught.value))


def test_a_deadline_includes_the_uploads(connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path) -> None:
    write_cloud(tmp_path)
    with connect() as client, pytest.raises(PlannerError, match="DEADLINE_EXCEEDED"):
        client.plan(_with_scan(tmp_path, "scan.pcd"), deadline_s=0.0)
    assert stand_in.requests == []


def test_an_exception_in_a_callback_stops_the_plan_and_writes_nothing(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    stand_in.plans.append(slow_plan(stand_in))

    def interrupt(event: pb.PlanResponse) -> None:
        if event.progress.step == "waiting":
            raise KeyError("enough")

    with connect() as client:
        with pytest.raises(KeyError):
            client.plan(REQUEST, out=tmp_path / "plan", on_progress=interrupt)
        assert stand_in.stopped.wait(60.0)
    assert list(tmp_path.iterdir()) == []


def test_cancelling_the_task_stops_the_plan(stand_in: PlannerStandIn, target: str) -> None:
    stand_in.plans.append(slow_plan(stand_in))

    async def main() -> None:
        started = asyncio.Event()
        async with AsyncPlannerClient(target) as client:
            task = asyncio.create_task(client.plan(REQUEST, on_progress=lambda event: started.set()))
            await started.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await asyncio.to_thread(stand_in.stopped.wait, 60.0)

    asyncio.run(main())
    assert stand_in.stopped.is_set()


def test_one_blocking_client_serves_several_threads(stand_in: PlannerStandIn, target: str) -> None:
    verdicts: list[str] = []
    with PlannerClient(target) as client:
        threads = [threading.Thread(target=lambda: verdicts.append(client.plan(REQUEST).verdict)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert verdicts == ["CERTIFIED"] * 4


def _broken_plans() -> dict[str, tuple[Callable[..., Any], str]]:
    def files(*sent: tuple[str, bytes, bool]) -> Callable[..., Any]:
        def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
            yield accepted(request)
            yield finished()
            for path, data, is_last in sent:
                yield pb.PlanResponse(file={"path": path, "data": data, "is_last": is_last})

        return plan

    late = make_result()
    late.verdict = 0
    return {
        "no result": (lambda request, context: iter([accepted(request)]), "ended the call without a plan"),
        "no verdict": (lambda request, context: iter([finished(late)]), "unknown number 0"),
        "up": (files(("../result.json", b"", True)), "has no place in a result folder"),
        "within": (files(("robot/../../x", b"", True)), "has no place"),
        "absolute": (files(("/etc/passwd", b"", True)), "has no place"),
        "windows": (files(("robot\\..\\x", b"", True)), "has no place"),
        "empty step": (files(("robot//x", b"", True)), "has no place"),
        "null": (files(("robot/a\0b", b"", True)), "has no place"),
        "foreign": (files((".bashrc", b"", True)), "has no place"),
        "twice": (files(("result.json", b"", True), ("result.json", b"", True)), "was sent twice"),
        "into a file": (files(("robot", b"", True), ("robot/x", b"", True)), "or into another file"),
        "over a folder": (files(("robot/x", b"", True), ("robot", b"", True)), "or into another file"),
        "interleaved": (files(("result.json", b"", False), ("viewer.html", b"", True)), "was cut off by"),
        "cut off": (files(("result.json", b"{", False)), "result.json' was cut off"),
        "deep": (files(("robot/" + "a/" * 30 + "x", b"", True)), "deeper than 20 folders"),
    }


BROKEN = _broken_plans()


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_answer_writes_nothing(stand_in: PlannerStandIn, target: str, tmp_path: Path, kind: str) -> None:
    plan, problem = BROKEN[kind]
    stand_in.plans.append(plan)
    with PlannerClient(target) as client, pytest.raises(PlannerError, match=problem) as caught:
        client.plan(REQUEST, out=tmp_path / "deep" / "plan")
    assert caught.value.code is Code.DATA_LOSS
    assert list((tmp_path / "deep").iterdir()) == []


def test_files_have_a_bound(tmp_path: Path) -> None:
    from service.client.received import ReceivedFiles

    files = ReceivedFiles(tmp_path, max_files=2, max_bytes=10)
    first, second = chunks({"viewer.html": b"x" * 11})
    files.take(first)
    with pytest.raises(PlannerError, match="more than 10 bytes"):
        files.take(second)
    files.restart()
    assert list(tmp_path.iterdir()) == []
    a, b, c = chunks({f"robot/{name}": b"" for name in "abc"})
    files.take(a)
    files.take(b)
    with pytest.raises(PlannerError, match="more than 2 files"):
        files.take(c)


_STEPS = st.sampled_from(["robot", "..", ".", "", "result.json", "~", "a:b", "x" * 300, "\u00e4" * 200]) | st.text()


@given(st.lists(_STEPS, max_size=4).map("/".join))
def test_no_path_leads_out_of_the_folder(path: str) -> None:
    from service.client.received import ReceivedFiles

    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "fresh"
        folder.mkdir()
        with ReceivedFiles(folder) as files:
            try:
                files.take(FileChunk(path=path, data=b"x", is_last=True))
            except PlannerError:
                assert list(folder.rglob("*")) == []
        assert list(Path(parent).iterdir()) == [folder]


def test_without_files_an_earlier_result_stays(stand_in: PlannerStandIn, target: str, tmp_path: Path) -> None:
    with PlannerClient(target) as client:
        client.plan(REQUEST, out=tmp_path / "plan")
        stand_in.plans.append(lambda request, context: iter([accepted(request, is_known=True), finished()]))
        plan = client.plan(REQUEST, out=tmp_path / "plan")
        assert (plan.is_known, plan.folder) == (True, None)
        assert (tmp_path / "plan" / "result.json").is_file()
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "thesis.tex").write_text("years of work")
        n_before = len(stand_in.requests)
        with pytest.raises(ResultError, match="name a new or empty folder"):
            client.plan(REQUEST, out=tmp_path / "other")
    assert len(stand_in.requests) == n_before


def test_the_client_loads_nothing_that_plans_and_nothing_of_the_server() -> None:
    program = (
        "import sys, service.client\n"
        "heavy = {'numpy', 'pinocchio', 'coal', 'scipy', 'open3d', 'scopt', 'perception'}\n"
        "ours = {'service.server', 'service.store', 'service.executor', 'service.work', 'service.planner'}\n"
        "plain = {'costs.names', 'costs.entry_points'}  # which load no library\n"
        "costs = {name for name in sys.modules if name.startswith('costs.')} - plain\n"
        "print(sorted((heavy | ours) & set(sys.modules) | costs))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_a_missing_server_is_unavailable() -> None:
    for connect in CLIENTS.values():
        with (
            connect("localhost:1", retry=Retry(attempts=2, first_delay_s=0.01)) as client,
            pytest.raises(PlannerError) as caught,
        ):
            client.status()
        assert caught.value.code is Code.UNAVAILABLE
