"""Certified plans in physics with random errors.

``python -m benchmarks.physics.perturbed [NAME|FOLDER ...] [--runs N] [--pace NAME]``.

Names are files of ``examples/requests``; folders hold results.  Each plan is carried out with surfaces up to 1 cm off
along each axis, masses up to 5 %, friction up to 0.1 and joints up to 10 mrad at the beginning, with sensor noise and
2 ms of delay: by position servos, and by online pose control with estimator, touchdown and yielding arms.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.tables import print_table
from service.execution.execution import Cycle, Execution
from service.execution.reference import PlannedReference
from service.execution.tracking import track
from service.planner import plan
from service.request.file import load_request
from service.request.paces import PACES
from service.result.output import write_result
from service.result.result import Verdict
from service.simulation.options import SimulationOptions
from service.simulation.report import make_report
from service.simulation.run import FALLEN_M, execute_folder
from service.simulation.stand import read_recorded_request, stand_in_physics

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
NAMES = ("steps", "stair", "chair", "egress_model")
HEADER = ("plan", "control", "stood", "to the end", "off its estimate [mm]")
SETTLE_S = 1.0


@dataclass(frozen=True)
class Run:
    """One execution with errors.

    Attributes:
        plan, control: which plan, and ``servos`` or ``tracking``.
        seed: of the errors.
        has_stood, has_ended: whether the robot stood, and whether it did the plan's work (tracked: came to its end).
        cause: of a fall or an abort.
        pelvis_m: largest error of the estimated pelvis; 0 for servos.
        cpu_s: processor time.
    """

    plan: str
    control: str
    seed: int
    has_stood: bool
    has_ended: bool
    cause: str
    pelvis_m: float
    cpu_s: float


def run_servos(name: str, folder: Path, options: SimulationOptions) -> Run:
    """Carry out a plan by servos alone."""
    began = time.process_time()
    made, _ = make_report(execute_folder(folder, options))
    cause = next(iter(made["explanation"]), "")
    stood, done = made["verdict"] != "FELL", made["verdict"] == "DONE"
    return Run(name, "servos", options.seed, stood, done, cause, 0.0, time.process_time() - began)


def run_tracking(name: str, folder: Path, reference: PlannedReference, options: SimulationOptions, steps: int) -> Run:
    """Carry out a plan by online pose control; a robot that aborts and stands has stood."""
    began = time.process_time()
    robot = stand_in_physics(reference, read_recorded_request(folder), options, steps)
    execution = Execution(reference, robot)
    worst, count, down = 0.0, 0, False

    def look(cycle: Cycle) -> None:
        nonlocal worst, count, down
        count += 1
        if count % 10:
            return
        robot.hold_grips(execution.reference.find_phase_number(cycle.state.time_s))
        true = robot.pose_world_base
        down = down or true[2, 3] < cycle.wanted.pose_world_base[2, 3] - FALLEN_M
        if cycle.estimate is not None:
            worst = max(worst, float(((cycle.estimate.position - true[:3, 3]) ** 2).sum() ** 0.5))

    report = track(execution, on_cycle=look, settle_s=SETTLE_S)
    stood = report.verdict != "FELL" and not down
    phase = report.changes[-1].phase
    cause = "" if report.verdict == "TRACKED" and stood else f"{report.verdict} in '{phase}': {report.reason}"
    ended = stood and report.verdict == "TRACKED"
    return Run(name, "tracking", options.seed, stood, ended, cause, worst, time.process_time() - began)


def list_folders(names: list[str], scratch: Path, pace: str | None = None) -> Iterator[tuple[str, Path]]:
    """Yield name and result folder of every plan, planned now at a pace where a name is given."""
    for name in names:
        if (Path(name) / "result.json").is_file():
            yield Path(name).name, Path(name)
            continue
        request = load_request(REQUESTS / f"{name}.yaml")
        made = plan(replace(request, options=replace(request.options, pace=pace)))
        if made.verdict is not Verdict.CERTIFIED:
            print(f"{name}: {made.verdict.value}", flush=True)
            continue
        write_result(made, scratch / name)
        yield name, scratch / name


def main() -> None:
    """Plan, carry out and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.perturbed", description=__doc__.splitlines()[0])
    parser.add_argument("plans", nargs="*", default=list(NAMES), help="names of requests, or result folders")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--size", type=float, default=1.0, help="of the errors and the noise")
    parser.add_argument("--period", type=int, default=1, help="of the pose control [ms]")
    parser.add_argument("--pace", choices=tuple(PACES), help="of the plans that are made now")
    parser.add_argument("--only", choices=("servos", "tracking"))
    parser.add_argument("--out", type=Path, help="file for all runs as JSON")
    given = parser.parse_args()
    runs: list[Run] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, folder in list_folders(given.plans, Path(scratch), given.pace):
            reference = PlannedReference.read(folder)
            for seed in range(given.seed, given.seed + given.runs):
                options = SimulationOptions(perturb=given.size, noise=given.size, delay_ms=2.0, seed=seed)
                for control in ("servos", "tracking") if given.only is None else (given.only,):
                    if control == "servos":
                        runs.append(run_servos(name, folder, options))
                    else:
                        runs.append(run_tracking(name, folder, reference, options, given.period))
                    run = runs[-1]
                    words = "stood" if run.has_stood else "fell"
                    print(f"{name} {control} {seed}: {words} {run.cause} ({run.cpu_s:.0f} s)", flush=True)
    rows = []
    for name, control in dict.fromkeys((run.plan, run.control) for run in runs):
        own = [run for run in runs if (run.plan, run.control) == (name, control)]
        stood, ended = (sum(getattr(run, key) for run in own) for key in ("has_stood", "has_ended"))
        off = f"{1e3 * max(run.pelvis_m for run in own):.0f}" if control == "tracking" else ""
        rows.append((name, control, f"{stood}/{len(own)}", f"{ended}/{len(own)}", off))
    print_table(f"Plans in physics with errors of size {given.size:g}", HEADER, rows)
    if given.out is not None:
        given.out.write_text(json.dumps([asdict(run) for run in runs], indent=1))


if __name__ == "__main__":
    main()
