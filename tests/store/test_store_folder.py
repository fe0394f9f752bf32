"""The store outlives its process, belongs to one, and says what is wrong with a file it cannot use."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.store import Decision, Store, StoreError

_BUSY = """
import sys
from pathlib import Path
from service.store import Decision, Store
store = Store(Path(sys.argv[1]))
print("open", flush=True)
for number in range(10**6):
    name = f"{sys.argv[2]}-{number}"
    plan_id = store.plans.begin("ann", name, "a" * 64, "goal").plan_id
    reply = plan_id.encode() * 500
    store.plans.finish(plan_id, "CERTIFIED", reply, plan_id, "c", archive=reply if number % 3 == 0 else b"")
    print("F", plan_id, flush=True)
    store.reviews.add(plan_id, Decision.ACCEPTED, "rev", plan_id, "c")
    print("R", plan_id, flush=True)
"""


def test_killing_the_process_at_any_moment_loses_no_finished_plan_and_no_review(tmp_path: Path) -> None:
    draw = random.Random(5)
    finished: set[str] = set()
    reviewed: set[str] = set()
    for run in range(6):
        command = [sys.executable, "-c", _BUSY, str(tmp_path), str(run)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "open\n"
            lines = [process.stdout.readline().rstrip("\n") for _ in range(draw.randint(10, 60))]
            time.sleep(draw.uniform(0.0, 0.005))
            os.kill(process.pid, signal.SIGKILL)
            lines += process.stdout.read().splitlines()
        finished |= {line[2:] for line in lines if line.startswith("F") and len(line) == 34}
        reviewed |= {line[2:] for line in lines if line.startswith("R") and len(line) == 34}
        with Store(tmp_path) as store:
            for plan_id in finished:
                plan = store.plans.get(plan_id)
                assert (plan.state, plan.reply) == ("finished", plan_id.encode() * 500)
                if plan.archive_bytes:
                    with store.plans.open_archive(plan_id) as archive:
                        assert archive.read() == plan.reply
            assert all(store.reviews.is_accepted(plan_id) for plan_id in reviewed)
    assert len(finished) >= 20
    assert len(reviewed) >= 20


def test_a_second_server_on_the_same_folder_is_refused_until_the_first_has_closed(tmp_path: Path) -> None:
    with Store(tmp_path), pytest.raises(StoreError, match="in use by another server"):
        Store(tmp_path)
    with Store(tmp_path):
        pass


def test_a_store_of_another_version_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    Store(tmp_path).close()
    with sqlite3.connect(tmp_path / "store.sqlite3") as connection:
        connection.execute("PRAGMA user_version = 7")
    connection.close()
    before = (tmp_path / "store.sqlite3").read_bytes()
    with pytest.raises(StoreError, match=r"store\.sqlite3: expected version 3, got 7"):
        Store(tmp_path)
    assert (tmp_path / "store.sqlite3").read_bytes() == before


def test_a_database_of_something_else_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "store.sqlite3") as connection:
        connection.execute("CREATE TABLE songs (title)")
    connection.close()
    with pytest.raises(StoreError, match="is the database of another application"):
        Store(tmp_path)


@pytest.mark.parametrize("damage", ["empty", "garbage", "cut", "overwritten"])
def test_a_damaged_file_is_told_and_named(tmp_path: Path, damage: str) -> None:
    with Store(tmp_path) as store:
        for number in range(20):
            plan_id = store.plans.begin("ann", str(number), "a" * 64, "goal").plan_id
            store.plans.finish(plan_id, "CERTIFIED", b"reply" * 1000, "p", "c")
            store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "p", "c")
    path = tmp_path / "store.sqlite3"
    data = path.read_bytes()
    path.write_bytes(
        {
            "empty": b"",
            "garbage": b"garbage" * 1000,
            "cut": data[: len(data) // 2],
            "overwritten": data[:8192] + b"\xff" * 40_000 + data[48_192:],
        }[damage]
    )
    with pytest.raises(StoreError, match=r"store\.sqlite3: is damaged .*; restore it, or move the folder away"):
        Store(tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"file/store: cannot be used as a folder"):
        Store(tmp_path / "file" / "store")
