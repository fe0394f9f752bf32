"""Cancels at random moments: scene, detection, plan and verify calls in one worker of a server's pool.

These are failures: a worker that crashes (its faulthandler prints where), a job without an answer, and a plan after a
cancel that differs from the plan of a fresh process.
"""

from __future__ import annotations

import io
import logging
import sys
import tarfile
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack.outcome import Answer, Outcome
from perception import Cloud, read_cloud, write_npz
from service.executor import JobCancelled, LocalPool
from service.request.choices import EVERY_KIND, KINDS
from service.request.file import load_request
from service.request.schema import PlanRequest
from service.scan.cloud import CloudInput
from service.server.serve import PRELOAD
from service.work.look import DetectTask, SceneTask, build_scene, detect, verify
from service.work.plan import PlanAnswer, PlanTask, run_plan, warm_up

EXAMPLES = Path(__file__).parents[2] / "examples"
SCAN = EXAMPLES / "data" / "valve_scan.pcd"
DENSER, THINNER = 3, 6  # times the points of the scan, and every how many of them
CHECKED_EVERY = 5  # cancels after which a plan is compared, besides the last
AT_LONGEST_S = 900.0
CRASHES = ("Fatal Python error", "Segmentation fault", " ended: ")


@dataclass
class Report:
    """Effects of all cancels so far.

    Attributes:
        outcomes: by kind of job, how often it was ``stopped`` (by itself), ``killed``, ``answered`` (before it heard).
        crashes: lines of the pool's log that report a dead worker.
        wrong: jobs with a wrong ending, and plans that differ from those of a fresh process.
        n_compared: plans that were compared.
        slowest_s: longest time from a cancel to the job's end [s].
    """

    outcomes: dict[str, Counter[str]] = field(default_factory=dict)
    crashes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    n_compared: int = 0
    slowest_s: float = 0.0

    @property
    def n_cancels(self) -> int:
        """Number of jobs that were cancelled."""
        return sum(counter.total() for counter in self.outcomes.values())

    @property
    def is_clean(self) -> bool:
        """Whether nothing crashed and nothing was wrong."""
        return not self.crashes and not self.wrong


@dataclass(frozen=True)
class _Attack:
    """A job to cancel: a top-level function of ``service.work`` and its arguments."""

    kind: str
    fn: Callable[..., Any]
    arguments: tuple[Any, ...]


def run(
    count: int, seed: int = 0, on_cancel: Callable[[Report], object] = lambda _: None, is_short: bool = False
) -> Report:
    """Cancel ``count`` jobs at random moments.

    Args:
        count: number of cancels.
        seed: of the choice of jobs and moments; the moment at which a worker sees the cancel varies between runs.
        on_cancel: called with the report so far after each cancel.
        is_short: take a thinner scan, and leave out detections of all kinds at once, plans of a valve, and half of
            the comparisons.
    """
    rng, report = np.random.default_rng(seed), Report()
    names = ("pose_goal.yaml",) if is_short else ("pose_goal.yaml", "valve.yaml")
    requests = [load_request(EXAMPLES / "requests" / name) for name in names]
    fresh = _fresh_plans(requests)
    typical: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory(prefix="scopt-cancels-") as scratch,
        deaths(report),
        LocalPool(1, preload=PRELOAD, warm_up=warm_up) as pool,
    ):
        scans = (_thinner_scan(Path(scratch)),) if is_short else (SCAN, _denser_scan(Path(scratch)))
        kinds = KINDS if is_short else (*KINDS, EVERY_KIND)
        attacks = _attacks(rng, requests, _files(fresh[0]), scans, kinds)
        for index in range(count):
            attack = next(attacks)
            _cancel(pool, attack, rng.uniform(0.0, 1.1), typical, report)
            on_cancel(report)
            every = 2 * CHECKED_EVERY if is_short else CHECKED_EVERY
            if index % every == every - 1 or index == count - 1:
                which = index // every % len(requests)
                answer = pool.submit(run_plan, PlanTask(requests[which])).result(AT_LONGEST_S)
                report.n_compared += 1
                if _hashes(answer) != _hashes(fresh[which]):
                    report.wrong.append(f"cancel {index}: the plan after it differs from that of a fresh process")
    return report


def _attacks(
    rng: np.random.Generator,
    requests: list[PlanRequest],
    files: Mapping[str, bytes],
    scans: tuple[Path, ...],
    kinds: tuple[str, ...],
) -> Iterator[_Attack]:
    while True:
        clouds = CloudInput((scans[int(rng.integers(len(scans)))],))
        unknown = str(rng.choice(["free", "occupied"])) if EVERY_KIND in kinds else "free"
        yield _Attack("scene", build_scene, (SceneTask(clouds, (str(rng.choice(KINDS)),), unknown=unknown),))
        yield _Attack("detect", detect, (DetectTask(clouds, str(rng.choice(kinds))),))
        yield _Attack("plan", run_plan, (PlanTask(requests[int(rng.integers(len(requests)))]),))
        yield _Attack("verify", verify, (files,))


