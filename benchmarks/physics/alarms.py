"""Plans carried out in physics in which nothing is wrong: what do the guards of the execution find all the same?

``python -m benchmarks.physics.alarms [NAME|FOLDER ...] [--period MS] [--noise K] [--seed S]``.

Names are files of ``examples/requests``, by default all but the slow one.  Each plan is carried out from its beginning
to its end with pose control, noise of the sensors and the work it moves.  A false alarm is whatever a guard does to
the run: goes slowly, holds, goes back or ends.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.physics.perturbed import list_folders
from benchmarks.physics.plans import REQUESTS, SLOW
from benchmarks.tables import print_table
from service.execution.execution import Cycle, Execution
from service.execution.reference import PlannedReference
from service.execution.settings import ExecutionSettings
from service.execution.tracking import TrackReport, track
from service.execution.watch.servos import ServoModel
from service.execution.watch.watch import WatchSettings
from service.simulation.options import SimulationOptions
from service.simulation.stand import read_recorded_request, stand_in_physics
from service.start.robot import resolve_stiffness

HEADER = ("plan", "verdict", "plan [s]", "run [s]", "alarms", "first alarm", "CPU [s]")


def carry_out(folder: Path, period_ms: int, noise: float, seed: int) -> TrackReport:
    """Carry out the plan of a result folder in physics as it was planned."""
    reference, request = PlannedReference.read(folder), read_recorded_request(folder)
    options = SimulationOptions(noise=noise, seed=seed, hand_friction=request.options.hand_friction[0])
    robot = stand_in_physics(reference, request, options, period_ms)
    law = ServoModel(stiffness=resolve_stiffness(reference.robot, request))
    execution = Execution(reference, robot, ExecutionSettings(watch=WatchSettings(servos=law)))

    def hold(cycle: Cycle) -> None:
        robot.hold_grips(reference.find_phase_number(cycle.state.time_s))

    return track(execution, on_cycle=hold)


def main(arguments: Sequence[str] | None = None) -> None:
    """Plan, carry out and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.alarms", description=__doc__.splitlines()[0])
    names = sorted(path.stem for path in REQUESTS.glob("*.yaml") if path.stem not in SLOW)
    parser.add_argument("plans", nargs="*", default=names, help="names of requests, or result folders")
    parser.add_argument("--period", type=int, default=4, help="of the pose control [ms]")
    parser.add_argument("--noise", type=float, default=1.0, help="of the sensors; 1 is usual")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, folder in list_folders(given.plans, Path(scratch)):
            began = time.process_time()
            report = carry_out(folder, given.period, given.noise, given.seed)
            for fault in report.faults:
                print(f"{name} {fault.at_s:.2f} s: {fault.reaction}: {fault.name} {fault.where}: {fault.sentence}")
            print(f"{name}: {report.verdict} {report.reason}", flush=True)
            first = f"{report.faults[0].name} {report.faults[0].where}" if report.faults else "-"
            rows.append(
                (name, report.verdict, f"{report.plan_s:.1f}", f"{report.run_s:.1f}", str(len(report.faults)), first,
                 f"{time.process_time() - began:.0f}"),
            )  # fmt: skip
    print_table("Plans in which nothing is wrong", HEADER, rows)


if __name__ == "__main__":
    main()
