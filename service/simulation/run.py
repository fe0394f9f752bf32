"""A recorded plan carried out in physics, open loop, and what was seen meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from service.demands.kind import read_mechanism_physics
from service.execution.driver import JointCommand
from service.execution.reference import PlannedReference, ReferenceState
from service.execution.servo_reference import lead_servos
from service.replay.replay import read_motion, read_request
from service.request.schema import PlanRequest
from service.result.folder import read_result, result_path
from service.simulation.model import PhysicsModel, build_physics, import_mujoco
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.simulation.seen import Seen
from service.simulation.verdict import REST_S, find_unrest
from service.start.robot import resolve_stiffness
from service.verify import Motion

SAMPLE_STEPS = 20  # steps of the physics between two records
FALLEN_M = 0.25  # of the base below its planned height [m]
FALLEN_TILT = float(np.deg2rad(30.0))  # of the base against its planned pose
SHOWN_AFTER_FALL_S = 0.5  # that the simulation goes on, for those who look at it
MOST_AFTER_S = 10.0  # after the plan, in which a robot comes to rest or falls
_Samples = dict[tuple[str, str], dict[int, np.ndarray]]  # by pair, values by number of the sample


@dataclass(frozen=True)
class Record(Seen):
    """What was seen at ``S`` times of a simulation; times before the plan begins are negative.

    Attributes:
        torque_share: (S, k) servo torques relative to the effort limits.
        planned_wrenches, wrenches: by planted link (S, 6), planned and true [N, N m].
        mechanism_force: by robot frame and mechanism link (S, 3) force on the mechanism, world axes [N]; a closed
            gripper is named by its tool.
        touches: by (robot link, piece or robot link) (S,) size of the force between them [N].
        computing_s: processor time of the physics and its commands.
    """

    torque_share: Float[np.ndarray, "S k"]
    planned_wrenches: dict[str, Float[np.ndarray, "S 6"]]
    wrenches: dict[str, Float[np.ndarray, "S 6"]]
    mechanism_force: dict[tuple[str, str], Float[np.ndarray, "S 3"]]
    touches: dict[tuple[str, str], Float[np.ndarray, "S"]]
    computing_s: float


@dataclass(frozen=True)
class SimulatedRun:
    """A plan and its record.

    Attributes:
        reference: the plan as functions of time.
        model: the physics.
        options: of the simulation.
        record: what was seen.
        verdict, request_hash: of the plan.
    """

    reference: PlannedReference
    model: PhysicsModel
    options: SimulationOptions
    record: Record
    verdict: str
    request_hash: str


def execute_folder(
    path: str | Path,
    options: SimulationOptions | None = None,
    report: Callable[[str, float | None], None] | None = None,
) -> tuple[SimulatedRun, ...]:
    """Carry out the plan of a result folder in physics, once per end of the request's friction of the hands.

    The folder is read like ``scopt verify`` reads it; its robot files must be inside it. A friction of the options
    replaces the request's interval; a plan without a mechanism is carried out once.

    Raises:
        ResultError: one line: the folder cannot be used, the plan has no time law, the robot lacks masses or efforts,
            or MuJoCo is not installed.
    """
    import_mujoco()
    data = read_result(path)
    folder = result_path(path).parent
    motion = read_motion(data, folder)
    request = read_request(data, folder)
    return execute_motion(motion, request, str(data["verdict"]), str(data["request_hash"]), options, report)


def execute_motion(
    motion: Motion,
    request: PlanRequest,
    verdict: str,
    request_hash: str,
    options: SimulationOptions | None = None,
    report: Callable[[str, float | None], None] | None = None,
) -> tuple[SimulatedRun, ...]:
    """Carry out a motion in physics, with the mechanism and the servos of a request (as above)."""
    options = options or SimulationOptions()
    reference = PlannedReference(motion)
    stiffness = resolve_stiffness(motion.robot, request)
    executions = []
    for friction in list_hand_frictions(motion, request, options):
        chosen = replace(options, hand_friction=friction)
        model = build_physics(motion, read_mechanism_physics(request), chosen, stiffness)
        record = execute(reference, SimulatedRobot(model, reference.at(0.0).configuration, chosen), report)
        executions.append(SimulatedRun(reference, model, chosen, record, verdict, request_hash))
    return tuple(executions)


def list_hand_frictions(motion: Motion, request: PlanRequest, options: SimulationOptions) -> tuple[float, ...]:
    """Return the coefficients between hands and mechanism with which a motion is carried out, the least first."""
    if options.hand_friction is not None:
        return (options.hand_friction,)
    low, high = request.options.hand_friction
    return (low, high) if motion.mechanism_links and high > low else (low,)


def execute(
    reference: PlannedReference,
    robot: SimulatedRobot,
    report: Callable[[str, float | None], None] | None = None,
    look: Callable[[float, SimulatedRobot], None] | None = None,
) -> Record:
    """Let a simulated robot stand on the first pose, follow the plan, and stand on the last pose until it is at rest.

    Args:
        reference: the plan.
        robot: at its start.
        report: called with a step and the share that is done.
        look: called with the plan's time and the robot at every sample.
    """
    watch = _Sampler(reference, robot)
    options, step = robot.options, robot.period_s
    longest = max(options.after_s, MOST_AFTER_S)
    n_settle, n_plan, n_after = (round(s / step) for s in (options.settle_s, reference.duration_s, longest))
    n_least = n_plan + round(options.after_s / step)
    started = time.process_time()
    steps = np.arange(-n_settle, n_plan + n_after + 1)
    q, qd, tau = reference.tabulate_commands(steps * step)
    nominal = robot.model.stiffness / options.stiffness_scale  # what the plan knows of the servos
    q, qd = lead_servos(q, qd, tau, nominal, step, options.feed_forward)
    qd[(steps < 0) | (steps > n_plan)] = 0.0
    for i, k in enumerate(steps.tolist()):
        if i % SAMPLE_STEPS == 0:
            poll()
            watch.look(k * step, reference.at(k * step))
            robot.hold_grips(reference.find_phase_number(k * step))
            if look is not None:
                look(k * step, robot)
            if watch.fell_at_s is not None and k * step > watch.fell_at_s + SHOWN_AFTER_FALL_S:
                break
            if k >= n_least and watch.is_at_rest():
                break
            if report is not None and k % 500 == 0:
                report("simulate", i / len(steps))
        robot.command(JointCommand(q[i], qd[i], tau[i]))
    return watch.finish(time.process_time() - started)


def has_fallen(pose_world_base: Float[np.ndarray, "4 4"], wanted: ReferenceState) -> bool:
    """Return whether a floating base is far below its planned height, or tilted far from its planned pose."""
    if not wanted.is_floating:
        return False
    if not np.isfinite(pose_world_base).all():
        return True
    planned = wanted.pose_world_base
    tilt = np.arccos(np.clip(float(pose_world_base[:3, 2] @ planned[:3, 2]), -1.0, 1.0))
    return bool(pose_world_base[2, 3] < planned[2, 3] - FALLEN_M or tilt > FALLEN_TILT)


class _Sampler:
    """Samples of a simulation as it goes."""

    def __init__(self, reference: PlannedReference, robot: SimulatedRobot) -> None:
        self.reference, self.robot = reference, robot
        self.fell_at_s: float | None = None
        self._times: list[float] = []
        self._configuration: list[np.ndarray] = []
        self._planned: list[np.ndarray] = []
        self._latched: list[tuple[bool, ...]] = []
        self._shares: list[np.ndarray] = []
        self._wrenches: list[dict[str, np.ndarray]] = []
        self._planned_wrenches: list[dict[str, np.ndarray]] = []
        self._pairs: _Samples = {}
        self._moved: _Samples = {}
        self._objects: dict[str, list[np.ndarray]] = {name: [] for name in robot.model.objects}

    def look(self, time_s: float, state: ReferenceState) -> None:
        """Record one sample."""
        robot, k = self.robot, len(self._times)
        self._times.append(time_s)
        self._configuration.append(robot.configuration())
        self._planned.append(state.configuration)
        self._latched.append(robot.is_latched)
        for name, pose in robot.locate_objects().items():
            self._objects[name].append(pose)
        self._shares.append(robot.torque / robot.model.effort)
        self._wrenches.append(robot.measure_contact_wrenches())
        self._planned_wrenches.append(dict(state.contact_wrenches))
        sums: dict[tuple[str, str], np.ndarray] = {}
        for first, second, force in robot.list_pair_forces():
            sums[first, second] = sums.get((first, second), np.zeros(3)) + force
        for tool, link, force in robot.list_grip_forces():
            sums[tool, link] = force
        moved = robot.model.motion.mechanism_links
        for (link, other), force in sums.items():
            table = self._moved if other in moved else self._pairs
            table.setdefault((link, other), {})[k] = -force if other in moved else np.asarray(np.linalg.norm(force))
        if self.fell_at_s is None and has_fallen(robot.pose_world_base, state):
            self.fell_at_s = time_s

    def is_at_rest(self) -> bool:
        """Return whether robot and mechanism have been at rest for half a second."""
        n = sum(1 for _ in takewhile(lambda t: t >= self._times[-1] - REST_S - 1e-9, reversed(self._times)))
        return not find_unrest(self.reference, np.stack(self._configuration[-n:]))

    def finish(self, computing_s: float) -> Record:
        """Return the samples as arrays."""
        n = len(self._times)

        def spread(
            table: dict[tuple[str, str], dict[int, np.ndarray]], *width: int
        ) -> dict[tuple[str, str], np.ndarray]:
            arrays = {}
            for pair, values in table.items():
                arrays[pair] = np.zeros((n, *width))
                arrays[pair][list(values)] = list(values.values())
            return arrays

        links = list(self._wrenches[0])
        return Record(
            times=np.array(self._times),
            configuration=np.stack(self._configuration),
            planned=np.stack(self._planned),
            is_latched=np.array(self._latched, dtype=bool).reshape(n, -1),
            torque_share=np.stack(self._shares),
            planned_wrenches={link: np.stack([w[link] for w in self._planned_wrenches]) for link in links},
            wrenches={link: np.stack([w[link] for w in self._wrenches]) for link in links},
            mechanism_force=spread(self._moved, 3),
            touches=spread(self._pairs),
            computing_s=computing_s,
            fell_at_s=self.fell_at_s,
            objects={name: np.stack(poses) for name, poses in self._objects.items()},
        )
