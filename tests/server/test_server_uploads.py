"""A real server and a client that uploads more than it may: told when all of a cloud could come, not its next bytes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from google.rpc.error_details_pb2 import RetryInfo
from google.rpc.status_pb2 import Status
from planner_calls import DETAILS, uploaded
from planner_server import planner_server

from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

pytestmark = pytest.mark.filterwarnings("error")

MIB = 2**20
LARGEST, AT_ONCE, PER_SECOND = 64 * MIB, 256 * MIB, 16 * MIB


@pytest.fixture
def stub(tmp_path: Path) -> Iterator[PlannerServiceStub]:
    with planner_server(tmp_path / "data") as started, grpc.insecure_channel(started.address) as channel:
        yield PlannerServiceStub(channel)


def test_upload_beyond_the_rate_is_told_when_the_whole_cloud_could_come(stub: PlannerServiceStub) -> None:
    n_taken, started = 0, time.monotonic()
    while (refused := _refused(stub, size_bytes=LARGEST))[0] is grpc.StatusCode.INVALID_ARGUMENT:
        n_taken += 1  # announced, and counted
    code, delay_s = refused
    passed_s = time.monotonic() - started
    assert n_taken >= AT_ONCE // LARGEST
    assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
    full_s = ((n_taken + 1) * LARGEST - AT_ONCE) / PER_SECOND  # if no time had passed meanwhile
    assert full_s - passed_s <= delay_s <= full_s


def _refused(stub: PlannerServiceStub, size_bytes: int) -> tuple[grpc.StatusCode, float]:
    """How an upload that brings less than it announces ends, and when it may be tried again."""
    with pytest.raises(grpc.RpcError) as refused:
        stub.UploadCloud(uploaded(b"1 2 3\n", size_bytes=size_bytes), timeout=120)
    info = RetryInfo()
    for key, value in refused.value.trailing_metadata():  # type: ignore[attr-defined]
        if key == DETAILS:
            Status.FromString(value).details[0].Unpack(info)
    return refused.value.code(), info.retry_delay.seconds + 1e-9 * info.retry_delay.nanos  # type: ignore[attr-defined]
