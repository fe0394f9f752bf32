"""Plans in physics with a fault at a moment: does the robot stand after the reaction, and was the fault named?

``python -m benchmarks.physics.faults [NAME|FOLDER ...] [--moments N | --at S ... | --draw N --seed S] [--only TEXT]
[--period MS] [--out FILE]``.

Names are files of ``examples/requests``.  Each fault of ``fault_kinds`` begins at N moments of each plan (``--draw``: N
faults of each plan, each at a moment, both drawn), and the robot is watched for three more seconds.  An outcome is safe
if the robot stands and no link presses harder than its cap, filtered; a fault is named if a finding of the guards has
one of its names.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.physics.fault_kinds import FAULTS, FLOOR_M, Fault, FaultyRobot
from benchmarks.physics.perturbed import list_folders
from benchmarks.tables import print_table
from service.demands.kind import read_mechanism_physics
from service.errors import ServiceError
from service.execution.execution import Cycle, Execution
from service.execution.guards import GuardSettings, Severity
from service.execution.reference import PlannedReference
from service.execution.sensing.filters import find_share, low_pass
from service.execution.settings import ExecutionSettings
from service.execution.watch.servos import ServoModel
from service.execution.watch.watch import WatchSettings
from service.request.schema import PlanRequest
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.simulation.run import has_fallen
from service.simulation.stand import read_recorded_request
from service.start.robot import resolve_stiffness
from service.verify import Motion

NAMES = ("pose_goal", "valve", "door", "stair", "steps", "chair")
BEFORE_S, AFTER_S = 0.8, 3.0  # of the plan before a fault, and of the time after it
CUTOFF_HZ = 5.0  # of the forces that are compared with caps
HEADER = ("fault", "runs", "safe", "named", "falls", "above a cap", "reaction after [s]")


@dataclass(frozen=True)
class Run:
    """One plan with one fault.

    Attributes:
        plan, fault: names.
        at_s: moment on the plan's clock [s].
        fell, exceeded: whether the robot fell, and what pressed harder than its cap.
        verdict, reason: of the execution.
        names: of the findings since the fault, in their order.
        is_named: whether one of them is a name of the fault.
        after_s: from the fault to the first reaction [s]; None without one.
        cpu_s: processor time.
    """

    plan: str
    fault: str
    at_s: float
    fell: bool
    exceeded: str
    verdict: str
    reason: str
    names: tuple[str, ...]
    is_named: bool
    after_s: float | None
    cpu_s: float

    @property
    def is_safe(self) -> bool:
        """Whether the robot stands and no force was above its cap."""
        return not self.fell and not self.exceeded


class Stage:
    """A plan in physics, from any of its moments on."""

    def __init__(self, name: str, folder: Path, period_ms: int) -> None:
        self.name, self.period_ms = name, period_ms
        self.reference = PlannedReference.read(folder)
        self.request: PlanRequest = read_recorded_request(folder)
        self.stiffness = resolve_stiffness(self.reference.robot, self.request)
        joints = self.reference.joint_names
        tools = [load.tool for phase in self.reference.phases for load in phase.loads]
        side = "r" if any(tool.startswith("r") for tool in tools) else "l"
        self.arm, self.leg = self._find(joints, (f"{side}_arm_elx", "arm")), self._find(joints, ("l_leg_kny", "leg"))

    def list_moments(self, fault: Fault, shares: Iterable[float]) -> list[float]:
        """Return the moments at shares of the time in which a fault can be noticed [s].

        What happens to an object is noticed while hands press on it.
        """
        phases = [phase for phase in self.reference.phases if phase.loads or not fault.name.startswith("object")]
        ends = np.cumsum([phase.end_s - phase.begin_s for phase in phases])
        moments = []
        for wanted in (share * float(ends[-1]) for share in shares):
            k = min(int(np.searchsorted(ends, wanted)), len(phases) - 1)
            moments.append(phases[k].end_s - (float(ends[k]) - wanted))
        return moments

    def draw(self, faults: Sequence[Fault], count: int, seed: int) -> list[tuple[Fault, float]]:
        """Return faults, each once before one comes again, and a moment of the plan for each [s]."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        order = [int(k) for _ in range(-(-count // len(faults))) for k in rng.permutation(len(faults))]
        return [(faults[k], self.list_moments(faults[k], [rng.uniform(0.02, 0.98)])[0]) for k in order[:count]]

    def list_faults(self, text: str) -> Iterator[Fault]:
        """Yield the faults that this plan can have."""
        has_object = bool(self.reference.mechanism_names) and any(phase.loads for phase in self.reference.phases)
        lands = len({c.link for c in self.reference.phases[0].contacts}) < len(
            {c.link + str(c.points.round(2).tolist()) for phase in self.reference.phases for c in phase.contacts}
        )
        for fault in FAULTS:
            is_left_out = (fault.name.startswith("object") and not has_object) or (
                fault.name.startswith("ground") and not lands
            )
            if text in fault.name and not is_left_out:
                yield fault

    def run(self, fault: Fault, moment: float) -> Run:
        """Carry out the plan around a moment at which a fault begins."""
        began, reference = time.process_time(), self.reference
        begin = self._find_begin(moment)
        options = SimulationOptions(noise=1.0, hand_friction=self.request.options.hand_friction[0])
        motion = self._lower(moment) if fault.name.startswith("ground") else reference.motion
        model = build_physics(motion, read_mechanism_physics(self.request), options, self.stiffness)
        robot = SimulatedRobot(model, reference.at(begin).configuration, options, self.period_ms)
        faulty = FaultyRobot(robot, fault, np.inf, self.arm, self.leg)
        law = ServoModel(stiffness=self.stiffness)
        execution = Execution(reference, faulty, ExecutionSettings(watch=WatchSettings(servos=law)), begin)
        caps = _Caps(reference, robot)
        names: dict[str, None] = {}
        after: float | None = None
        fell, down_m = False, FLOOR_M if fault.name.startswith("ground") else 0.0
        while faulty.since_s < AFTER_S:
            if np.isinf(faulty.at_s) and execution.state.time_s >= moment - 1e-9:
                faulty.at_s = robot.time_s + robot.period_s
            if np.isinf(faulty.at_s) and execution.state.is_over:
                caps.exceeded = "ended before the fault"
                break
            cycle = execution.step()
            robot.hold_grips(reference.find_phase_number(cycle.state.time_s))
            if execution.is_lost:
                robot.command(cycle.sent)  # servos go on with the last command
            if faulty.since_s >= 0.0:
                names |= {finding.name: None for finding in cycle.findings}
                is_reaction = any(f.severity not in (Severity.NOTE, Severity.WAIT) for f in cycle.findings)
                after = faulty.since_s if after is None and is_reaction else after
                caps.look(cycle)
            fell = fell or has_fallen(robot.pose_world_base + _shift(down_m), cycle.wanted)
        state = execution.state
        is_named = not fault.names or bool(fault.names & set(names))
        return Run(
            self.name, fault.name, moment, fell, caps.exceeded, state.mode.value, state.reason, tuple(names), is_named,
            after, time.process_time() - began,
        )  # fmt: skip

    def _find_begin(self, moment: float) -> float:
        """Return when to begin for a fault at a moment [s]: at rest, before hands press on anything.

        A robot that is put into a push has not settled on its servos, and its arms seem to press with 50 N.
        """
        phases, begin = self.reference.phases, max(moment - BEFORE_S, 0.0)
        k = first = self.reference.find_phase_number(begin)
        while k > 0 and phases[k].loads:
            k -= 1
        return begin if k == first else max(phases[k].end_s - BEFORE_S, phases[k].begin_s)

    def _lower(self, moment: float) -> Motion:
        """Return the motion with all surfaces lower that are touched for the first time after a moment."""
        phases, scene = self.reference.phases, self.reference.motion.scene
        k = self.reference.find_phase_number(moment)
        before = np.vstack([c.points for phase in phases[: k + 1] for c in phase.contacts] or [np.zeros((0, 3))])
        after = np.vstack([c.points for phase in phases[k + 1 :] for c in phase.contacts] or [np.zeros((0, 3))])
        pieces = []
        for piece in scene.pieces:
            is_later = _touches(piece.vertices, after) and not _touches(piece.vertices, before)
            down = np.array([0.0, 0.0, -FLOOR_M if is_later else 0.0])
            pieces.append(replace(piece, vertices=piece.vertices + down))
        return replace(self.reference.motion, scene=replace(scene, pieces=tuple(pieces)))

    def _find(self, joints: Sequence[str], parts: Sequence[str]) -> int:
        return next((k for part in parts for k, name in enumerate(joints) if part in name), 0)


