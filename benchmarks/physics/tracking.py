"""Computing time of online pose control on Atlas, and soft landings.

``python -m benchmarks.physics.tracking [--seconds S]``.

The programs are those of a run in which Atlas goes from posture to posture at its planned speed while hand and foot
are displaced; ``hard`` ones have half of the speed limits, so that many are active.  Processor time is that of the one
thread that computes; the clock on the wall shows what else the machine does.  Landings need MuJoCo.
"""

from __future__ import annotations

import argparse
import importlib.util
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import piqp

from benchmarks.tables import print_table
from costs.robot import RobotModel, load_robot
from service.execution.box_qp import solve_box_qp
from service.execution.execution import Execution
from service.execution.gains import PRESETS
from service.execution.pose_control import Command, PoseController
from service.execution.reference import PlannedReference
from service.execution.settings import ExecutionSettings
from service.execution.shift import Shift, ShiftLimits, step_shift
from service.execution.tracking import KinematicRobot
from service.planner import plan
from service.request.file import load_request
from service.result.output import write_result

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
PERIOD_S = 1e-3
P50_TARGET_MS, P99_TARGET_MS = 0.4, 1.0
SWING_S = 1.5  # from one posture to the other
Program = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def main(seconds: float) -> int:
    """Print the tables; return 1 if the pose control misses a target."""
    robot = load_robot("atlas")
    rows = []
    for name, scale in (("usual", 1.0), ("hard", 0.05)):
        slow = replace(robot, velocity=scale * robot.velocity)
        programs = [program for program, _ in run_control(slow, seconds, PRESETS["follow"].feed_forward)]
        bound = np.mean([int((solve_box_qp(*program).is_bound).sum()) for program in programs])
        for solver, solve in (("Cholesky, PIQP if bound", solve_own), ("PIQP", solve_piqp())):
            rows.append((f"{name}, {bound:.1f} at a bound", solver, *measure(solve, programs)))
    print_table("Quadratic program of 36 variables [ms]", ("programs", "solver", *TIMES), rows)
    control = measure_control(robot, seconds)
    whole = measure_execution()
    shown = [("pose control (kinematics and program)", *control), *whole]
    print_table("Control cycle on Atlas [ms]", ("part", *TIMES), shown)
    if importlib.util.find_spec("mujoco"):
        print_table("A foot lands on other ground than planned", LANDINGS, list(compare_landings()))
    else:
        print("landings: MuJoCo is not installed")
    return int(float(control[0]) > P50_TARGET_MS or float(control[1]) > P99_TARGET_MS)


TIMES = ("CPU p50", "CPU p99", "wall p50", "wall p99", "cycles")
LANDINGS = ("ground", "landing", "peak force [N]", "tilt after 0.3 s [deg]", "stands")


def run_control(robot: RobotModel, seconds: float, feed: float) -> Iterator[tuple[Program, tuple[float, float]]]:
    """Yield the program of every cycle of a run, and the processor and wall time of the pose control [s]."""
    controller = PoseController(robot, replace(PRESETS["follow"], feed_forward=feed), PERIOD_S)
    start, end = robot.postures["stand"], robot.postures["reach_ready"]
    command, shifts = Command.at_rest(start), {"r_hand": Shift.zero(), "l_foot": Shift.zero()}
    for k in range(round(seconds / PERIOD_S)):
        t = k * PERIOD_S
        u = 0.5 - 0.5 * np.cos(np.pi * t / SWING_S)
        rate = 0.5 * np.pi / SWING_S * np.sin(np.pi * t / SWING_S)
        if k % 1000 == 500:
            sign = 1.0 if k % 2000 == 500 else -1.0
            shifts["r_hand"] = shifts["r_hand"].towards(sign * np.array([0.04, 0.0, 0.03]))
            shifts["l_foot"] = shifts["l_foot"].towards(sign * np.array([0.0, 0.01, 0.0]))
        shifts = {link: step_shift(shift, ShiftLimits(), PERIOD_S) for link, shift in shifts.items()}
        desired, speed = start + u * (end - start), rate * (end - start)
        program = controller.make_program(command, desired, speed, shifts)
        cpu, wall = time.thread_time(), time.perf_counter()
        command = controller.step(command, desired, speed, shifts)
        yield program, (time.thread_time() - cpu, time.perf_counter() - wall)


def solve_own(program: Program) -> None:
    """Solve as the pose control does."""
    solve_box_qp(*program)


def solve_piqp() -> Callable[[Program], None]:
    """Return a function that solves with PIQP, set up once."""
    solver = piqp.DenseSolver()
    n = 36
    solver.setup(np.eye(n), np.zeros(n), x_l=-np.ones(n), x_u=np.ones(n))

    def solve(program: Program) -> None:
        P, c, lower, upper = program
        solver.update(P=P, c=c, x_l=lower, x_u=upper)
        solver.solve()

    return solve


def measure(solve: Callable[[Program], None], programs: Sequence[Program]) -> tuple[str, ...]:
    """Return the times of one solver."""
    cpu, wall = [], []
    for program in programs:
        began, clock = time.thread_time(), time.perf_counter()
        solve(program)
        cpu.append(time.thread_time() - began)
        wall.append(time.perf_counter() - clock)
    return summarize(cpu, wall)


