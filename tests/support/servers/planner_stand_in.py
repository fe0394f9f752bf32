"""Stand-in for a planning server, with the answers of the protocol or those of a test."""

from __future__ import annotations

import hashlib
import json
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import grpc
from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.message import Message
from google.rpc.status_pb2 import Status

from service.proto.planner.v1 import planner_pb2 as pb
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceServicer, add_PlannerServiceServicer_to_server
from service.proto.planner.v1.result_pb2 import Certificate, Check, FileChunk, MotionResult, Trajectory, Verdict
from service.wire.hashes import hash_certificate, hash_trajectory

PLAN_ID = "0123456789abcdef"
FILES = {
    "result.json": b'{"format": "scopt-result/1", "verdict": "CERTIFIED"}',
    "trajectory.csv": b"time,elbow\n0,0\n1,0.5\n",
    "viewer.html": b"<html></html>",
    "robot/robot.urdf": b"<robot/>",
    "robot/meshes/a/hand.obj": b"v 0 0 0\n",
}
Plan = Callable[[pb.PlanRequest, grpc.ServicerContext], Iterator[pb.PlanResponse]]


def make_result(verdict: str = "CERTIFIED") -> MotionResult:
    """Return a small result with right hashes."""
    proof = {
        "min_clearance_m": 0.0213,
        "min_clearance_pair": ["crate", "l_hand"],
        "min_balance_margin_m": 0.031,
        "checks": [_check("clearance", 0.0213, "proof"), _check("start.l_hand", None, "samples")],
        "exempt": [{"pair": ["floor", "l_foot"], "phase": "reach", "allowed_m": 0.01, "deepest_m": 0.002}],
    }  # fmt: skip
    text = json.dumps(proof).encode()
    names, times, positions = ["elbow"], [0.0, 1.0], [0.0, 0.5]
    result = MotionResult(
        verdict=Verdict.Value(f"VERDICT_{verdict}"),
        explanation=() if verdict == "CERTIFIED" else ("the crate is in the way",),
        notes=("made by a stand-in",),
        request_sha256="sha256:0",
        planning_time_s=0.25,
        timings={"reach": 0.2},
        trajectory=Trajectory(
            joint_names=names,
            times=times,
            positions=positions,
            phases=[{"name": "reach", "start_s": 0.0, "end_s": 1.0}],  # type: ignore[list-item]
            is_timed=True,
            sha256=hash_trajectory(names, times, positions),
        ),
        certificate=Certificate(
            status="CERTIFIED",
            checks=[Check(name="clearance", ok=True, value=0.0213, unit="m", text="apart", basis="proof")],
            min_clearance_m=0.0213,
            min_clearance_pair=["crate", "l_hand"],
            json=text,
            sha256=hash_certificate(text),
        ),
    )
    result.figures.update({"steps": 3})
    return result


def _check(name: str, value: float | None, basis: str) -> dict[str, Any]:
    return {"name": name, "ok": True, "value": value, "limit": 0.0, "unit": "m", "text": "apart", "basis": basis}


def accepted(request: pb.PlanRequest, *, is_known: bool = False) -> pb.PlanResponse:
    """The first event."""
    return pb.PlanResponse(accepted={"plan_id": PLAN_ID, "request_id": request.request_id, "is_known": is_known})


def finished(result: MotionResult | None = None) -> pb.PlanResponse:
    """The event with the result."""
    return pb.PlanResponse(finished={"plan_id": PLAN_ID, "result": result or make_result()})


def chunks(files: dict[str, bytes], size: int = 7) -> Iterator[FileChunk]:
    """Files in small chunks."""
    for path, data in files.items():
        for start in range(0, max(len(data), 1), size):
            yield FileChunk(path=path, data=data[start : start + size], is_last=start + size >= len(data))


def good_plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
    """Yield the events of a certified plan."""
    yield accepted(request)
    yield pb.PlanResponse(queued={"place": 1, "expected_wait_s": 0.5})
    yield pb.PlanResponse(progress={"step": "prepare", "fraction": 0.1})
    iteration = {"index": 4, "merit": 3.5, "mu": 10.0, "violations": {"pose": 0.001, "collision": 0.02}}
    yield pb.PlanResponse(progress={"step": "reach", "fraction": 0.5, "iteration": iteration})
    yield finished()
    if request.with_files:
        for chunk in chunks(FILES):
            yield pb.PlanResponse(file=chunk)