class _Caps:
    """Forces of hands and feet against their caps, filtered."""

    def __init__(self, reference: PlannedReference, robot: SimulatedRobot) -> None:
        self.exceeded = ""
        self._reference, self._robot = reference, robot
        self._share = find_share(CUTOFF_HZ, robot.period_s)
        self._forces: dict[str, np.ndarray] = {}
        self._limits = GuardSettings()

    def look(self, cycle: Cycle) -> None:
        """Take one cycle."""
        robot, reference = self._robot, self._reference
        moved = robot.model.motion.mechanism_links
        sums: dict[str, np.ndarray] = {}
        for _, other, force in robot.list_pair_forces():
            if other in moved:
                sums["hand"] = sums.get("hand", np.zeros(3)) + force
        for _, _, force in robot.list_grip_forces():
            sums["hand"] = sums.get("hand", np.zeros(3)) + force
        for foot, wrench in robot.measure_contact_wrenches().items():
            sums[foot] = wrench[:3]
        phase = reference.find_phase(cycle.state.time_s)
        caps = {contact.link: 1.5 * contact.force_cap_n * len(contact.sole) for contact in phase.contacts}
        caps["hand"] = max((load.cap_n for load in phase.loads), default=np.inf)
        for name in {*sums, *self._forces}:
            force = sums.get(name, np.zeros(3))
            self._forces[name] = low_pass(self._forces.get(name, np.zeros(3)), force, self._share)
            size = float(np.linalg.norm(self._forces[name]))
            if not self.exceeded and size > caps.get(name, np.inf):
                self.exceeded = f"{name} {size:.0f} N of {caps[name]:.0f} N in '{phase.name}'"


