"""The client of the last release with a server of today, on the store that a server of that release has left."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from earlier_results import VERSIONS, unpack
from planner_server import ServerProcess, planner_server

from service.client import PlannerClient
from service.client.program import main
from service.result.folder import MANIFEST_NAME

RELEASE = "0.3.0"
USE = """
import json, sys
import service.client
from service.client import PlannerClient, PlannerError
from service.proto.planner.v1 import planner_pb2, result_pb2
from service.request.file import parse_request

address, out = sys.argv[1], sys.argv[2]
post = {"name": "post", "type": "cylinder", "radius": 0.03, "height": 0.4, "position": [0.75, 0.0, 0.0]}
data = {
    "robot": {"name": "arm"},
    "start": {"joints": {"a": 0.9, "b": 0.2, "c": 0.0}},
    "scene": {"obstacles": [post]},
    "goal": {"poses": [{"link": "hand", "position": [0.55, -0.5, 0.0], "position_tolerance_m": 0.005}]},
}
request = parse_request(data)
said = {"code": service.client.__file__}
with PlannerClient(address) as client:
    names = ("accepted", "new", "new")
    plans = [client.plan(request, request_id=name, out=f"{out}/{k}") for k, name in enumerate(names)]
    client.get_plan(plans[1].plan_id, out=f"{out}/stored")
    said["ids"] = [plan.plan_id for plan in plans]
    said["certified"] = [plan.result.verdict == result_pb2.VERDICT_CERTIFIED for plan in plans]
    said["comments"] = [review.comment for review in client.get_plan(plans[0].plan_id).record.reviews]
    try:
        client.plan(parse_request({**data, "options": {"margin_m": 0.03}}), request_id="new")
    except PlannerError as error:
        said["refusal"] = str(error)
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """A server of today on a store of the last release."""
    folder = tmp_path_factory.mktemp("upgraded")
    data = unpack(RELEASE, "store", folder / "data")
    (folder / "robots" / "arm").mkdir(parents=True)
    shutil.copy(VERSIONS / "arm.urdf", folder / "robots" / "arm" / "robot.urdf")
    with planner_server(data, "--robots", str(folder / "robots")) as server:
        yield server


def test_the_client_of_the_last_release_gets_old_and_new_plans(server: ServerProcess, tmp_path: Path) -> None:
    old = unpack(RELEASE, "client", tmp_path / "client")
    done = subprocess.run(
        [sys.executable, "-c", USE, server.address, str(tmp_path / "out")],
        cwd=old,
        env={**os.environ, "PYTHONPATH": str(old)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["code"].startswith(str(old))
    assert said["certified"] == [True, True, True]
    stored, new, again = said["ids"]
    assert new == again != stored  # a request id means the same plan, across the upgrade too
    assert said["comments"] == ["seen from all sides"]
    assert "belongs to another request" in said["refusal"]
    with PlannerClient(server.address) as client:
        client.get_plan(new, out=tmp_path / "today")
    today = _list_names(tmp_path / "today")
    assert MANIFEST_NAME in today
    for name in ("1", "2", "stored"):  # all that the earlier client knows
        assert _list_names(tmp_path / "out" / name) == today - {MANIFEST_NAME}


def _list_names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_the_program_of_the_client_lists_and_verifies_the_same_plans(
    server: ServerProcess, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*arguments: str) -> tuple[int, str]:
        code = main(["--target", server.address, *arguments])
        return code, capsys.readouterr().out + capsys.readouterr().err

    code, listed = run("plans")
    plans = [line.split() for line in listed.splitlines()]
    assert code == 0
    assert len(plans) >= 2
    assert {tuple(words[1:4]) for words in plans} == {("pose_goal", "FINISHED", "CERTIFIED")}
    stored = plans[-2][0]  # the one with files
    assert run("verify", stored) == (0, f"{stored} HOLDS\n")
    assert run("verify", "no-such-plan")[0] == 3
    (tmp_path / "wrong.yaml").write_text("goal: {}\n")
    assert run("plan", str(tmp_path / "wrong.yaml"))[0] == 3


def test_the_program_names_a_server_that_is_not_there() -> None:
    assert main(["--target", "localhost:1", "plans"]) == 69
