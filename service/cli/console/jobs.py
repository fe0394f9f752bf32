"""Plans that an operator asked for at the page: they go on while the page is gone, and a new page sees them."""

from __future__ import annotations

import asyncio
import json
import logging
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from pathlib import Path
from typing import Any

import numpy as np

from service.cli.console.robot import Standstill
from service.cli.console.sessions import OperatorSession
from service.client import PlannerError
from service.client.answers import check_result, read_verdict
from service.errors import RequestError, ServiceError
from service.execution.reference import PlannedReference
from service.proto.planner.v1.planner_pb2 import PlanResponse
from service.replay.adjust import adjust_shifted
from service.replay.rest import make_rest_request, read_recorded_scan
from service.request.schema import PlanRequest

_LOG = logging.getLogger("scopt.console")
MOST_JOBS = 20  # that a session remembers
MOST_RUNNING = 4
REST = "rest"  # in the place of a task's name
TELL_EVERY_S = 0.1
RUNNING = ("uploading", "queued", "planning")


def start_plan(session: OperatorSession, task: str, request: PlanRequest) -> dict[str, Any]:
    """Begin a plan, and return it as pages draw it; what becomes of it is told to all pages of the session.

    Raises:
        RequestError: too many plans run.
    """
    running = [job for job in session.jobs.values() if job["state"] in RUNNING]
    if len(running) >= MOST_RUNNING:
        raise RequestError(f"{len(running)} plans run already; stop one, or wait for it")
    number = max(session.jobs, default=0) + 1
    job = session.jobs[number] = {
        "job": number, "task": task, "state": "uploading", "step": "", "fraction": 0.0, "plan_id": "", "verdict": "",
        "error": "",
    }  # fmt: skip
    for old in sorted(session.jobs)[:-MOST_JOBS]:
        if session.jobs[old]["state"] not in RUNNING:
            del session.jobs[old]
    session.tasks[number] = asyncio.create_task(_follow(session, number, request))
    return dict(job)


async def plan_rest(session: OperatorSession) -> dict[str, Any]:
    """Begin the plan of the rest of what the robot carries out, from where it rests, and return it as pages draw it.

    What a shifted foot or hand reaches for is displaced as far as its link was.

    Raises:
        ExecutionError: the robot carries out no plan, or moves.
        RequestError, ResultError: the rest cannot be planned from there.
        PlannerError: the server does not give the plan's files.
    """
    standstill = session.robot.find_standstill()
    with tempfile.TemporaryDirectory(prefix="scopt-console-") as scratch:
        folder = Path(scratch) / "plan"
        await session.client.get_plan(standstill.plan_id, out=folder)
        request = await asyncio.to_thread(make_rest, folder, standstill)
    return start_plan(session, REST, request)


def make_rest(folder: Path, standstill: Standstill) -> PlanRequest:
    """Return the request for the rest of the plan in a folder, from where the robot rests in it.

    Raises:
        RequestError, ResultError: the rest cannot be planned from there.
    """
    reference = PlannedReference.read(folder)
    moved = reference.at(standstill.clock_s).mechanism.tolist()
    state = {**standstill.start, "mechanism": dict(zip(reference.mechanism_names, moved, strict=True))}
    file = folder.with_name("state.json")
    file.write_text(json.dumps(state))
    request = make_rest_request(folder, standstill.phase, file)
    if read_recorded_scan(folder, request) is not None:
        raise RequestError(
            "the plan's scan shows the robot where the plan began; its rest needs a new scan: scan again, and plan the "
            "task in its tab, or use scopt plan --from-phase with --cloud"
        )
    for link, offset in standstill.shifts.items():
        request = adjust_shifted(request, link, np.array(offset))
    return request


def cancel_plan(session: OperatorSession, number: int) -> None:
    """Stop a plan, here and at the server.

    Raises:
        RequestError: there is no such plan.
    """
    if number not in session.jobs:
        raise RequestError(f"job: there is no plan {number} at this console")
    task = session.tasks.get(number)
    if task is not None:
        task.cancel()


async def _follow(session: OperatorSession, number: int, request: PlanRequest) -> None:
    job = session.jobs[number]

    def tell(**changes: Any) -> None:
        job.update(changes)
        session.tell({"event": "job", **job})

    try:
        async with aclosing(session.client.plan_events(request, with_files=True)) as events:
            await _read_events(events, tell)
    except asyncio.CancelledError:
        tell(state="stopped")
        raise
    except PlannerError as error:
        tell(state="failed", error="; ".join(error.problems))
    except ServiceError as error:
        tell(state="failed", error=str(error))
    except Exception:
        _LOG.exception("plan failed")
        tell(state="failed", error="the console failed at this plan; see its log")
    finally:
        session.tasks.pop(number, None)


async def _read_events(events: AsyncIterator[PlanResponse], tell: Callable[..., None]) -> None:
    told, step, verdict = 0.0, "", ""
    async for event in events:
        match event.WhichOneof("event"):
            case "accepted":
                tell(state="planning", plan_id=event.accepted.plan_id)
            case "queued":
                tell(state="queued", step=f"place {event.queued.place} in the queue")
            case "progress":
                if event.progress.step != step or time.monotonic() - told > TELL_EVERY_S:
                    step, told = event.progress.step, time.monotonic()
                    tell(state="planning", step=step, fraction=event.progress.fraction)
            case "finished":
                check_result(event.finished.result)
                verdict = read_verdict(event.finished.result)
            case _:
                pass  # files, which are fetched when the plan is opened
    # Its files are stored by now, so that it can be opened.
    if verdict:
        tell(state="finished", verdict=verdict, fraction=1.0)
    else:
        tell(state="failed", error="the server ended the call without a plan")