def _shift(z: float) -> np.ndarray:
    pose = np.zeros((4, 4))
    pose[2, 3] = z
    return pose


def _touches(vertices: np.ndarray, points: np.ndarray) -> bool:
    low, high = vertices.min(axis=0) - 0.02, vertices.max(axis=0) + 0.02
    return bool(((points >= low) & (points <= high)).all(axis=1).any())


def summarize(fault: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return one row of the table."""
    times = sorted(run.after_s for run in runs if run.after_s is not None)
    return (
        fault,
        str(len(runs)),
        f"{sum(run.is_safe for run in runs)}",
        f"{sum(run.is_named for run in runs)}",
        f"{sum(run.fell for run in runs)}",
        f"{sum(bool(run.exceeded) for run in runs)}",
        f"{times[len(times) // 2]:.2f} in {len(times)}" if times else "-",
    )


def main() -> None:
    """Plan, put faults in, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.faults", description=__doc__.splitlines()[0])
    parser.add_argument("plans", nargs="*", default=list(NAMES), help="names of requests, or result folders")
    parser.add_argument("--moments", type=int, default=3)
    parser.add_argument("--at", type=float, nargs="+", help="these moments of each plan instead [s]", metavar="S")
    parser.add_argument("--draw", type=int, help="as many faults of each plan instead, each at a moment", metavar="N")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--period", type=int, default=4, help="of the pose control [ms]")
    parser.add_argument("--out", type=Path, help="file for all runs as JSON")
    given = parser.parse_args()
    runs: list[Run] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, folder in list_folders(given.plans, Path(scratch)):
            stage = Stage(name, folder, given.period)
            faults = list(stage.list_faults(given.only))
            if given.draw is None:
                shares = [(k + 1.0) / (given.moments + 1.0) for k in range(given.moments)]
                pairs = [(one, moment) for one in faults for moment in given.at or stage.list_moments(one, shares)]
            else:
                pairs = stage.draw(faults, given.draw, given.seed)
            for fault, moment in pairs:
                try:
                    runs.append(stage.run(fault, moment))
                except ServiceError as error:
                    print(f"{name} {fault.name} {moment:.2f}: {error}")
                    raise
                run = runs[-1]
                words = "safe" if run.is_safe else f"UNSAFE {'fell' if run.fell else run.exceeded}"
                named = "" if run.is_named else "unnamed "
                shown = f"{run.verdict} {run.reason} {list(run.names)}"
                print(f"{name} {fault.name} {moment:.1f} s: {words} {named}{shown} ({run.cpu_s:.1f} s)", flush=True)
    kinds: Mapping[str, list[Run]] = {fault.name: [r for r in runs if r.fault == fault.name] for fault in FAULTS}
    rows = [summarize(name, own) for name, own in kinds.items() if own]
    print_table("Faults in physics", HEADER, [*rows, summarize("all", runs)])
    if given.out is not None:
        given.out.write_text(json.dumps([asdict(run) for run in runs], indent=1))


if __name__ == "__main__":
    main()
