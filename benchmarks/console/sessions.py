"""Random sessions at the console: ``python -m benchmarks.console.sessions [--sessions N] [--seconds S] [--seed K]``.

A real server with a simulated robot and a real console, but no browser: what stands for the page connects as it does,
shows what it would show, and clicks at random on what its buttons allow (``acts.list_clicks``), or gives an order that
no button would (``acts.list_forgeries``). Two operators share the robot. A third client only watches, and counts what
must not happen: falls, motions that no page showed, and hands that open around an object although nobody confirmed it.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Lock, Thread
from typing import Any

from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from benchmarks.console.acts import UNDER_WAY, Act, list_clicks, list_forgeries, next_click
from benchmarks.console.seat import Seat
from benchmarks.tables import print_table
from service.client import PlannerClient, PlannerError
from service.proto.planner.v1 import execution_pb2 as wire
from service.request.file import parse_request

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(ROOT / "tests" / "support" / folder) for folder in (".", "servers")]

from console_page import console_of  # type: ignore[import-not-found]  # noqa: E402
from planner_server import planner_server  # type: ignore[import-not-found]  # noqa: E402

ACTS = 20  # of a session
FORGED, SENSIBLE = 0.1, 0.55  # shares of orders that no button gives, and of clicks that lead on to a motion
OPENED_M = 0.004  # by which a finger has opened around what it holds
FINGER = "grip_1"  # joint of the robot that grasps
STANDING = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}}


class Witness:
    """What the robot did, by a client that only looks.

    Attributes:
        carried_out: hashes of all trajectories that it began.
        falls, openings: what must not be.
    """

    def __init__(self, target: str) -> None:
        self.carried_out: list[str] = []
        self.falls = self.openings = 0
        self._lock = Lock()
        self._next: Act | None = None  # the order that may begin the next motion
        self._may_open = False  # whether that which began the present one has confirmed what hands let go
        self._closed: float | None = None  # of the finger while it holds something
        self._mode = ""
        self._client = PlannerClient(target)
        Thread(target=self._watch, daemon=True).start()

    def expect(self, act: Act | None) -> None:
        """Note the order that may begin the next motion; None once it is refused."""
        with self._lock:
            self._next = act

    def _watch(self) -> None:
        with suppress(PlannerError):  # the server ends first
            self._follow()

    def _follow(self) -> None:
        for state in self._client.watch(rate_hz=50.0):  # each is the whole state
            mode = wire.ExecutionMode.Name(state.status.mode).removeprefix("EXECUTION_MODE_").lower()
            if mode in UNDER_WAY and self._mode not in UNDER_WAY:
                self._begin(state.plan.trajectory_sha256)
            self.falls += mode == "fallen" and self._mode != "fallen"
            self._mode = mode
            with self._lock:
                self._look(state)

    def _begin(self, trajectory_sha256: str) -> None:
        """Take note of a motion that begins."""
        self.carried_out.append(trajectory_sha256)
        with self._lock:
            self._may_open = self._next is not None and self._next.may_open
            if self._next is not None and self._next.is_placed:
                self._closed = None

    def _look(self, state: wire.WatchResponse) -> None:
        """Take note of what hands hold, and of a finger that opens around it."""
        if state.status.held and self._closed is None:
            self._closed = float("inf")
        elif not state.status.held and self._may_open:
            self._closed = None
        names = list(state.plan.joint_names)
        if self._closed is None or FINGER not in names or len(state.pose.measured) != len(names):
            return
        opening = state.pose.measured[names.index(FINGER)]
        self._closed = min(self._closed, opening)
        if opening > self._closed + OPENED_M and not self._may_open:
            self.openings += 1
            self._closed = None


@contextmanager
def open_table(folder: Path) -> Iterator[tuple[str, str]]:
    """A server with a simulated robot and plans, and its console; the addresses of both."""
    robots = folder / "robots"
    (robots / "gantry").mkdir(parents=True)
    shutil.move(write_gantry(folder), robots / "gantry" / "robot.urdf")
    (folder / "scans").mkdir()
    with (
        planner_server(folder / "data", "--robots", str(robots), "--robot", "sim,pace=8,period_ms=10") as server,
        console_of(server.address, folder / "scans") as url,
    ):
        make_plans(server.address, folder / "plans")
        yield server.address, url


def make_plans(target: str, folder: Path) -> None:
    """Have the plans made that random clicks find: a reach on feet, a block that is taken, put down, or forgotten."""
    put = pick_place_request(Path("gantry"))
    robot = {"name": "gantry", "hands": put["robot"]["hands"]}
    put["robot"] = robot
    grasp = {"grasp": {"object": "block", "hand": "right", "force_n": 40.0}}
    lift = {"move": {"frame": "block", "by": {"translation": [0, 0, 0.08]}, "along": "line"}}
    take = {**put, "task": {"steps": [grasp, lift]}}
    with PlannerClient(target) as client:
        client.plan(parse_request(STANDING), out=folder / "reach")
        client.plan(parse_request(put), out=folder / "put")
        taken = client.plan(parse_request(take), out=folder / "take").result.trajectory
        last = dict(zip(taken.joint_names, taken.positions[-len(taken.joint_names) :], strict=True))
        bare = {"floor": 0.0, "obstacles": put["scene"]["obstacles"]}
        start = {"joints": last}
        away = {"robot": robot, "start": start, "scene": bare, "goal": {"joints": {"x": last["x"] + 0.1}}}
        drop = {"robot": robot, "start": start, "scene": bare, "goal": {"joints": {FINGER: last[FINGER] + 0.01}}}
        for name, request in (("away", away), ("drop", drop)):
            client.plan(parse_request(request), out=folder / name)


def run_session(seats: list[Seat], rng: random.Random, witness: Witness, counts: Counter[str]) -> list[str]:
    """Click and forge at random at two seats; note what was asked and how it was answered, and return a line each."""
    told = []
    for _ in range(ACTS):
        seat = seats[0] if rng.random() < 0.8 else seats[1]
        seat.hear(0.0)
        act = choose(seat, rng)
        if act is None:
            continue
        if act.begins:  # before the answer, which comes later than the first cycle
            witness.expect(act)
        answer = act.give()
        if act.begins and "error" in answer:
            witness.expect(None)
        counts["acts"] += 1
        counts[act.name] += 1
        counts["refused"] += "error" in answer
        mode = seat.robot.get("mode", "")
        told.append(f"{act.name} {act.values or ''} ({mode}): {str(answer.get('error', 'done'))[:200]}")
        if answer.get("code") == "INTERNAL":
            counts["internal"] += 1
            print(f"{act.name}: {answer}", flush=True)
        seat.hear(rng.choice((0.0, 0.0, 0.03, 0.3)) if act.name != "execute" else rng.choice((0.05, 0.5, 1.5)))
    return told


def choose(seat: Seat, rng: random.Random) -> Act | None:
    """Return what the operator does next."""
    draw = rng.random()
    if draw < FORGED:
        acts = list(list_forgeries(seat, rng))
    elif draw < FORGED + SENSIBLE:
        acts = list(next_click(seat, rng))
    else:
        acts = list(list_clicks(seat, rng))
    return rng.choice(acts) if acts else None


def main() -> int:
    """Run the sessions and print; 1 if the robot did what it must not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.console.sessions", description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=3600.0, help="after which no further session begins")
    parser.add_argument("--seed", type=int, default=0, help="of the first session")
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    shown = set[str]()
    with tempfile.TemporaryDirectory(prefix="scopt-bench-") as folder, open_table(Path(folder)) as (target, url):
        print("  server and console are ready", flush=True)
        witness, end, n = Witness(target), time.monotonic() + given.seconds, 0
        while n < given.sessions and time.monotonic() < end:
            with ExitStack() as stack:
                seats = [stack.enter_context(Seat(url)) for _ in range(2)]
                before = witness.falls, witness.openings
                told = run_session(seats, random.Random(given.seed + n), witness, counts)
                if (witness.falls, witness.openings) != before:
                    print(*told, f"at last: {seats[0].robot.get('reason')}", sep="\n    ", flush=True)
                shown |= seats[0].shown | seats[1].shown
            n += 1
            wrong = witness.falls, witness.openings, len(set(witness.carried_out) - shown), counts["internal"]
            print(
                f"  {n} sessions, {counts['acts']} acts, {len(witness.carried_out)} motions, wrong {wrong}", flush=True
            )
        time.sleep(0.5)  # for what the witness has still to hear
    unseen = set(witness.carried_out) - shown
    rows: list[list[Any]] = [
        ["sessions", str(n), f"from seed {given.seed}"],
        ["clicks, keys and forged orders", str(counts["acts"]), f"{counts['refused']} refused"],
        ["motions carried out", str(len(witness.carried_out)), f"{len(unseen)} not shown before"],
        ["falls", str(witness.falls), ""],
        ["hands that opened without a confirmation", str(witness.openings), ""],
        ["orders that the console failed at", str(counts["internal"]), ""],
    ]
    print_table("Random sessions", ("", "", ""), rows)
    print("  " + ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    return int(bool(unseen) or witness.falls > 0 or witness.openings > 0 or counts["internal"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
