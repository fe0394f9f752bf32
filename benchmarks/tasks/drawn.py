"""Draws of requests, planned and carried out in physics: certified or not, done or not, at what cost."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterable

from costs.robot import RobotModel
from service.errors import RequestError
from service.planner import plan
from service.request.schema import PlanRequest
from service.result.result import Verdict
from service.simulation.options import SimulationOptions
from service.simulation.run import execute_motion
from service.simulation.verdict import judge

COLUMNS = ("certified", "done", "median CPU [s]", "longest [s]")


def carry_out_draws(
    name: str, draws: Iterable[tuple[int, PlanRequest]], perturb: float, robot: RobotModel | None = None
) -> list[str]:
    """Plan every draw, carry out what is certified, print a line each, and return the cells of ``COLUMNS``.

    Args:
        name: of the draws.
        draws: their numbers and requests.
        perturb: size of the errors in physics, relative to those of ``scopt simulate``.
        robot: of all requests, if it is loaded already.
    """
    times, certified, done = list[float](), 0, 0
    for number, request in draws:
        started = time.process_time()
        try:
            result = plan(request, robot=robot)
        except RequestError as error:  # the draw has the robot inside its furniture
            print(f"{name} {number}: no start: {error}", flush=True)
            continue
        times.append(time.process_time() - started)
        text = f"{name} {number}: {result.verdict.value} in {times[-1]:.1f} s"
        if result.verdict is Verdict.CERTIFIED and result.motion is not None:
            certified += 1
            options = SimulationOptions(perturb=perturb, seed=number)
            runs = execute_motion(result.motion, request, result.verdict.value, "", options)
            verdicts = [judge(run.reference, run.record, run.model.physics) for run in runs]
            done += all(verdict.verdict == "DONE" for verdict in verdicts)
            text += "".join(f", {verdict.verdict} {'; '.join(verdict.reasons)[:160]}" for verdict in verdicts)
        else:
            text += f": {' '.join(result.explanation)[:300]}"
        print(text, flush=True)
    cost = [f"{statistics.median(times):.1f}", f"{max(times):.1f}"] if times else ["-", "-"]
    return [f"{certified} of {len(times)}", f"{done} of {len(times)}", *cost]
