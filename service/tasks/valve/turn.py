"""Turn a valve: reach the wheel, insert the hook, turn, retract; again with a new hold where one is not enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from costs.kinematics import locate_links
from costs.robot import RobotModel
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.figures.travel import measure_turn
from service.demands.phase_spec import REACH_WAYPOINTS, PhaseSpec, find_rotation_onto
from service.demands.valve.strokes import TurnChoice, make_turn_phases
from service.demands.valve.wheel import Wheel, make_wheel_mechanism
from service.request.tasks.valve import ValveRequest
from service.tasks.handling import find_turn_joint
from service.tasks.sequence import PhaseSequence


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel, with the choices of hand, entry and number of strokes.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel, request: the wheel and the task.
        choice: the choices.
        reach_waypoints: of the phases that reach for the wheel.
        n_random: random configurations from which the first pose at the wheel is searched after the robot's postures.
    """

    solver: PhaseSolver
    wheel: Wheel
    request: ValveRequest
    choice: TurnChoice
    reach_waypoints: int = REACH_WAYPOINTS
    n_random: int = 0

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    def plan(self) -> TaskPlan:
        """Plan all strokes in order, each backwards from its turn."""
        body, choice = self.solver.body, self.choice
        mechanism = make_wheel_mechanism(self.wheel, float(np.deg2rad(self.request.turn_deg)))
        sequence = PhaseSequence.of(self.solver, mechanism, self.list_phases(), n_random=self.n_random)
        phases, stuck = sequence.plan(body.nominal)
        angle = f"{np.rad2deg(choice.entry):.0f} deg"
        frame = choice.hand.peg if self.request.mode == "hook" else choice.hand.tool
        measure = partial(measure_turn, self.wheel, self.request.torque_nm, frame)
        note = f"{choice.hand.side} hand in {self.request.mode} mode, {self._describe_place()} at {angle}"
        note += "" if self.wheel.is_lever else " of the rim"
        return TaskPlan(body, phases, stuck=stuck, measure=measure, notes=() if stuck else (note,))

    def list_phases(self) -> tuple[PhaseSpec, ...]:
        """Return the phases of all strokes; the wrist of a gripper is first guessed to follow the wheel."""
        friction = self.solver.hand_friction[1]
        phases = make_turn_phases(self.wheel, self.request, self.choice, self.reach_waypoints, friction)
        if self.request.mode == "hook":
            return phases
        column, sense = find_turn_joint(self.solver.body, self.choice.hand.tool)
        rates = {self.robot.joint_names[column]: -sense}  # the tool's z axis points against the wheel's
        return tuple(replace(phase, guess_rates=rates) if phase.is_anchor else phase for phase in phases)

    def _describe_place(self) -> str:
        """Return a word about what is at the entry."""
        if self.wheel.is_lever:
            return f"its peg beside the {'grip' if self.wheel.grip > 0.0 else 'lever'}"
        return "its peg on the spoke" if self.request.mode == "hook" and self.wheel.spokes else "inserted"


def measure_wrist(body: WholeBody, wheel: Wheel, request: ValveRequest, choice: TurnChoice) -> float:
    """Return how far the wrist would stay from its limits while a gripper turns a wheel [rad]; negative beyond them.

    The rest of the arm is taken to point at the wheel as it is, so that the wrist alone turns the hand.
    """
    column, sense = find_turn_joint(body, choice.hand.tool)
    rotation = locate_links(body.engine, body.nominal, [choice.hand.tool])[choice.hand.tool][:3, :3]
    turned = find_rotation_onto(rotation[:, 2], -wheel.axis) @ rotation
    margin = np.inf
    for phase in make_turn_phases(wheel, request, choice):
        hand = phase.hand
        if hand is None or hand.rotation is None or not phase.is_anchor:
            continue
        x = Rotation.from_rotvec(float(phase.first[0]) * wheel.axis).apply(hand.rotation[:, 0])
        off = float(np.arctan2(turned[:, 1] @ x, turned[:, 0] @ x))  # about the tool's z axis
        first = float(body.nominal[column]) + sense * off
        travel = -sense * float(phase.last[0] - phase.first[0])
        lower, upper = float(body.robot.lower[column]), float(body.robot.upper[column])
        reserves = []
        for whole in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
            both = np.array([first + whole, first + whole + travel])
            reserves.append(min(both.min() - lower, upper - both.max()))
        margin = min(margin, max(reserves))
    return float(margin)
