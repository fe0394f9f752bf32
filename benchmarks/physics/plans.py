"""Certified plans carried out in physics: how many robots stand and do their work, how far they slip and sag.

``python -m benchmarks.physics.plans [--reaches N] [--valves N] [--doors N] [--examples NAME ...] [--seed S] [--long]
[--feed-forward K] [--noise K] [--track MS] [--only TEXT] [--each] [--out FILE]``

The examples are the files of ``examples/requests``; reaches are those of ``benchmarks.planning.whole_body`` among 60
boxes, valves and doors those of ``benchmarks.tasks.given`` from the place that ``scopt stance`` finds.  ``--long``
plans 160 reaches, 24 valves and 16 doors.  ``--track MS`` also carries every plan out with online pose control every MS
milliseconds, guards included.
"""

from __future__ import annotations

import argparse
import copy
import json
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from benchmarks.planning.crowded_scenes import crowded_scenes
from benchmarks.tables import print_table
from benchmarks.tasks.given import stand
from benchmarks.tasks.given_cases import Case, make_doors, make_valves
from costs.robot import RobotModel, load_robot
from service.errors import ServiceError
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.execution.tracking import track
from service.planner import plan
from service.request.file import load_request, parse_request, request_hash
from service.request.schema import PlanRequest
from service.result.result import Verdict
from service.simulation.options import SimulationOptions
from service.simulation.report import ABORT_AFTER_S, make_report
from service.simulation.run import execute_motion
from service.simulation.stand import stand_in_physics
from service.tasks.stances.search import find_stance
from service.verify import Motion

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
SLOW = ("egress",)  # plans for minutes
BOXES = 60
N_REACHES, N_VALVES, N_DOORS = 12, 4, 2
LONG_REACHES, LONG_VALVES, LONG_DOORS = 160, 24, 16
PLAN_LIMIT_S, STANCE_LIMIT_S = 900.0, 120.0  # wall time, so that a busy machine does not decide
OPEN_DEG = 45.0
HEADER = (
    "plans", "certified", "stood", "done", "slip [mm]", "hand [mm]", "margin [mm]", "turned", "force/abort", "above",
    "tracked", "x real time",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One plan in physics.

    Attributes:
        group, name: of the plan.
        verdict: of the planner; of the simulation where it was certified.
        cause: why the robot fell, or the plan was not made.
        slip_m, hand_m: farthest that a foot slipped and a hand was from its place.
        planned_margin_m, margin_m: balance margin on level soles, planned and in physics; None elsewhere.
        share: least share of a mechanism's travel, or None.
        force_share: largest force of a hand on a mechanism relative to its abort threshold, or None.
        exceeded_s: longest time above that threshold.
        tracked: verdict of the plan carried out with online pose control, and the reason of an abort; empty: not done.
        times_real_time: of the simulation, by processor time.
        notes: of the simulation.
    """

    group: str
    name: str
    verdict: str
    cause: str
    slip_m: float = 0.0
    hand_m: float = 0.0
    planned_margin_m: float | None = None
    margin_m: float | None = None
    share: float | None = None
    force_share: float | None = None
    exceeded_s: float = 0.0
    tracked: str = ""
    times_real_time: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def is_certified(self) -> bool:
        """Whether the plan was certified, and so simulated."""
        return self.verdict in ("DONE", "STOOD", "FELL")


def run_plan(
    group: str,
    name: str,
    request: PlanRequest,
    robot: RobotModel | None,
    options: SimulationOptions,
    track_ms: int = 0,
) -> Run:
    """Plan one request and carry it out; with online pose control too unless ``track_ms`` is 0."""
    try:
        result = plan(request, robot=robot)
        if result.verdict is not Verdict.CERTIFIED or result.motion is None:
            return Run(group, name, result.verdict.value, next(iter(result.explanation), ""))
        made, _ = make_report(
            execute_motion(result.motion, result.request, result.verdict.value, request_hash(result.request), options)
        )
        tracked = follow_plan(result.motion, result.request, options, track_ms) if track_ms else ""
    except ServiceError as error:
        return Run(group, name, "ERROR", str(error).splitlines()[0])
    shares = [joint["share"] for joint in made["mechanism"]]
    loads = [load for phase in made["phases"] for load in phase["loads"]]
    return Run(
        group=group,
        name=name,
        verdict=made["verdict"],
        cause=next(iter(made["explanation"]), ""),
        slip_m=max((slip["worst_m"] for slip in made["slip"]), default=0.0),
        hand_m=max((hand["worst_m"] for hand in made["hands"]), default=0.0),
        planned_margin_m=made["balance"]["planned_margin_m"],
        margin_m=made["balance"]["margin_m"],
        share=min(shares) if shares else None,
        force_share=max((load["peak_n"] / load["abort_n"] for load in loads), default=None),
        exceeded_s=max((load["exceeded_s"] for load in loads), default=0.0),
        tracked=tracked,
        times_real_time=made["times_real_time"],
        notes=tuple(made["notes"]),
    )


def follow_plan(motion: Motion, request: PlanRequest, options: SimulationOptions, period_ms: int) -> str:
    """Carry out a motion with online pose control in physics; return the verdict and the reason of an abort."""
    reference = PlannedReference(motion)
    report = track(Execution(reference, stand_in_physics(reference, request, options, period_ms)))
    return f"{report.verdict} {report.reason}".strip()


def list_plans(
    arguments: argparse.Namespace, robot: RobotModel
) -> Iterator[tuple[str, str, Callable[[], PlanRequest]]]:
    """Yield group and name of every plan, and what makes its request."""
    for path in sorted(REQUESTS.glob("*.yaml")):
        if path.stem in arguments.examples or (not arguments.examples and path.stem not in SLOW):
            yield "examples", path.stem, partial(load_request, path)
    for scene in islice(crowded_scenes(robot, BOXES, is_pose=False, seed=arguments.seed), arguments.reaches):
        yield "reaches", scene.name, partial(copy.copy, scene.request)
    for case in make_valves(arguments.valves, arguments.seed):
        yield "valves", case.name, partial(_place, case)
    for case in make_doors(arguments.doors, arguments.seed, OPEN_DEG):
        yield "doors", case.name, partial(_place, case)


def _place(case: Case) -> PlanRequest:
    """Return a case's request at the best place to stand."""
    data = copy.deepcopy(case.request)
    data["options"] = {"time_limit_s": PLAN_LIMIT_S}
    request = parse_request(data)
    return stand(request, find_stance(request, STANCE_LIMIT_S))


def summary(group: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return one row of the table: medians, and the worst in brackets."""
    done = [run for run in runs if run.is_certified]
    stood = [run for run in done if run.verdict != "FELL"]
    worked = sum(run.verdict == "DONE" for run in done)
    cells = [group, str(len(runs)), str(len(done)), f"{len(stood)}/{len(done)}", f"{worked}/{len(done)}"]
    if not stood:
        return (*cells, "-", "-", "-", "-", "-", "-", "-", "-")
    for key in ("slip_m", "hand_m"):
        values = [1e3 * getattr(run, key) for run in stood]
        cells.append(f"{statistics.median(values):.1f} ({max(values):.1f})")
    margins = [1e3 * run.margin_m for run in stood if run.margin_m is not None]
    shares = [100.0 * run.share for run in stood if run.share is not None]
    cells.append(f"{statistics.median(margins):.0f} ({min(margins):.0f})" if margins else "-")
    cells.append(f"{statistics.median(shares):.0f} % ({min(shares):.0f} %)" if shares else "-")
    forces = [run.force_share for run in stood if run.force_share is not None]
    cells.append(f"{statistics.median(forces):.2f} ({max(forces):.2f})" if forces else "-")
    cells.append(str(sum(run.exceeded_s > ABORT_AFTER_S for run in stood)) if forces else "-")
    followed = [run for run in done if run.tracked]
    cells.append(f"{sum(run.tracked == 'TRACKED' for run in followed)}/{len(followed)}" if followed else "-")
    return (*cells, f"{statistics.median(run.times_real_time for run in done):.1f}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Plan, simulate and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.plans", description=__doc__.splitlines()[0])
    parser.add_argument("--reaches", type=int)
    parser.add_argument("--valves", type=int)
    parser.add_argument("--doors", type=int)
    parser.add_argument("--examples", nargs="*", default=[], help="names of files in examples/requests; default all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--long", action="store_true", help="200 plans")
    parser.add_argument("--feed-forward", type=float, default=1.0)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--track", type=int, default=0, metavar="MS", help="with online pose control too")
    parser.add_argument("--only", default="", help="plans whose name contains this")
    parser.add_argument("--each", action="store_true", help="print a line per plan")
    parser.add_argument("--out", type=Path, help="file for all runs as JSON")
    given = parser.parse_args(arguments)
    for key, short, long in (
        ("reaches", N_REACHES, LONG_REACHES), ("valves", N_VALVES, LONG_VALVES), ("doors", N_DOORS, LONG_DOORS),
    ):  # fmt: skip
        if getattr(given, key) is None:
            setattr(given, key, long if given.long else short)
    robot = load_robot("atlas")
    options = SimulationOptions(feed_forward=given.feed_forward, noise=given.noise, seed=given.seed)
    runs: list[Run] = []
    began = time.perf_counter()
    for group, name, make_request in list_plans(given, robot):
        if given.only not in name:
            continue
        request = make_request()
        own = robot if group == "reaches" else None
        runs.append(run_plan(group, name, request, own, options, given.track))
        if given.each:
            run = runs[-1]
            words = "; ".join(part for part in (run.cause, *run.notes, run.tracked) if part)
            print(f"{run.verdict:<10} {group:<9} {name}  {words}", flush=True)
    groups: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.group].append(run)
    rows = [summary(group, members) for group, members in groups.items()]
    title = "Certified plans in physics, position servos with feed-forward, no balance control; medians (worst)"
    print_table(title, ("group", *HEADER), [*rows, summary("all", runs)])
    for run in runs:
        if run.verdict in ("FELL", "STOOD"):
            print(f"  {run.name}: {run.cause}")
    print(f"  {time.perf_counter() - began:.0f} s in all")
    if given.out is not None:
        given.out.write_text(json.dumps([asdict(run) for run in runs], indent=1))


if __name__ == "__main__":
    main()
