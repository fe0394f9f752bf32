"""A real server in a real process: plans, refusals, cancellation, idempotence."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from executor_waiting import until
from google.rpc.error_details_pb2 import BadRequest
from google.rpc.status_pb2 import Status
from planner_calls import ENDLESS, QUICK, finished, plan_request, refusal, wait_for
from planner_server import ServerProcess, planner_server

from service.client import PlannerClient
from service.errors import RequestError, ResultError
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED, VERDICT_NOT_FOUND, VERDICT_TIME_LIMIT, MotionResult
from service.result.approval import check_approval, read_public_key
from service.wire.hashes import hash_trajectory

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("server")
    key = Ed25519PrivateKey.generate()
    (folder / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    (folder / "key.pem").chmod(0o600)
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (folder / "key.pub").write_bytes(public)
    with planner_server(folder / "data", "--queue", "2", "--sign-key", str(folder / "key.pem")) as started:
        yield started


@pytest.fixture(scope="module")
def stub(server: ServerProcess) -> Iterator[PlannerServiceStub]:
    with grpc.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerServiceStub]:
    """Of a server that few plans have told how long they take."""
    folder = tmp_path_factory.mktemp("other")
    with planner_server(folder / "data") as server, grpc.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)


def _violations(error: grpc.RpcError) -> dict[str, str]:
    for key, value in error.trailing_metadata():  # type: ignore[attr-defined]
        if key == "grpc-status-details-bin":
            detail = BadRequest()
            assert Status.FromString(value).details[0].Unpack(detail)
            return {one.field: one.description for one in detail.field_violations}
    return {}


def test_plan_tells_what_happens_and_ends_with_a_certified_motion(stub: PlannerServiceStub) -> None:
    responses = list(stub.Plan(plan_request(QUICK), timeout=240))
    events = [response.WhichOneof("event") for response in responses]
    assert events[0] == "accepted"
    assert "progress" in events
    assert events[-1] == "finished"
    result: MotionResult = responses[-1].finished.result
    assert result.verdict == VERDICT_CERTIFIED
    fractions = [one.progress.fraction for one in responses if one.WhichOneof("event") == "progress"]
    assert fractions == sorted(fractions)


def test_trajectory_and_certificate_carry_hashes_that_anyone_can_recompute(stub: PlannerServiceStub) -> None:
    result = finished(stub.Plan(plan_request(QUICK), timeout=240)).result
    trajectory = result.trajectory
    positions = np.array(trajectory.positions).reshape(len(trajectory.times), len(trajectory.joint_names))
    assert hash_trajectory(trajectory.joint_names, np.array(trajectory.times), positions) == trajectory.sha256
    assert hashlib.sha256(result.certificate.json).hexdigest() == result.certificate.sha256
    certificate = json.loads(result.certificate.json)
    assert certificate["status"] == "CERTIFIED"
    assert result.certificate.min_clearance_m == certificate["min_clearance_m"]


def test_files_of_a_plan_are_those_of_the_command_line(stub: PlannerServiceStub, tmp_path: Path) -> None:
    files: dict[str, bytes] = {}
    for response in stub.Plan(plan_request(QUICK, with_files=True), timeout=240):
        if response.WhichOneof("event") == "file":
            files[response.file.path] = files.get(response.file.path, b"") + response.file.data
    assert {"result.json", "trajectory.csv", "viewer.html", "scene.glb", "robot/robot.urdf"} <= set(files)
    assert json.loads(files["result.json"])["verdict"] == "CERTIFIED"


def test_finished_plan_can_be_fetched_verified_reviewed_and_checked_without_the_server(
    server: ServerProcess, stub: PlannerServiceStub, tmp_path: Path
) -> None:
    plan_id = finished(stub.Plan(plan_request(QUICK, with_files=True), timeout=240)).plan_id
    parts = list(stub.GetPlan(wire.GetPlanRequest(plan_id=plan_id, with_files=True), timeout=120))
    record = parts[0].record
    assert record.state == wire.PLAN_STATE_FINISHED
    assert not record.is_approved
    assert len(parts) > 1
    assert stub.Verify(wire.VerifyRequest(plan_id=plan_id), timeout=240).verdict == VERDICT_CERTIFIED
    trajectory, certificate = record.result.trajectory.sha256, record.result.certificate.sha256
    review = wire.ReviewPlanRequest(
        plan_id=plan_id,
        decision=wire.DECISION_ACCEPTED,
        comment="seen",
        trajectory_sha256=trajectory,
        certificate_sha256=certificate,
    )
    code, words, _ = refusal(lambda: stub.ReviewPlan(review, timeout=120))
    assert (code, "page_sha256: expected that of the stored plan" in words) == ("FAILED_PRECONDITION", True)
    review.page_sha256 = record.page_sha256
    stub.ReviewPlan(review, timeout=120)
    assert next(iter(stub.GetPlan(wire.GetPlanRequest(plan_id=plan_id)))).record.is_approved
    with PlannerClient(server.address) as client:
        client.get_plan(plan_id, out=tmp_path / "out")
    approval = check_approval(tmp_path / "out", read_public_key(server.log.parent / "key.pub"))
    assert (approval.plan_id, approval.trajectory_sha256, approval.page_sha256) == (
        plan_id,
        trajectory,
        record.page_sha256,
    )
    assert approval.expires_at == pytest.approx(approval.approved_at + 30 * 86400.0)
    with PlannerClient(server.address) as client:
        client.revoke(client.get_plan(plan_id).record, comment="the scan was old")
        revoked = client.get_plan(plan_id, out=tmp_path / "out").record
        with pytest.raises(RequestError, match=f"plan {plan_id} is not approved; there is nothing to revoke"):
            client.revoke(revoked)
    assert not revoked.is_approved
    with pytest.raises(ResultError, match=r"was revoked by .*: 'the scan was old'"):
        check_approval(tmp_path / "out", read_public_key(server.log.parent / "key.pub"))
    review.verdict = VERDICT_TIME_LIMIT
    code, words, _ = refusal(lambda: stub.ReviewPlan(review, timeout=120))
    assert (code, "verdict: expected that of the stored plan, CERTIFIED, got TIME_LIMIT" in words) == (
        "FAILED_PRECONDITION",
        True,
    )
    review.verdict = VERDICT_CERTIFIED
    review.trajectory_sha256 = "0" * 64
    with pytest.raises(grpc.RpcError) as refused:
        stub.ReviewPlan(review, timeout=120)
    assert refused.value.code() is grpc.StatusCode.FAILED_PRECONDITION  # type: ignore[attr-defined]


def test_same_request_id_gives_the_same_plan_and_another_request_is_refused(stub: PlannerServiceStub) -> None:
    first = finished(stub.Plan(plan_request(QUICK, request_id="once"), timeout=240))
    again = list(stub.Plan(plan_request(QUICK, request_id="once"), timeout=240))
    assert again[0].accepted.is_known
    assert again[-1].finished == first
    other = {**QUICK, "options": {"seed": 7}}
    with pytest.raises(grpc.RpcError) as refused:
        list(stub.Plan(plan_request(other, request_id="once"), timeout=240))
    assert refused.value.code() is grpc.StatusCode.ALREADY_EXISTS  # type: ignore[attr-defined]


def test_plan_asked_for_again_as_soon_as_it_was_cancelled_is_begun_anew(stub: PlannerServiceStub) -> None:
    first = stub.Plan(plan_request(ENDLESS, request_id="anew"), timeout=240)
    wait_for(first, "progress")
    first.cancel()
    second = stub.Plan(plan_request(ENDLESS, request_id="anew"), timeout=240)
    assert not next(second).accepted.is_known
    wait_for(second, "progress")
    second.cancel()
    assert stub.GetStatus(wire.GetStatusRequest(), timeout=120).version


def test_invalid_request_names_every_field(stub: PlannerServiceStub) -> None:
    message = plan_request(QUICK)
    message.request.options.margin_m = -1.0
    message.request.start.joints["l_arm_elx"] = float("nan")
    with pytest.raises(grpc.RpcError) as refused:
        list(stub.Plan(message, timeout=120))
    assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT  # type: ignore[attr-defined]
    found = _violations(refused.value)
    assert set(found) == {"request.options.margin_m", "request.start.joints.l_arm_elx"}


def test_what_only_the_robot_knows_to_be_wrong_is_named_too(stub: PlannerServiceStub) -> None:
    with pytest.raises(grpc.RpcError) as refused:
        list(stub.Plan(plan_request({**QUICK, "goal": {"joints": {"l_arm_elz": 1.0}}}), timeout=240))
    assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT  # type: ignore[attr-defined]
    assert "request.goal.joints" in _violations(refused.value)


def test_bytes_that_are_no_message_are_an_invalid_argument(server: ServerProcess) -> None:
    with grpc.insecure_channel(server.address) as channel:
        call = channel.unary_stream("/planner.v1.PlannerService/Plan")
        with pytest.raises(grpc.RpcError) as refused:
            list(call(b"\xff\xff\xff", timeout=120))
    assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT  # type: ignore[attr-defined]


def test_file_of_the_server_is_refused_unless_its_folder_is_allowed(stub: PlannerServiceStub) -> None:
    request = {**QUICK, "scene": {"cloud": "/etc/passwd"}}
    with pytest.raises(grpc.RpcError) as refused:
        list(stub.Plan(plan_request(request), timeout=120))
    assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT  # type: ignore[attr-defined]
    assert "request.scene.cloud" in _violations(refused.value)


def test_plan_under_way_says_so(stub: PlannerServiceStub) -> None:
    _wait_until_idle(stub)
    running = stub.Plan(plan_request(ENDLESS), timeout=240)
    first = next(iter(running)).accepted.plan_id
    wait_for(running, "progress")
    waiting = stub.Plan(plan_request(ENDLESS), timeout=240)
    second = next(iter(waiting)).accepted.plan_id
    states = [next(iter(stub.GetPlan(wire.GetPlanRequest(plan_id=one)))).record.state for one in (first, second)]
    assert states == [wire.PLAN_STATE_RUNNING, wire.PLAN_STATE_QUEUED]
    running.cancel()
    waiting.cancel()


def test_cancelled_plan_frees_its_worker(stub: PlannerServiceStub) -> None:
    call = stub.Plan(plan_request(ENDLESS), timeout=240)
    wait_for(call, "progress")
    call.cancel()
    _wait_until_idle(stub)


def test_full_queue_refuses_with_a_time_to_come_back(stub: PlannerServiceStub) -> None:
    _wait_until_idle(stub)
    calls = [stub.Plan(plan_request(ENDLESS), timeout=240)]
    wait_for(calls[0], "progress")
    calls += [stub.Plan(plan_request(ENDLESS), timeout=240) for _ in range(2)]
    for call in calls[1:]:
        wait_for(call, "accepted")
        assert next(call).WhichOneof("event") == "queued"
    with pytest.raises(grpc.RpcError) as refused:
        list(stub.Plan(plan_request(QUICK), timeout=240))
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED  # type: ignore[attr-defined]
    keys = [key for key, _ in refused.value.trailing_metadata()]  # type: ignore[attr-defined]
    assert "grpc-status-details-bin" in keys
    for call in calls:
        call.cancel()


def test_robots_are_listed_with_joints_and_postures(stub: PlannerServiceStub) -> None:
    (atlas,) = [
        robot for robot in stub.ListRobots(wire.ListRobotsRequest(), timeout=240).robots if robot.name == "atlas"
    ]
    assert "stand" in atlas.postures
    assert "l_arm_elx" in atlas.joint_names


def _wait_until_idle(stub: PlannerServiceStub) -> None:
    def is_idle() -> bool:
        status = stub.GetStatus(wire.GetStatusRequest(), timeout=120)
        return status.queued == 0 and all(worker.state == "idle" for worker in status.workers)

    assert until(is_idle)


def test_same_request_without_and_with_files_is_one_request(stub: PlannerServiceStub) -> None:
    first = finished(stub.Plan(plan_request(QUICK, request_id="bare"), timeout=240))
    responses = stub.Plan(plan_request(QUICK, request_id="bare", with_files=True), timeout=240)
    assert wait_for(responses, "finished").finished == first
    with pytest.raises(grpc.RpcError) as refused:  # they were not asked for when it was planned
        list(responses)
    assert refused.value.code() is grpc.StatusCode.NOT_FOUND  # type: ignore[attr-defined]


def test_who_joins_a_plan_does_not_fall_with_the_deadline_of_the_first(other: PlannerServiceStub) -> None:
    busy = other.Plan(plan_request(ENDLESS), timeout=240)
    wait_for(busy, "progress")
    hasty = other.Plan(plan_request(QUICK, request_id="shared"), timeout=4.0)
    wait_for(hasty, "accepted")
    patient = other.Plan(plan_request(QUICK, request_id="shared"), timeout=240)
    assert wait_for(patient, "accepted").accepted.is_known
    with pytest.raises(grpc.RpcError) as late:
        list(hasty)
    assert late.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED  # type: ignore[attr-defined]
    busy.cancel()
    assert finished(patient).result.verdict == VERDICT_CERTIFIED


def test_deadline_brings_the_best_attempt_and_one_that_cannot_be_met_is_refused(tmp_path: Path) -> None:
    # A server of its own, for it judges by what the plans before took: here by a single long one.
    with planner_server(tmp_path / "data") as server, grpc.insecure_channel(server.address) as channel:
        alone = PlannerServiceStub(channel)
        result = finished(alone.Plan(plan_request(ENDLESS), timeout=8.0)).result
        assert result.verdict in (VERDICT_TIME_LIMIT, VERDICT_NOT_FOUND)  # for lack of time
        assert result.explanation
        running = alone.Plan(plan_request(ENDLESS), timeout=240)
        wait_for(running, "progress")
        waiting = alone.Plan(plan_request(ENDLESS), timeout=240)
        wait_for(waiting, "queued")
        code, words, _ = refusal(lambda: list(alone.Plan(plan_request(QUICK), timeout=5.0)))
        assert (code, "not begun" in words) == ("DEADLINE_EXCEEDED", True), words
        running.cancel()
        waiting.cancel()


def test_log_says_of_a_refused_request_which_it_was_and_why(server: ServerProcess, stub: PlannerServiceStub) -> None:
    wrong = plan_request(QUICK, request_id="wrong-one")
    wrong.request.options.margin_m = -1.0
    with pytest.raises(grpc.RpcError):
        list(stub.Plan(wrong, timeout=120))
    assert until(lambda: "wrong-one" in server.log.read_text())  # the client hears of it first
    lines = [json.loads(line) for line in server.log.read_text().splitlines() if "wrong-one" in line]
    assert [(line["code"], "margin_m" in line["why"]) for line in lines] == [("INVALID_ARGUMENT", True)]
