"""What a margin of balance is worth: far reaches planned with small and large margins, in physics with errors.

``python -m benchmarks.physics.margins [--reaches N] [--margins M ...] [--runs K] [--size S] [--seed S] [--out FILE]``

A hand of the bundled Atlas reaches as far forwards and down as its balance allows; goals that every margin lets it
reach are planned once for each, with the same seed. Each plan is carried out by position servos, with masses up to 5 %,
friction up to 0.1, surfaces up to 1 cm and joints up to 10 mrad off, sensor noise and 2 ms of delay, times ``--size``.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from costs.robot import RobotModel, load_robot
from service.planner import plan
from service.request.file import parse_request, request_hash
from service.result.result import PlanResult, Verdict
from service.simulation.options import SimulationOptions
from service.simulation.report import make_report
from service.simulation.run import execute_motion

MARGINS_M = (0.0, 0.02, 0.04)
FORWARD_M, ASIDE_M, HEIGHT_M = (0.75, 1.15), (0.0, 0.4), (0.25, 0.9)  # of goals before the robot
TOLERANCE_M = 0.01
NEAR_M = 0.05  # planned margin of the smallest margin that is asked for, up to which a goal counts
HEADER = (
    "margin asked for [mm]", "plans", "planned [mm]", "stood", "left in physics [mm]", "least [mm]", "hand off [mm]",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One execution.

    Attributes:
        goal: number of the goal.
        asked_m: margin of balance that was asked for.
        planned_m, left_m: smallest margin of the plan, and in physics; below 0 where the robot fell.
        hand_m: largest distance of the hand from its plan.
        has_stood: whether the robot stood.
        cause: of a fall.
    """

    goal: int
    asked_m: float
    planned_m: float
    left_m: float
    hand_m: float
    has_stood: bool
    cause: str


def draw_goals(seed: int) -> Iterator[dict[str, Any]]:
    """Yield requests with goals at the edge of what the balance allows, without end."""
    rng = np.random.default_rng([seed, 11])
    while True:
        side = str(rng.choice(["l", "r"]))
        aside = rng.uniform(*ASIDE_M) * (1.0 if side == "l" else -1.0)
        position = [float(rng.uniform(*FORWARD_M)), float(aside), float(rng.uniform(*HEIGHT_M))]
        pose = {"link": f"{side}_tool", "position": position, "position_tolerance_m": TOLERANCE_M}
        yield {
            "robot": {"name": "atlas"},
            "start": {"posture": "reach_ready"},
            "goal": {"poses": [pose]},
            "options": {"time_limit_s": 20.0, "seed": seed},
        }


def plan_all(data: dict[str, Any], margins: Sequence[float], robot: RobotModel) -> list[PlanResult] | None:
    """Return the plans of a goal for each margin; None where one fails, or the first is far from the edge."""
    made = []
    for margin in margins:
        request = parse_request({**data, "options": {**data["options"], "balance_margin_m": margin}})
        result = plan(request, robot=robot)
        if result.verdict is not Verdict.CERTIFIED or result.certificate is None:
            return None
        if not made and (result.certificate.min_balance_margin_m or 0.0) > NEAR_M:
            return None
        made.append(result)
    return made


def carry_out(number: int, asked: float, result: PlanResult, options: SimulationOptions) -> Run:
    """Carry out one plan."""
    assert result.motion is not None
    done = execute_motion(result.motion, result.request, result.verdict.value, request_hash(result.request), options)
    made, _ = make_report(done)
    balance, stood = made["balance"], made["verdict"] != "FELL"
    return Run(
        number,
        asked,
        float(balance["planned_margin_m"]),
        float(balance["margin_m"]) if balance["margin_m"] is not None else float("nan"),
        max((hand["worst_m"] for hand in made["hands"]), default=0.0),
        stood,
        next(iter(made["explanation"]), ""),
    )


def summary(asked: float, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return one row of the table."""
    stood = [run for run in runs if run.has_stood]
    return (
        f"{1e3 * asked:.0f}",
        str(len({run.goal for run in runs})),
        f"{1e3 * statistics.median(run.planned_m for run in runs):.0f}",
        f"{len(stood)}/{len(runs)}",
        f"{1e3 * statistics.median([run.left_m for run in stood] or [float('nan')]):.0f}",
        f"{1e3 * min([run.left_m for run in stood], default=float('nan')):.0f}",
        f"{1e3 * max(run.hand_m for run in runs):.0f}",
    )


def main() -> None:
    """Plan, carry out and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.margins", description=__doc__.splitlines()[0])
    parser.add_argument("--reaches", type=int, default=12)
    parser.add_argument("--margins", type=float, nargs="+", default=list(MARGINS_M), help="[m]")
    parser.add_argument("--runs", type=int, default=5, help="of each plan")
    parser.add_argument("--size", type=float, default=1.0, help="of the errors")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file for all runs as JSON")
    given = parser.parse_args()
    robot = load_robot("atlas")
    runs: list[Run] = []
    done = drawn = 0
    for data in draw_goals(given.seed):
        if done == given.reaches:
            break
        drawn += 1
        plans = plan_all(data, given.margins, robot)
        if plans is None:
            continue
        for asked, result in zip(given.margins, plans, strict=True):
            for seed in range(given.runs):
                options = SimulationOptions(perturb=given.size, noise=given.size, delay_ms=2.0, seed=seed)
                runs.append(carry_out(done, asked, result, options))
        own = [run for run in runs if run.goal == done]
        words = ", ".join(
            f"{1e3 * asked:.0f} mm: {sum(run.has_stood for run in own if run.asked_m == asked)} of {given.runs}"
            for asked in given.margins
        )
        print(f"goal {done} (of {drawn} drawn): stood with {words}", flush=True)
        done += 1
        if given.out is not None:
            given.out.write_text(json.dumps([asdict(run) for run in runs], indent=1) + "\n")
    rows = [summary(asked, [run for run in runs if run.asked_m == asked]) for asked in given.margins]
    print_table(f"{done} far reaches in physics, errors of size {given.size:g}, {given.runs} runs each", HEADER, rows)


if __name__ == "__main__":
    main()
