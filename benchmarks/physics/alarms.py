"""Plans carried out in physics in which nothing is wrong: what do the guards of the execution find all the same?

``python -m benchmarks.physics.alarms [NAME|FOLDER ...] [--period MS] [--noise K] [--seed S] [--between S S]``.

Names are files of ``examples/requests``, by default all but the slow one.  Each plan is carried out from its beginning
to its end with pose control, noise of the sensors and the work it moves.  A false alarm is whatever a guard does to
the run: goes slowly, holds, goes back or ends.  Waits for a contact are printed, but not counted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.physics.perturbed import list_folders
from benchmarks.physics.plans import REQUESTS, SLOW
from benchmarks.tables import print_table
from service.demands.kind import read_mechanism_physics
from service.execution.execution import Cycle, Execution
from service.execution.guards import Severity
from service.execution.machine import Mode
from service.execution.reference import PlannedReference
from service.execution.settings import ExecutionSettings
from service.execution.tracking import TrackReport, track
from service.execution.watch.servos import ServoModel
from service.execution.watch.watch import WatchSettings
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.simulation.stand import read_recorded_request
from service.start.robot import resolve_stiffness

HEADER = ("plan", "verdict", "plan [s]", "run [s]", "alarms", "first alarm", "CPU [s]")


def carry_out(folder: Path, period_ms: int, noise: float, seed: int, between: tuple[float, float]) -> TrackReport:
    """Carry out the plan of a result folder in physics as it was planned; print each finding when it first comes.

    Args:
        folder: of the result.
        period_ms: of the pose control [ms].
        noise: of the sensors, share of the usual one.
        seed: of the noise.
        between: times of the plan to begin and to stop at [s]; the robot rests where it begins.
    """
    begin, end = between
    reference, request = PlannedReference.read(folder), read_recorded_request(folder)
    options = SimulationOptions(noise=noise, seed=seed, hand_friction=request.options.hand_friction[0])
    stiffness = resolve_stiffness(reference.robot, request)
    model = build_physics(reference.motion, read_mechanism_physics(request), options, stiffness)
    robot = SimulatedRobot(model, reference.at(begin).configuration, options, period_ms)
    watch = WatchSettings(servos=ServoModel(stiffness=stiffness))
    execution = Execution(reference, robot, ExecutionSettings(watch=watch), begin)
    told = set[tuple[str, str]]()

    def look(cycle: Cycle) -> None:
        robot.hold_grips(reference.find_phase_number(cycle.state.time_s))
        for finding in cycle.findings:
            if finding.severity is not Severity.NOTE and (finding.name, finding.link) not in told:
                told.add((finding.name, finding.link))
                print(f"  {cycle.state.time_s:.2f} s {finding.severity.value}: {finding.sentence}", flush=True)
        if cycle.state.time_s >= end and not execution.state.is_over:
            execution.state = replace(execution.state, mode=Mode.DONE, rate=0.0)

    return track(execution, on_cycle=look)


def main(arguments: Sequence[str] | None = None) -> None:
    """Plan, carry out and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.alarms", description=__doc__.splitlines()[0])
    names = sorted(path.stem for path in REQUESTS.glob("*.yaml") if path.stem not in SLOW)
    parser.add_argument("plans", nargs="*", default=names, help="names of requests, or result folders")
    parser.add_argument("--period", type=int, default=4, help="of the pose control [ms]")
    parser.add_argument("--noise", type=float, default=1.0, help="of the sensors; 1 is usual")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--between", type=float, nargs=2, default=(0.0, float("inf")), metavar="S", help="a part of each plan [s]"
    )
    given = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, folder in list_folders(given.plans, Path(scratch)):
            began = time.process_time()
            report = carry_out(folder, given.period, given.noise, given.seed, tuple(given.between))
            print(f"{name}: {report.verdict} {report.reason}", flush=True)
            first = f"{report.faults[0].name} {report.faults[0].where}" if report.faults else "-"
            rows.append(
                (name, report.verdict, f"{report.plan_s:.1f}", f"{report.run_s:.1f}", str(len(report.faults)), first,
                 f"{time.process_time() - began:.0f}"),
            )  # fmt: skip
    print_table("Plans in which nothing is wrong", HEADER, rows)


if __name__ == "__main__":
    main()
