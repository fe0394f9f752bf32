"""Kills of workers under load: every request is answered exactly once."""

from __future__ import annotations

import sqlite3
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from random import Random

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, spread
from benchmarks.service.load import Load, generating
from benchmarks.service.servers import Server, kill, started
from service.server.serve import STORE_FOLDER
from service.store.store import DATABASE_NAME

WORKERS, CLIENTS = 2, 6
EVERY_S = 5.0


def measure(options: Options, folder: Path) -> list[Figure]:
    """Kill a worker (``kill -9``) every five seconds for five minutes."""
    request = asks.plan_request(asks.OVER_A_TABLE).SerializeToString()
    with started(folder, workers=WORKERS) as server:
        load = Load(server.address, request, "killed", clients=CLIENTS, seconds=options.time_s(300.0, 21.0))
        with generating(load) as sending:
            kills = _kill_until(sending.done, server, Random(options.seed))
            calls = sending.result()
        status = server.status()
        stored = _stored(folder)
        worked = sum(status.verdicts.values())
    lost = [call for call in calls if call.code != "OK" or call.plans == 0]
    twice = sum(call.plans > 1 for call in calls) + sum(n > 1 for n in stored.values()) + max(worked - len(calls), 0)
    missing = sum(call.request_id not in stored for call in calls if call.plans)
    codes = Counter(call.code for call in lost)
    return [
        Figure(f"{kills} workers killed under load: requests lost of {len(calls)}", "0",
               f"{len(lost)} {dict(codes) if lost else ''}".strip(), not lost and kills > 0),
        Figure("  answered twice (by the client's count, the store's and the server's)", "0", str(twice), twice == 0),
        Figure("  answered and not in the store", "0", str(missing), missing == 0),
        Figure("  time of an answer", "", spread([call.took for call in calls])),
        Figure("  workers replaced, by the server's count", "", str(status.worker_restarts)),
    ]  # fmt: skip


def _kill_until(is_done: Callable[[], bool], server: Server, random: Random) -> int:
    kills, at = 0, time.monotonic() + EVERY_S
    while not is_done():
        if time.monotonic() >= at:
            at += EVERY_S
            busy = [worker.pid for worker in server.status().workers if worker.state == "busy"]
            kills += bool(busy) and kill(random.choice(busy))
        time.sleep(0.05)
    return kills


def _stored(folder: Path) -> Counter[str]:
    """Return the finished plans in the store by request id."""
    path = folder / "data" / STORE_FOLDER / DATABASE_NAME
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        rows = database.execute("SELECT request_id FROM plans WHERE state = 'finished'")
        return Counter(row[0] for row in rows)
