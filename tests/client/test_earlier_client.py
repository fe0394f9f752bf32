"""The client of the last release with a server of today, on the store that a server of that release has left."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from earlier_results import VERSIONS, unpack
from planner_server import planner_server

RELEASE = "0.3.0"
USE = """
import json, sys
from pathlib import Path
import service.client
from service.client import PlannerClient, PlannerError
from service.proto.planner.v1 import planner_pb2, result_pb2
from service.request.file import parse_request

address, out = sys.argv[1], Path(sys.argv[2])
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
    plans = [client.plan(request, request_id=name) for name in ("accepted", "new", "new")]
    said["ids"] = [plan.plan_id for plan in plans]
    said["certified"] = [plan.result.verdict == result_pb2.VERDICT_CERTIFIED for plan in plans]
    client.get_plan(plans[-1].plan_id, out=out)
    said["comments"] = [review.comment for review in client.get_plan(plans[0].plan_id).record.reviews]
    try:
        client.plan(parse_request({**data, "options": {"margin_m": 0.03}}), request_id="new")
    except PlannerError as error:
        said["refusal"] = str(error)
print(json.dumps(said))
"""


def test_the_client_of_the_last_release_gets_old_and_new_plans(tmp_path: Path) -> None:
    data, old = unpack(RELEASE, "store", tmp_path / "data"), unpack(RELEASE, "client", tmp_path / "client")
    (tmp_path / "robots" / "arm").mkdir(parents=True)
    shutil.copy(VERSIONS / "arm.urdf", tmp_path / "robots" / "arm" / "robot.urdf")
    with planner_server(data, "--robots", str(tmp_path / "robots")) as server:
        done = subprocess.run(
            [sys.executable, "-c", USE, server.address, str(tmp_path / "seen")],
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
    assert (tmp_path / "seen" / "result.json").is_file()
