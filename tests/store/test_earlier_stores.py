"""Stores of earlier releases: opened, listed and verified without loss; the same requests get the same plans."""

from __future__ import annotations

import io
import shutil
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from earlier_results import VERSIONS, extract, unpack
from planner_server import planner_server

from service.client import PlannerClient, PlannerError
from service.errors import ResultError
from service.proto.planner.v1.planner_pb2 import STANDING_STATE_HOLDS
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED
from service.request.file import has_hash, parse_request
from service.result.approval import check_approval, open_approval, read_public_key
from service.store import PlanState, Store

POST = {"name": "post", "type": "cylinder", "radius": 0.03, "height": 0.4, "position": [0.75, 0.0, 0.0]}
REACH: dict[str, Any] = {
    "robot": {"name": "arm"},
    "start": {"joints": {"a": 0.9, "b": 0.2, "c": 0.0}},
    "scene": {"obstacles": [POST]},
    "goal": {"poses": [{"link": "hand", "position": [0.55, -0.5, 0.0], "position_tolerance_m": 0.005}]},
}


@pytest.fixture(params=["0.2.0", "0.3.0"])
def data(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The data folder of a server of a release."""
    return unpack(request.param, "store", tmp_path / request.param)


def test_a_store_of_an_earlier_release_keeps_its_plans_and_reviews(data: Path) -> None:
    with closing(sqlite3.connect(data / "plans" / "store.sqlite3")) as connection:
        before = connection.execute(
            "SELECT plan_id, client, request_id, request_sha256, state, verdict, reply, archive_bytes FROM plans"
        ).fetchall()
    assert {row[2] for row in before} == {"plain", "accepted"}
    with Store(data / "plans") as store:
        for plan_id, client, request_id, sha256, state, verdict, reply, archive_bytes in before:
            record = store.plans.find(client, request_id)
            assert record is not None
            kept = (record.plan_id, record.request_sha256, record.state, record.verdict, record.reply)
            assert kept == (plan_id, sha256, PlanState(state), verdict, reply)
            assert record.archive_bytes == archive_bytes
            assert has_hash(parse_request(REACH), sha256)
            comments = [review.comment for review in store.reviews.find(plan_id)]
            assert comments == (["seen from all sides"] if request_id == "accepted" else [])
            assert not store.reviews.is_accepted(plan_id)  # reviews of those releases have no validity


def test_a_server_on_an_earlier_store_answers_the_same_requests_with_the_same_plans(data: Path, tmp_path: Path) -> None:
    (tmp_path / "robots" / "arm").mkdir(parents=True)
    shutil.copy(VERSIONS / "arm.urdf", tmp_path / "robots" / "arm" / "robot.urdf")
    with closing(sqlite3.connect(data / "plans" / "store.sqlite3")) as connection:
        ids = dict(connection.execute("SELECT request_id, plan_id FROM plans").fetchall())
    with planner_server(data, "--robots", str(tmp_path / "robots")) as server, PlannerClient(server.address) as client:
        for request_id in ("plain", "accepted"):
            plan = client.plan(parse_request(REACH), request_id=request_id)
            assert (plan.plan_id, plan.result.verdict) == (ids[request_id], VERDICT_CERTIFIED)
            assert client.get_plan(plan.plan_id).record.request_id == request_id
        folder = tmp_path / "seen"
        seen = client.get_plan(plan.plan_id, out=folder).record
        assert (seen.is_approved, [review.comment for review in seen.reviews]) == (False, ["seen from all sides"])
        for found in (client.verify(plan.plan_id).standing, client.verify(folder).standing):
            assert (found.state, found.release) == (STANDING_STATE_HOLDS, data.name)
        other = parse_request({**REACH, "options": {"hand_friction": [0.2, 0.9]}})
        with pytest.raises(PlannerError, match="belongs to another request of this client"):
            client.plan(other, request_id="plain")


def test_an_approval_of_0_3_0_is_read_and_fits_its_files(tmp_path: Path) -> None:
    data = unpack("0.3.0", "store", tmp_path / "data")
    with closing(sqlite3.connect(data / "plans" / "store.sqlite3")) as connection:
        plan_id, envelope = connection.execute("SELECT plan_id, approval FROM reviews").fetchone()
    folder = tmp_path / "approved"
    with tarfile.open(fileobj=io.BytesIO((data / "plans" / "archives" / plan_id).read_bytes())) as archive:
        extract(archive, folder)
    (folder / "approval.json").write_bytes(envelope)
    key = read_public_key(VERSIONS / "approval_key.pub.pem")
    approval = open_approval(envelope, key)
    assert (approval.plan_id, approval.verdict, approval.comment) == (plan_id, "CERTIFIED", "seen from all sides")
    assert has_hash(parse_request(REACH), approval.request_sha256)
    with pytest.raises(ResultError, match=r"of release 0\.3\.0, has no validity"):
        check_approval(folder, key)