def refuse(
    context: grpc.ServicerContext, code: grpc.StatusCode, text: str, details: Iterable[Message] = ()
) -> NoReturn:
    """End a call with a rich status."""
    status = Status(code=code.value[0], message=text)
    for detail in details:
        packed = AnyMessage()
        packed.Pack(detail)
        status.details.append(packed)
    context.set_trailing_metadata((("grpc-status-details-bin", status.SerializeToString()),))
    context.abort(code, text)
    raise AssertionError("abort does not return")


def refused(code: grpc.StatusCode, text: str, *details: Message) -> Plan:
    """Return a plan that is refused."""

    def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        refuse(context, code, text, details)
        yield

    return plan


class PlannerStandIn(PlannerServiceServicer):
    """Server whose plans answer with ``plans``, one by one, and then with ``good_plan``.

    Attributes:
        requests: every message received.
        clouds: content by cloud id.
        n_chunks: of all uploads.
        stopped: set when the call of a slow plan has ended.
    """

    def __init__(self) -> None:
        self.requests: list[Any] = []
        self.metadata: list[dict[str, Any]] = []
        self.plans: deque[Plan] = deque()
        self.clouds: dict[str, bytes] = {}
        self.n_chunks = 0
        self.stopped = threading.Event()
        self.reviews: list[pb.Review] = []
        self.result = make_result()
        self.state = pb.PLAN_STATE_FINISHED

    def Plan(self, request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        self._record(request, context)
        plan = self.plans.popleft() if self.plans else good_plan
        yield from plan(request, context)

    def UploadCloud(self, requests: Any, context: grpc.ServicerContext) -> pb.UploadCloudResponse:
        first = next(requests)
        self._record(first, context)
        header = first.header
        cloud_id = f"sha256:{header.sha256}.{header.format}"
        if cloud_id in self.clouds:
            return pb.UploadCloudResponse(cloud_id=cloud_id, size_bytes=len(self.clouds[cloud_id]), was_known=True)
        data = b""
        for part in requests:
            self.n_chunks += 1
            data += part.chunk
        if hashlib.sha256(data).hexdigest() != header.sha256 or len(data) != header.size_bytes:
            refuse(context, grpc.StatusCode.INVALID_ARGUMENT, "the file is not what its header says")
        self.clouds[cloud_id] = data
        return pb.UploadCloudResponse(cloud_id=cloud_id, size_bytes=len(data))

    def BuildScene(self, request: Any, context: grpc.ServicerContext) -> Iterator[pb.BuildSceneResponse]:
        self._record(request, context)
        yield pb.BuildSceneResponse(step="read cloud")
        yield pb.BuildSceneResponse(scene={"scene_id": "s1", "json": b"{}"})

    def GetScene(self, request: Any, context: grpc.ServicerContext) -> pb.GetSceneResponse:
        self._record(request, context)
        return pb.GetSceneResponse(scene={"scene_id": request.scene_id, "json": b"{}"})  # type: ignore[arg-type]

    def Detect(self, request: Any, context: grpc.ServicerContext) -> pb.DetectResponse:
        self._record(request, context)
        return pb.DetectResponse(hits=[{"kind": request.kind, "confidence": 0.9}])  # type: ignore[list-item]

    def SimulatePlan(self, request: Any, context: grpc.ServicerContext) -> pb.SimulatePlanResponse:
        self._record(request, context)
        return pb.SimulatePlanResponse(has_stood=True)

    def Verify(self, request: Any, context: grpc.ServicerContext) -> pb.VerifyResponse:
        self._record(request, context)
        return pb.VerifyResponse(verdict=Verdict.VERDICT_CERTIFIED)

    def ListRobots(self, request: Any, context: grpc.ServicerContext) -> pb.ListRobotsResponse:
        self._record(request, context)
        return pb.ListRobotsResponse(robots=[{"name": "atlas", "joint_names": ["elbow"]}])  # type: ignore[list-item]

    def GetPlan(self, request: Any, context: grpc.ServicerContext) -> Iterator[pb.GetPlanResponse]:
        self._record(request, context)
        if request.plan_id != PLAN_ID:
            refuse(context, grpc.StatusCode.NOT_FOUND, f"no plan {request.plan_id!r}")
        result = self.result if self.state == pb.PLAN_STATE_FINISHED else None
        yield pb.GetPlanResponse(
            record=pb.PlanRecord(
                plan_id=PLAN_ID, state=self.state, result=result, reviews=self.reviews, needs_review=not self.reviews
            )
        )
        if request.with_files:
            for chunk in chunks(FILES):
                yield pb.GetPlanResponse(file=chunk)

    def ListPlans(self, request: Any, context: grpc.ServicerContext) -> pb.ListPlansResponse:
        self._record(request, context)
        n_first = int(request.page_token or 0)
        ids = [f"plan{number}" for number in range(5)][n_first : n_first + min(request.page_size, 2)]
        plans = [pb.PlanSummary(plan_id=name, state=self.state, needs_review=True) for name in ids]
        last = n_first + len(ids)
        return pb.ListPlansResponse(plans=plans, next_page_token=str(last) if last < 5 else "")

    def ListScenes(self, request: Any, context: grpc.ServicerContext) -> pb.ListScenesResponse:
        self._record(request, context)
        return pb.ListScenesResponse(scenes=[pb.SceneSummary(scene_id="scene:1", client="ann", stored_bytes=2048)])

    def ReviewPlan(self, request: Any, context: grpc.ServicerContext) -> pb.ReviewPlanResponse:
        self._record(request, context)
        hashes = self.result.trajectory.sha256, self.result.certificate.sha256
        if (request.trajectory_sha256, request.certificate_sha256) != hashes:
            refuse(context, grpc.StatusCode.FAILED_PRECONDITION, "another plan was seen")
        review = pb.Review(decision=request.decision, reviewer="ada", comment=request.comment)
        self.reviews.append(review)
        return pb.ReviewPlanResponse(review=review)

    def GetStatus(self, request: Any, context: grpc.ServicerContext) -> pb.GetStatusResponse:
        self._record(request, context)
        return pb.GetStatusResponse(
            version="0.1.0",
            uptime_s=3725.0,
            queued=2,
            queue_limit=8,
            workers=[{"pid": 41, "state": "busy", "work": "plan", "jobs_done": 17, "resident_bytes": 250 * 2**20}],  # type: ignore[list-item]
            worker_restarts=1,
            verdicts={"CERTIFIED": 15, "NOT_FOUND": 2},
            solve_p50_s=0.31,
            solve_p99_s=1.4,
        )

    def _record(self, message: Any, context: grpc.ServicerContext) -> None:
        self.requests.append(message)
        self.metadata.append(dict(context.invocation_metadata()))


def slow_plan(stand_in: PlannerStandIn) -> Plan:
    """Return a plan that runs until its client stops it."""

    def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        context.add_callback(stand_in.stopped.set)
        yield accepted(request)
        yield pb.PlanResponse(progress={"step": "waiting", "fraction": 0.5})
        stand_in.stopped.wait(120.0)

    return plan


@contextmanager
def serving(
    stand_in: PlannerStandIn, credentials: grpc.ServerCredentials | None = None, port: int = 0
) -> Iterator[str]:
    """Serve while the body runs; yields the target."""
    server = grpc.server(ThreadPoolExecutor(4), options=(("grpc.so_reuseport", 0),))
    add_PlannerServiceServicer_to_server(stand_in, server)  # type: ignore[no-untyped-call]
    address = f"localhost:{port}"
    bound = server.add_insecure_port(address) if credentials is None else server.add_secure_port(address, credentials)
    server.start()
    try:
        yield f"localhost:{bound}"
    finally:
        server.stop(0).wait(60.0)


def write_cloud(folder: Path, n_bytes: int = 1000, name: str = "scan.pcd") -> Path:
    """Write a file in place of a cloud."""
    path = folder / name
    path.write_bytes((bytes(range(251)) * (n_bytes // 251 + 1))[:n_bytes])
    return path
