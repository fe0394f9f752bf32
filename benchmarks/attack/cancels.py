"""Cancels at random moments: scene, detection, plan and verify calls in a server's own pool, under ``faulthandler``.

Each kind of call runs once undisturbed, which says how long it takes; after that every one is cancelled (or given a
deadline) at a random moment of that time.  A worker that the pool kills leaves no stack; one that crashes does.
"""

from __future__ import annotations

import random
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.attack import bases, cancel_jobs
from benchmarks.attack.outcome import Answer, Outcome
from service import parse_request
from service.cloud_asked import CloudAsked
from service.executor import CancellableExecutor, DeadlineExceeded, ExecutorError, Job, LocalPool, WorkerDied
from service.server import launch, serve
from service.server.settings import WORKER_BYTES
from service.work.plan import warm_up

DATA = bases.ROOT / "examples" / "data"
DETECTED = ("valve", "drill", "panel", "opening", "lever")
WORKERS = 2
DEADLINES = 0.25  # share of the calls that are not cancelled, but given a deadline
ANSWER_S = 60.0  # in which a job must be done, cancelled or not
OURS = re.compile(r"/(perception|service/(?!executor)|costs|scopt)\b")


@dataclass
class Call:
    """A kind of call.

    Attributes:
        kind: of the table.
        submit: has a pool do it.
        usual_s: how long it takes undisturbed [s].
        ends: how the cancelled ones ended.
        slowest_s: from a cancel to the job's end [s].
    """

    kind: str
    submit: Callable[..., Job[Any]]
    usual_s: float = 1.0
    ends: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0


def run(count: int, seed: int = 0) -> Iterator[Outcome]:
    """Cancel ``count`` calls; one outcome for each kind of call, one for the crashes, one for the plan afterwards."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="attack-cancels-") as scratch, _pool() as pool:
        folder = Path(scratch)
        calls = _calls(pool, folder, is_short=count < 100)
        for call in calls:
            yield from _undisturbed(call)
        moments = [(calls[index % len(calls)], rng.random(), rng.random() < DEADLINES) for index in range(count)]
        with ThreadPoolExecutor(WORKERS) as at_once:
            list(at_once.map(_disturb, *zip(*moments, strict=True)))
        crashed = _stacks(folder)
        for call in calls:
            ends = ", ".join(f"{name} {number}" for name, number in call.ends.most_common())
            died = call.ends["worker died"] + call.ends["no answer"]
            text = f"{sum(call.ends.values())} cancelled: {ends}; slowest {call.slowest_s:.2f} s after the cancel"
            yield Outcome("cancels", f"{call.kind} calls", Answer.CRASHED if died else Answer.REPORTED, text)
        text = f"{count} cancels, {len(crashed)} crashes" + (f": {crashed[0]}" if crashed else "")
        yield Outcome("cancels", "crashes", Answer.CRASHED if crashed else Answer.REPORTED, text)
        yield _same_plan(pool)


def _undisturbed(call: Call) -> Iterator[Outcome]:
    began = time.monotonic()
    try:
        call.submit().result(ANSWER_S)
    except (ExecutorError, TimeoutError) as error:
        yield Outcome("cancels", f"{call.kind} call, undisturbed", Answer.CRASHED, f"{type(error).__name__}: {error}")
    call.usual_s = time.monotonic() - began


def _disturb(call: Call, when: float, is_deadline: bool) -> None:
    """Cancel one call at a share of its usual time, or give it a deadline there."""
    moment = 1.1 * when * call.usual_s
    if is_deadline:
        job = call.submit(deadline=time.monotonic() + moment)
        time.sleep(moment)
    else:
        job = call.submit()
        time.sleep(moment)
        job.cancel()
    stopped = time.monotonic()
    try:
        job.result(ANSWER_S)
        end = "answered"
    except WorkerDied:
        end = "worker died"
    except (CancelledError, DeadlineExceeded):
        end = "cancelled"
    except TimeoutError:
        end = "no answer"
    except Exception as error:
        end = type(error).__name__
    call.ends[end] += 1
    call.slowest_s = max(call.slowest_s, time.monotonic() - stopped)


def _calls(pool: CancellableExecutor, folder: Path, is_short: bool) -> list[Call]:
    """The calls, alike in size to what clients send."""
    valve = CloudAsked((DATA / "valve_scan.pcd",))
    door = CloudAsked((DATA / "door_scan.pcd",))
    request = parse_request(bases.request_of("reach" if is_short else "scan", folder / "request"))
    kept = bases.original("reach" if is_short else "valve") / "result"
    files = {str(path.relative_to(kept)): path.read_bytes() for path in kept.rglob("*") if path.is_file()}
    stacks = folder / "stacks"
    stacks.mkdir()

    def call(kind: str, function: Callable[..., Any], *arguments: Any) -> Call:
        return Call(kind, lambda **more: pool.submit(function, stacks, *arguments, max_attempts=1, **more))

    found = [
        call("scene", cancel_jobs.scene, door, ()),
        call("detection", cancel_jobs.detection, valve, "valve"),
        call("plan", cancel_jobs.plan, request),
        call("verify", cancel_jobs.verification, files),
    ]
    return found if is_short else [*found, call("scene with objects", cancel_jobs.scene, valve, DETECTED)]


@contextmanager
def _pool() -> Iterator[CancellableExecutor]:
    """Workers as a server has them; interrupted as a server's are, if they are."""
    more: dict[str, Any] = {"interrupt_s": launch.INTERRUPT_S} if hasattr(launch, "INTERRUPT_S") else {}
    with LocalPool(WORKERS, warm_up=warm_up, preload=serve.PRELOAD, max_bytes=WORKER_BYTES, **more) as pool:
        pool.wait_ready(120.0)
        yield pool


def _stacks(folder: Path) -> list[str]:
    """The first line, and the first of our own frames, of every stack that a crash left."""
    found = []
    for path in sorted((folder / "stacks").glob("*.txt")):
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        if lines:
            current = next((k for k, line in enumerate(lines) if line.startswith("Current thread")), 0)
            frames = [line.strip() for line in [*lines[current:], *lines] if OURS.search(line)]
            found.append(f"{lines[0]} {frames[0] if frames else ''}".strip())
    return found


def _same_plan(pool: CancellableExecutor) -> Outcome:
    """A plan of a worker that was cancelled many times equals that of a fresh process."""
    with tempfile.TemporaryDirectory(prefix="attack-plan-") as scratch:
        request = parse_request(bases.request_of("reach", Path(scratch)))
        after = [pool.submit(cancel_jobs.positions, request).result(ANSWER_S) for _ in range(3)]
        with LocalPool(1) as fresh:
            expected = fresh.submit(cancel_jobs.positions, request).result(ANSWER_S)
    is_same = all(found == expected for found in after)
    text = f"{expected[0]}, waypoints {'equal' if is_same else 'differ'}"
    return Outcome("cancels", "a plan after the cancels", Answer.REPORTED if is_same else Answer.CRASHED, text)
