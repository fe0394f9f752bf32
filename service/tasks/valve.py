"""Turn a valve: reach the wheel, insert the hook, turn, retract; again with a new grasp at the wrist's limit.

Two modes. ``hook``: the hook rests between the spokes and the hand is free to turn about its axis, so that one stroke
is a full turn. ``grasp``: the hand turns with the wheel, starting with the wrist at the limit that leaves the longest
turn (Franklin, 2016, sec. 4.3), and takes a new grasp at the other limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_frame
from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from service.body.held_load import find_held_shares
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import LIMIT_RESERVE
from service.demands.hands import Hand
from service.demands.phase_spec import REACH_WAYPOINTS, PhaseSpec
from service.demands.wheel import Grasp, Wheel, make_stroke_phases, make_wheel_mechanism
from service.request.names import VALVE_LINK
from service.tasks.sequence import PhaseSequence, find_turn_joint
from service.verify import Motion

Mode = Literal["hook", "grasp"]

WRIST_RESERVE = 0.1  # distance from the wrist's limits in a grasp, for the lean of the hand axis [rad]


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel with one hand, entering at one gap.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel, hand, mode: as in the request.
        turn: angle to turn by, right-handed about the wheel's axis [rad].
        entry: angle of the gap at which the hook is inserted [rad].
        torque_nm: that turns the wheel.
        reach_waypoints: of the phases that reach for the wheel.
    """

    solver: PhaseSolver
    wheel: Wheel
    hand: Hand
    mode: Mode
    turn: float
    entry: float
    torque_nm: float
    reach_waypoints: int = REACH_WAYPOINTS

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    def plan(self) -> TaskPlan:
        """Plan all strokes in order, each backwards from its turn."""
        body = self.solver.body
        sequence = PhaseSequence(self.solver, make_wheel_mechanism(self.wheel), self.list_phases())
        phases, stuck = sequence.plan(body.nominal)
        note = f"{self.hand.side} hand in {self.mode} mode, inserted at {np.rad2deg(self.entry):.0f} deg of the rim"
        return TaskPlan(body, phases, stuck=stuck, measure=self.measure, notes=() if stuck else (note,))

    def list_phases(self) -> tuple[PhaseSpec, ...]:
        """Return the phases of as few equal strokes as the wrist's range allows; of a single one in hook mode."""
        count, grasp = 1, None
        if self.mode == "grasp":
            column, sense = find_turn_joint(self.solver.body, self.hand.tool)
            grasp = self._choose_grasp(column, sense)
            usable = self.robot.upper[column] - self.robot.lower[column] - 2.0 * WRIST_RESERVE
            count = int(np.ceil(abs(self.turn) / usable))
        edges = np.linspace(0.0, self.turn, count + 1)
        names = [""] if count == 1 else [f" {k + 1}" for k in range(count)]
        return tuple(
            phase
            for name, *ends in zip(names, edges[:-1], edges[1:], strict=True)
            for phase in make_stroke_phases(
                self.wheel, self.hand, self.entry, (ends[0], ends[1]), name, grasp, self.torque_nm, self.reach_waypoints
            )
        )

    def _choose_grasp(self, column: int, sense: float) -> Grasp:
        """Return the grasp that begins with the wrist at the limit that leaves the longest turn."""
        # The tool's z axis points against the wheel's: a positive turn needs the wrist to go against its sense.
        rises = np.sign(self.turn) * sense < 0.0
        reserve = max(WRIST_RESERVE, LIMIT_RESERVE)
        lower, upper = self.robot.lower[column] + reserve, self.robot.upper[column] - reserve
        name = self.robot.joint_names[column]
        return Grasp(fixed={name: float(lower if rises else upper)}, rates={name: -sense})

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the tool's angle of travel about the valve's axis on the executed curve."""
        total = 0.0
        joint, pose_joint_tool = locate_frame(motion.robot, self.hand.tool)
        first, second = make_tangent_basis(np.asarray(self.wheel.axis))
        for phase in motion.phases:
            if phase.name.startswith("turn"):
                kinematics = KinematicsEngine(motion.robot)(motion.curve(np.linspace(phase.first, phase.last, 400)))
                positions: Float[np.ndarray, "S 3"]
                positions = kinematics.rotation[:, joint] @ pose_joint_tool[:3, 3] + kinematics.position[:, joint]
                offset = positions - self.wheel.centre
                angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
                total += float(angle[-1] - angle[0])
        figures = {"turned_deg": float(np.rad2deg(total))}
        share = find_held_shares(motion).get(VALVE_LINK) if self.torque_nm > 0.0 else None
        return figures if share is None else figures | {"holds_torque_nm": share * self.torque_nm}