def _denser_scan(folder: Path) -> Path:
    """Return the scan with many times the points, so that searches for neighbours take long."""
    cloud, rng = read_cloud(SCAN), np.random.default_rng(0)
    points = np.concatenate([cloud.points + rng.normal(0.0, 0.004, cloud.points.shape) for _ in range(DENSER)])
    write_npz(folder / "dense.npz", Cloud(points, np.median(np.atleast_2d(cloud.origin), axis=0)))
    return folder / "dense.npz"


def _thinner_scan(folder: Path) -> Path:
    """Return the scan with a part of its points."""
    cloud = read_cloud(SCAN)
    write_npz(folder / "thin.npz", Cloud(cloud.points[::THINNER], np.median(np.atleast_2d(cloud.origin), axis=0)))
    return folder / "thin.npz"


def _cancel(pool: LocalPool, attack: _Attack, share: float, typical: dict[str, float], report: Report) -> None:
    """Submit a job, cancel it after that share of its usual time, and note how it ended."""
    if attack.kind not in typical:  # in a worker that has done nothing like it yet
        started = time.monotonic()
        pool.submit(attack.fn, *attack.arguments).result(AT_LONGEST_S)
        typical[attack.kind] = time.monotonic() - started
    job = pool.submit(attack.fn, *attack.arguments)
    while job.started is None and not job.done():
        time.sleep(0.001)
    time.sleep(share * typical[attack.kind])
    asked = time.monotonic()
    job.cancel()
    how = "answered"
    try:
        answer = job.result(AT_LONGEST_S)
        if isinstance(answer, PlanAnswer) and answer.verdict == "CANCELLED":
            how = "stopped"
    except JobCancelled as error:
        how = "stopped" if "by itself" in str(error) and "did not" not in str(error) else "killed"
    except CancelledError:
        how = "stopped"
    except Exception as error:  # of any kind: that is what is looked for
        report.wrong.append(f"{attack.kind}: {type(error).__name__}: {error}")
        how = "wrong"
    report.slowest_s = max(report.slowest_s, time.monotonic() - asked)
    report.outcomes.setdefault(attack.kind, Counter())[how] += 1


def _fresh_plans(requests: list[PlanRequest]) -> list[PlanAnswer]:
    """Return plans of processes that have done nothing else."""
    with LocalPool(1, preload=PRELOAD, warm_up=warm_up, recycle_after=1) as pool:
        answers = [pool.submit(run_plan, PlanTask(one, with_files=True)).result(AT_LONGEST_S) for one in requests]
    refused = [answer for answer in answers if not isinstance(answer, PlanAnswer)]
    if refused:
        raise RuntimeError(f"an example's request was refused: {refused}")
    return [answer for answer in answers if isinstance(answer, PlanAnswer)]


def _hashes(answer: object) -> tuple[str, ...]:
    if not isinstance(answer, PlanAnswer):
        return (repr(answer),)
    return answer.verdict, answer.trajectory_sha256, answer.certificate_sha256


def _files(answer: PlanAnswer) -> dict[str, bytes]:
    """Return the files of a plan's result folder by their path in it."""
    with tarfile.open(fileobj=io.BytesIO(answer.archive)) as archive:
        members = [(member.name, archive.extractfile(member)) for member in archive.getmembers()]
        return {name: stream.read() for name, stream in members if stream is not None}


@contextmanager
def deaths(report: Report) -> Iterator[None]:
    """Add the dead workers in the pool's log to the report."""

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            line = record.getMessage()
            if any(sign in line for sign in CRASHES):
                report.crashes.append(line)

    log, listener = logging.getLogger("service.executor"), Listener(logging.INFO)
    level = log.level
    log.addHandler(listener)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(listener)
        log.setLevel(level)


def outcomes(count: int, seed: int = 0, *, is_short: bool = False) -> Iterator[Outcome]:
    """Cancel jobs; yield the outcome of each kind of job and of the pool as rows of the attacks' table."""
    report = run(count, seed, _tell, is_short)
    for kind, counter in sorted(report.outcomes.items()):
        text = ", ".join(f"{how} {number}" for how, number in counter.most_common())
        yield Outcome("cancels", f"{kind} calls", Answer.CRASHED if counter["wrong"] else Answer.REPORTED, text)
    crashes = f"{report.n_cancels} cancels, {len(report.crashes)} crashes, slowest end {report.slowest_s:.2f} s"
    answer = Answer.CRASHED if report.crashes else Answer.REPORTED
    yield Outcome("cancels", "crashes", answer, "; ".join((crashes, *report.crashes[:1])))
    plans = f"{report.n_compared} plans compared with those of a fresh process"
    answer = Answer.CRASHED if report.wrong else Answer.REPORTED
    yield Outcome("cancels", "plans after cancels", answer, "; ".join((plans, *report.wrong[:1])))


def _tell(report: Report) -> None:
    if report.n_cancels % 50 == 0:
        print(f"{report.n_cancels} cancels, {len(report.crashes)} crashes, {len(report.wrong)} wrong", file=sys.stderr)
