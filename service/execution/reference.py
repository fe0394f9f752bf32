"""What a robot follows while it carries out a plan: joints, base, torques, contact forces and loads over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from costs.curve import TimeLaw
from costs.robot import BASE_NAMES, RobotModel
from service.errors import ResultError
from service.execution.ground_forces import carry_motion
from service.execution.hands.grip_forces import GripForces
from service.replay.replay import read_motion
from service.result.folder import read_result, result_path
from service.verify import (
    LoadLimits,
    Motion,
    Phase,
    PlantedContact,
    find_mechanism_joints,
    find_times,
    limit_loads,
    list_phases,
    split_motion,
)

TABLE_STEP_S = 2e-3  # of desired positions, which are read linearly between
FORCE_STEP_S = 0.02  # of torques and contact forces
RESTING_RATE = 1e-3  # of the curve's parameter at a rest, as a share of its largest
BLEND_S = 0.4  # before a contact leaves and after it came, during which its force goes and comes
LOAD_RAMP_S = 0.2  # in which the feed-forward of a load comes and goes


@dataclass(frozen=True)
class ReferencePhase:
    """A phase of a plan in time.

    Attributes:
        name: as in the plan.
        begin_s, end_s: its ends on the plan's clock.
        contacts: links planted throughout, with their poses and points.
        loads: forces of the hands on the mechanism, one entry per tool.
        rests: whether the robot rests at its end; otherwise it goes on through the border on the same contacts.
        retreat_s: the earliest rest that the robot can go back to with its contacts and all that it holds as they are,
            pressing on nothing: the plan's start, or the first rest since something of that changed [s]; None if there
            is none, since the pose of the change itself is still at what was touched.
    """

    name: str
    begin_s: float
    end_s: float
    contacts: tuple[PlantedContact, ...]
    loads: tuple[LoadLimits, ...]
    rests: bool = True
    retreat_s: float | None = None


@dataclass(frozen=True)
class ReferenceState:
    """What the plan wants at one instant.

    Attributes:
        time_s: on the plan's clock.
        q, qd, tau: (k,) positions, speeds and feed-forward torques of the actuated joints, in the order of
            ``PlannedReference.joint_names``.
        configuration, velocity: (n,) of the plan's model: base, joints, mechanism.
        contact_wrenches: per link that carries force in this phase or an adjacent one, the force and moment (6,) of the
            surroundings at the link's origin, world axes [N, N m].
        mechanism: (m,) values of the mechanism's joints.
        is_floating: whether the base is free.
    """

    time_s: float
    q: Float[np.ndarray, "k"]
    qd: Float[np.ndarray, "k"]
    tau: Float[np.ndarray, "k"]
    configuration: Float[np.ndarray, "n"]
    velocity: Float[np.ndarray, "n"]
    contact_wrenches: Mapping[str, Float[np.ndarray, "6"]]
    mechanism: Float[np.ndarray, "m"]
    is_floating: bool

    @property
    def pose_world_base(self) -> Float[np.ndarray, "4 4"]:
        """(4, 4) pose of the base link; the identity of a fixed base."""
        return place_base(self.configuration) if self.is_floating else np.eye(4)


class PlannedReference:
    """A certified motion as functions of time."""

    def __init__(self, motion: Motion) -> None:
        """Compute torques and contact forces of a motion at all its samples.

        Raises:
            ResultError: one line: the motion has no time law, the robot has no masses or efforts, or floats and plants
                nothing.
        """
        law = check_executable(motion)
        self.motion = motion
        self.robot: RobotModel = motion.robot
        self._law = law
        self._planned = list_phases(motion)
        apart = find_mechanism_joints(motion)
        model = motion.robot.model
        n_moved = sum(int(model.joints[joint].nv) for joint in apart)
        first = len(BASE_NAMES) if motion.robot.is_floating else 0
        self._columns = slice(first, motion.robot.n - n_moved)
        self._moved = slice(motion.robot.n - n_moved, motion.robot.n)
        self.joint_names: tuple[str, ...] = motion.robot.joint_names[self._columns]
        self.mechanism_names: tuple[str, ...] = motion.robot.joint_names[self._moved]
        self.duration_s = float(law.times[-1] - law.times[0])
        self._start_s = float(law.times[0])
        self._parts = split_motion(motion)
        parts = zip(self._parts, self._planned, strict=True)
        self.phases = find_retreats(self._planned, [self._read_phase(part, phase) for part, phase in parts])
        self._grid = np.linspace(0.0, self.duration_s, max(int(np.ceil(self.duration_s / TABLE_STEP_S)), 1) + 1)
        path, speed, _ = law.at(self._grid + self._start_s)
        q, v = motion.curve(path), motion.curve(path, 1) * speed[:, None]
        tau, wrenches = self._tabulate_forces()
        self._links = tuple(wrenches)
        self._table = np.concatenate([q, v, tau, *wrenches.values()], axis=1)

    @property
    def joint_columns(self) -> Int[np.ndarray, "k"]:
        """(k,) columns of the actuated joints in a configuration of the plan."""
        return np.arange(self.robot.n)[self._columns]

    @staticmethod
    def read(folder: str | Path) -> PlannedReference:
        """Read a result folder as ``scopt verify`` reads it.

        Raises:
            ResultError: the folder cannot be read, its data contradict each other, or the plan cannot be executed.
        """
        return PlannedReference(read_motion(read_result(folder), result_path(folder).parent))

    def find_phase(self, time_s: float) -> ReferencePhase:
        """Return the phase at a time; the later one at a border, the last one beyond the end."""
        return self.phases[self.find_phase_number(time_s)]

    def find_phase_number(self, time_s: float) -> int:
        """Return the number of the phase at a time, from 0."""
        return max((k for k, phase in enumerate(self.phases) if time_s >= phase.begin_s), default=0)

    def at(self, time_s: float) -> ReferenceState:
        """Return what the plan wants at a time, clipped to its duration [s]."""
        time_s = min(max(float(time_s), 0.0), self.duration_s)
        step = self._grid[1] - self._grid[0]
        k = min(int(time_s / step), len(self._grid) - 2)
        u = (time_s - self._grid[k]) / step
        row, n = (1.0 - u) * self._table[k] + u * self._table[k + 1], self.robot.n
        q, v, tau, rest = row[:n], row[n : 2 * n], row[2 * n : 3 * n], row[3 * n :]
        return ReferenceState(
            time_s=time_s,
            q=q[self._columns],
            qd=v[self._columns],
            tau=tau[self._columns],
            configuration=q,
            velocity=v,
            contact_wrenches={link: rest[6 * i : 6 * i + 6] for i, link in enumerate(self._links)},
            mechanism=q[self._moved],
            is_floating=self.robot.is_floating,
        )

    def tabulate_commands(
        self, times: Float[np.ndarray, "T"]
    ) -> tuple[Float[np.ndarray, "T k"], Float[np.ndarray, "T k"], Float[np.ndarray, "T k"]]:
        """Return q, qd and tau of the actuated joints at many times, clipped to the duration [s]."""
        step, n = self._grid[1] - self._grid[0], self.robot.n
        clipped = np.clip(times, 0.0, self.duration_s)
        k = np.minimum((clipped / step).astype(int), len(self._grid) - 2)
        u = ((clipped - self._grid[k]) / step)[:, None]
        columns = self.joint_columns
        q, qd, tau = (
            (1.0 - u) * self._table[np.ix_(k, part * n + columns)] + u * self._table[np.ix_(k + 1, part * n + columns)]
            for part in range(3)
        )
        return q, qd, tau

    def _read_phase(self, part: Motion, phase: Phase) -> ReferencePhase:
        begin, end = (float(t) - self._start_s for t in find_times(self._law, np.array([phase.first, phase.last])))
        speed = float(self._law.at(np.array([end + self._start_s]))[1][0])
        rests = speed <= RESTING_RATE * float(self._law.speed.max())
        return ReferencePhase(phase.name, begin, end, phase.contacts, limit_loads(part, phase), rests)

    def _tabulate_forces(self) -> tuple[Float[np.ndarray, "G n"], dict[str, Float[np.ndarray, "G 6"]]]:
        """Return generalised forces, and contact wrenches by link, on the grid."""
        motion, law, phases, parts = self.motion, self._law, self._planned, self._parts
        grips = GripForces(motion)
        links = list(dict.fromkeys(contact.link for phase in phases for contact in phase.contacts))
        times: list[np.ndarray] = []
        torques: list[np.ndarray] = []
        wrenches: dict[str, list[np.ndarray]] = {link: [] for link in links}
        for k, (phase, span) in enumerate(zip(phases, self.phases, strict=True)):
            count = max(int(np.ceil((span.end_s - span.begin_s) / FORCE_STEP_S)), 1) + 1
            t = np.linspace(span.begin_s, span.end_s, count)
            # Forces just inside the phase: at a border the acceleration belongs to the phase that begins there.
            inside = np.clip(t, span.begin_s, max(span.end_s - 1e-9, span.begin_s)) + self._start_s
            s, speed, gain = law.at(inside)
            q, slope, bend = motion.curve(s), motion.curve(s, 1), motion.curve(s, 2)
            v, a = slope * speed[:, None], slope * gain[:, None] + bend * speed[:, None] ** 2
            loaded, loosened = self._ramp_loads(k, t), self._loosen(k, t)
            carried = carry_motion(parts[k], phase, q, v, a, loaded=loaded, loosened=loosened)
            times.append(t)
            torques.append(carried.torque + grips.list_torques(k, t, span.begin_s, span.end_s))
            first = 0
            for link in links:
                contact = next((contact for contact in phase.contacts if contact.link == link), None)
                if contact is None:
                    wrenches[link].append(np.zeros((count, 6)))
            for contact in phase.contacts:
                part = carried.forces[:, first : first + len(contact.sole)]
                first += len(contact.sole)
                arms = contact.points - contact.pose_world_link[:3, 3]
                moment = np.cross(arms, part).sum(axis=1)
                wrenches[contact.link].append(np.concatenate([part.sum(axis=1), moment], axis=1))
        grid = np.concatenate(times)
        tables = {link: _interpolate(self._grid, grid, np.concatenate(parts)) for link, parts in wrenches.items()}
        return _interpolate(self._grid, grid, np.concatenate(torques)), tables

    def _loosen(self, k: int, t: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S C"]:
        """Return per contact point of a phase how much it is relieved: towards a border where its contact changes."""
        phases, span = self._planned, self.phases[k]
        before = {contact.link for contact in phases[k - 1].contacts} if k else None
        after = {contact.link for contact in phases[k + 1].contacts} if k + 1 < len(phases) else None
        blend = min(BLEND_S, max(0.5 * (span.end_s - span.begin_s), 1e-6))
        columns = []
        for contact in phases[k].contacts:
            loose = np.zeros(len(t))
            if before is not None and contact.link not in before:
                loose = np.maximum(loose, 1.0 - (t - span.begin_s) / blend)
            if after is not None and contact.link not in after:
                loose = np.maximum(loose, 1.0 - (span.end_s - t) / blend)
            columns += [np.clip(loose, 0.0, 1.0)] * len(contact.sole)
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    def _ramp_loads(self, k: int, t: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
        """Return the share of the loads that is fed forward: none where a neighbouring phase has none."""
        phases, span = self._planned, self.phases[k]
        if not phases[k].loads:
            return np.zeros(len(t))
        ramp = min(LOAD_RAMP_S, max(0.5 * (span.end_s - span.begin_s), 1e-6))
        share = np.ones(len(t))
        if k == 0 or not phases[k - 1].loads:
            share = np.minimum(share, (t - span.begin_s) / ramp)
        if k + 1 == len(phases) or not phases[k + 1].loads:
            share = np.minimum(share, (span.end_s - t) / ramp)
        return np.clip(share, 0.0, 1.0)


def place_base(q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose (4, 4) of a floating base from its six coordinates: position, then yaw, pitch, roll."""
    pose = np.eye(4)
    (cy, cp, cr), (sy, sp, sr) = np.cos(q[3:6]), np.sin(q[3:6])
    pose[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    pose[:3, 3] = q[:3]
    return pose


def find_retreats(planned: Sequence[Phase], phases: Sequence[ReferencePhase]) -> tuple[ReferencePhase, ...]:
    """Return the phases of a plan with the rests that the robot can go back to from each."""
    found: list[ReferencePhase] = []
    rest: float | None = 0.0
    for k, (phase, own) in enumerate(zip(planned, phases, strict=True)):
        if k and _list_touches(phase) != _list_touches(planned[k - 1]):
            rest = None
        elif k and rest is None and phases[k - 1].rests:
            rest = phases[k - 1].end_s
        if phase.loads:
            rest = None
        found.append(replace(own, retreat_s=rest))
    return tuple(found)


def _list_touches(phase: Phase) -> tuple[list[str], list[str], bool]:
    """Return what the robot stands on, what it holds and with what, and whether it presses on a mechanism."""
    contacts = sorted(f"{own.link} {np.round(own.pose_world_link[:3, 3], 3).tolist()}" for own in phase.contacts)
    return contacts, sorted(f"{own.item} {own.link}" for own in phase.carriers), bool(phase.loads)


def check_executable(motion: Motion) -> TimeLaw:
    """Check that a motion says everything an executor needs, and return its time law.

    Raises:
        ResultError: one line that says what is missing.
    """
    robot = motion.robot
    if motion.law is None:
        raise ResultError("the result has no time law; plan it again with options.timed: true")
    moving = [*motion.start_rates, *motion.end_rates]
    if moving:
        raise ResultError(
            f"the plan begins or ends in motion (joint '{moving[0]}'), and execution begins and ends at rest; "
            "plan it without start.rates and goal.rates, or send its samples to a controller of your own"
        )
    apart = find_mechanism_joints(motion)
    masses = [float(inertia.mass) for joint, inertia in enumerate(robot.model.inertias) if joint not in apart]
    if not sum(masses[1:]) > 0.0:
        raise ResultError(f"robot '{robot.name}' has no masses; give its links an <inertial> in the URDF")
    first = len(BASE_NAMES) if robot.is_floating else 0
    last = robot.n - sum(int(robot.model.joints[joint].nv) for joint in apart)
    if robot.is_planar:
        raise ResultError(f"robot '{robot.name}': robot.root is planar, and nothing drives the base; expected fixed")
    weak = [robot.joint_names[k] for k in range(first, last) if not 0.0 < robot.effort[k] < np.inf]
    if weak:
        raise ResultError(f"robot '{robot.name}': joint '{weak[0]}' has no effort limit; give it one in the URDF")
    bare = [phase.name for phase in list_phases(motion) if robot.is_floating and not phase.contacts]
    if bare:
        raise ResultError(f"phase '{bare[0]}' plants no link; a floating robot would fall")
    return motion.law


def _interpolate(
    grid: Float[np.ndarray, "G"], times: Float[np.ndarray, "S"], table: Float[np.ndarray, "S k"]
) -> Float[np.ndarray, "G k"]:
    """Return the columns of a table at other times."""
    return np.stack([np.interp(grid, times, column) for column in table.T], axis=1)