def summarize(cpu: Sequence[float], wall: Sequence[float]) -> tuple[str, ...]:
    """Return percentiles as text [ms]."""
    figures = (1e3 * np.percentile(times, share) for times in (cpu, wall) for share in (50, 99))
    return (*(f"{value:.3f}" for value in figures), str(len(cpu)))


def measure_control(robot: RobotModel, seconds: float) -> tuple[str, ...]:
    """Return the times of the pose control: kinematics, tasks and program."""
    times = [both for _, both in run_control(robot, seconds, 1.0)]
    return summarize([cpu for cpu, _ in times], [wall for _, wall in times])


def measure_execution() -> list[tuple[str, ...]]:
    """Return the times of whole cycles of an execution, driver aside, with and without force sensors."""
    result = plan(load_request(REQUESTS / "pose_goal.yaml"))
    if result.motion is None:
        raise RuntimeError(f"pose_goal is {result.verdict.value}")
    reference, rows = PlannedReference(result.motion), []
    weight = {foot: np.array([0.0, 0.0, 777.0, 0.0, 0.0, 0.0]) for foot in ("l_foot", "r_foot")}
    for name, wrenches in (("cycle without force sensors", {}), ("cycle with estimator, guards, touchdown", weight)):
        cpu: list[float] = []
        wall: list[float] = []
        while len(wall) < 4000:
            driver = KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD_S)
            driver.foot_wrenches = wrenches
            execution = Execution(reference, driver)
            while not execution.state.is_over:
                began, clock = time.thread_time(), time.perf_counter()
                execution.step()
                cpu.append(time.thread_time() - began)
                wall.append(time.perf_counter() - clock)
        rows.append((name, *summarize(cpu, wall)))
    return rows


def compare_landings() -> Iterator[tuple[str, ...]]:
    """Yield peak force and tilt of the first landing on the stones of ``steps.yaml``, stiff and soft."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "steps"
        write_result(plan(load_request(REQUESTS / "steps.yaml")), folder)
        reference = PlannedReference.read(folder)
    for ground, rise, slope in (
        ("as planned", 0.0, 0.0),
        ("1 cm higher", 0.01, 0.0),
        ("1 cm lower", -0.01, 0.0),
        ("3.4 deg up ahead", 0.0, 0.06),
        ("3.4 deg down ahead", 0.0, -0.06),
    ):
        for name, settings in (("stiff", ExecutionSettings(touchdown=None)), ("soft", ExecutionSettings())):
            yield (ground, name, *land(reference, rise, slope, settings))


def land(reference: PlannedReference, rise: float, slope: float, settings: ExecutionSettings) -> tuple[str, ...]:
    """Return peak force, tilt and whether the robot stands, of a landing on a stone that is moved or sloped.

    The peak is that until 0.3 s after the planned or the first touch, whichever is later; the tilt is that at its end.
    """
    import pinocchio as pin

    from service.demands.resistance import MechanismPhysics
    from service.simulation.model import build_physics
    from service.simulation.options import SimulationOptions
    from service.simulation.robot import SimulatedRobot

    landing = next(k for k, phase in enumerate(reference.phases) if phase.name.endswith("land"))
    contact = next(c for c in reference.phases[landing + 1].contacts if c.link == "r_foot")
    middle, pieces = contact.points.mean(axis=0), []
    for piece in reference.motion.scene.pieces:
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        if np.all(low[:2] < middle[:2]) and np.all(middle[:2] < high[:2]) and abs(high[2] - middle[2]) < 0.02:
            moved = piece.vertices + np.array([0.0, 0.0, rise])
            moved[:, 2] += slope * (moved[:, 0] - middle[0])
            piece = replace(piece, vertices=moved)
        pieces.append(piece)
    motion = replace(reference.motion, scene=replace(reference.motion.scene, pieces=tuple(pieces)))
    options, begin = SimulationOptions(), reference.phases[landing].begin_s - 0.4
    model = build_physics(motion, MechanismPhysics({}), options)
    robot = SimulatedRobot(model, reference.at(begin).configuration, options)
    execution = Execution(reference, robot, settings, begin)
    frame, data = reference.robot.model.getFrameId("r_foot"), reference.robot.model.createData()
    up = np.array([-slope, 0.0, 1.0]) / np.hypot(1.0, slope)
    forces, tilts, touch_at = [], [], 0
    for k in range(2000):
        cycle = execution.step()
        touch_at = k if cycle.state.time_s < reference.phases[landing].end_s else touch_at
        forces.append(float(robot.measure_contact_wrenches()["r_foot"][2]))
        pin.framesForwardKinematics(reference.robot.model, data, robot.configuration())
        tilts.append(float(np.rad2deg(np.arccos(np.clip(data.oMf[frame].rotation[:, 2] @ up, -1.0, 1.0)))))
    touched = np.flatnonzero(np.array(forces) > 5.0)
    if not len(touched):
        return "none", "", f"no: {execution.state.mode.value}"
    first = int(touched[0])
    last = max(first, touch_at) + 300
    stands = "yes" if execution.state.mode.value == "running" else f"no: {execution.state.mode.value}"
    return f"{max(forces[first:last]):.0f}", f"{tilts[last]:.1f}", stands


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="of the run whose programs are solved")
    raise SystemExit(main(parser.parse_args().seconds))
