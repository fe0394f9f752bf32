"""Rehearsal of an upgrade: a server of an earlier release is replaced under a running client of that release.

``python -m benchmarks.service.upgrade OLD [--plans N]``.  OLD is a checkout of the release, 0.2.0 or later
(``git worktree add OLD 4e2b7f6a``).  A client of OLD plans one request after the other with files, each with a request
id, and accepts every third plan; it repeats what is refused while no server listens.  In the middle the old server is
stopped and today's is started on the same data and the same port.  Then every confirmed plan is asked for again by its
request id, and verified.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.tables import print_table
from service.client import PlannerClient
from service.proto.planner.v1.planner_pb2 import STANDING_STATE_HOLDS
from service.request.file import load_request

ROOT = Path(__file__).parents[2]
REQUEST = ROOT / "examples" / "requests" / "joint_goal.yaml"
SERVE = "from service.cli import main; main()"
CLIENT = """
import json, sys, tempfile, time
from service.client import PlannerClient, PlannerError
try:
    from service.request.file import load_request
except ImportError:  # before 0.3.0
    from service.request_file import load_request
address, path, n = sys.argv[1], sys.argv[2], int(sys.argv[3])
request = load_request(path)
for k in range(n):
    refused = 0
    while True:
        try:
            with PlannerClient(address) as client, tempfile.TemporaryDirectory() as out:
                plan = client.plan(request, request_id=f"upgrade-{k}", out=f"{out}/result")
                if k % 3 == 0:
                    client.review(client.get_plan(plan.plan_id).record, accept=True, comment=f"plan {k}")
            break
        except PlannerError as error:
            refused += 1
            if refused > 600 or error.code.name in ("DATA_LOSS", "INVALID_ARGUMENT", "NOT_FOUND"):
                raise
            time.sleep(0.2)
    print(json.dumps({"k": k, "id": plan.plan_id, "refused": refused}), flush=True)
"""


def _start(code: Path, data: Path, port: int) -> subprocess.Popen[str]:
    """Return a server of a checkout that listens."""
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE, "serve", "--data", str(data), "--listen", f"127.0.0.1:{port}", "--workers", "1"],
        cwd=code,
        env={**os.environ, "PYTHONPATH": str(code), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line.startswith("listening on"):
        raise SystemExit(f"the server of {code} said {line!r}")
    return process


def _rehearse(old: Path, n: int, folder: Path) -> tuple[list[dict[str, Any]], float, dict[str, int]]:
    """Return what the client was told, how long nobody listened [s], and counts of what is wrong afterwards."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data, address = folder / "data", f"127.0.0.1:{port}"
    server = _start(old, data, port)
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, address, str(REQUEST), str(n)],
        cwd=old,
        env={**os.environ, "PYTHONPATH": str(old)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert client.stdout is not None
    told: list[dict[str, Any]] = []
    away_s = 0.0
    try:
        for line in client.stdout:
            told.append(json.loads(line))
            if len(told) == n // 2:
                began = time.monotonic()
                server.terminate()
                server.wait(60)
                server = _start(ROOT, data, port)
                away_s = time.monotonic() - began
        if client.wait() != 0 or len(told) != n:
            raise SystemExit(f"the client ended after {len(told)} of {n} plans")
        return told, away_s, _count_wrong(address, told)
    finally:
        for process in (client, server):
            process.kill()
            process.wait()


def _count_wrong(address: str, told: list[dict[str, Any]]) -> dict[str, int]:
    """Return how many plans are gone, made twice, do not stand, or have lost their review."""
    wrong = dict.fromkeys(("gone or other", "do not stand", "reviews lost"), 0)
    request = load_request(REQUEST)
    with PlannerClient(address) as client:
        for one in told:
            again = client.plan(request, request_id=f"upgrade-{one['k']}")
            wrong["gone or other"] += again.plan_id != one["id"]
            wrong["do not stand"] += client.verify(one["id"]).standing.state != STANDING_STATE_HOLDS
            reviews = [review.comment for review in client.get_plan(one["id"]).record.reviews]
            wrong["reviews lost"] += reviews != ([f"plan {one['k']}"] if one["k"] % 3 == 0 else [])
    return wrong


def main() -> None:
    """Rehearse and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.service.upgrade")
    parser.add_argument("old", type=Path, help="checkout of the earlier release")
    parser.add_argument("--plans", type=int, default=12)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        told, away_s, wrong = _rehearse(given.old.resolve(), given.plans, Path(folder))
    rows = [("plans confirmed by the client", str(len(told))), ("nobody listened for", f"{away_s:.1f} s")]
    rows += [("refused while nobody listened", str(sum(one["refused"] for one in told)))]
    print_table(f"Upgrade from {given.old}", ("", ""), [*rows, *((name, str(count)) for name, count in wrong.items())])


if __name__ == "__main__":
    main()
