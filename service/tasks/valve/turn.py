"""Turn a valve: reach the wheel, insert the hook, turn, retract; again with a new hold where one is not enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from costs.kinematics import locate_links
from costs.robot import RobotModel
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.figures.travel import measure_turn
from service.demands.hands import Hand
from service.demands.phase import TaskPhase, find_rotation_onto
from service.demands.valve.strokes import TurnChoice, make_turn_phases
from service.demands.valve.wheel import Wheel, make_wheel_mechanism
from service.request.tasks.valve import VALVE_LINK, ValveRequest
from service.tasks.handling import find_turn_joint
from service.tasks.hints import FREE_WAYPOINTS, Hints, PhaseHints
from service.tasks.sequence import PhaseSequence

POSE_AT_WHEEL = "pose at the wheel"
TURN_STEP = float(np.deg2rad(20.0))  # between waypoints
PEG_RESERVE = 5e-4  # of the peg's allowances, for the curve between the waypoints [m]
TORQUE_SHARE = 0.8  # of the joints before the hand; the rest is for the motion [-]
THROUGH = 1.0  # depth with which a pair does not count [m]


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel, with the choices of hand, entry and number of strokes.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel, request: the wheel and the task.
        choice: the choices.
        free_waypoints: of the phases that reach for the wheel; None for the usual number.
        n_random: random configurations from which the first pose at the wheel is searched after the robot's postures.
    """

    solver: PhaseSolver
    wheel: Wheel
    request: ValveRequest
    choice: TurnChoice
    free_waypoints: int | None = None
    n_random: int = 0

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    def plan(self) -> TaskPlan:
        """Plan all strokes in order, each backwards from its turn."""
        body, choice = self.solver.body, self.choice
        mechanism = make_wheel_mechanism(self.wheel, float(np.deg2rad(self.request.turn_deg)))
        sequence = PhaseSequence.of(
            self.solver, mechanism, self.list_phases(), n_random=self.n_random, hints=self.hints
        )
        phases, stuck = sequence.plan(body.nominal)
        angle = f"{np.rad2deg(choice.entry):.0f} deg"
        frame = choice.hand.peg if self.request.mode == "hook" else choice.hand.tool
        measure = partial(measure_turn, self.wheel, self.request.torque_nm, frame)
        note = f"{choice.hand.side} hand in {self.request.mode} mode, {self._describe_place()} at {angle}"
        note += "" if self.wheel.is_lever else " of the rim"
        return TaskPlan(body, phases, stuck=stuck, measure=measure, notes=() if stuck else (note,))

    def list_phases(self) -> tuple[TaskPhase, ...]:
        """Return the phases of all strokes."""
        return make_turn_phases(self.wheel, self.request, self.choice, self.solver.hand_friction[1])

    @cached_property
    def hints(self) -> Hints:
        """How to go about the phases."""
        return make_turn_hints(self.solver.body, self.request, self.choice.hand, self.free_waypoints)

    def _describe_place(self) -> str:
        """Return a word about what is at the entry."""
        if self.wheel.is_lever:
            return f"its peg beside the {'grip' if self.wheel.grip > 0.0 else 'lever'}"
        return "its peg on the spoke" if self.request.mode == "hook" and self.wheel.spokes else "inserted"


def make_turn_hints(body: WholeBody, request: ValveRequest, hand: Hand, free_waypoints: int | None = None) -> Hints:
    """Return the hints of a valve's phases.

    The rod of a hook passes between spokes, so that the first guess of a turn may be in the wheel.  The wrist of a
    gripper is first guessed to follow the wheel.
    """
    passes: tuple[Allowance, ...] = ()
    rates: dict[str, float] = {}
    if request.mode == "hook":
        passes = (Allowance(BodyRef.of_link(hand.hook), BodyRef("mechanism", VALVE_LINK), THROUGH),)
    else:
        column, sense = find_turn_joint(body, hand.tool)
        rates = {body.robot.joint_names[column]: -sense}  # the tool's z axis points against the wheel's

    def hint(phase: TaskPhase) -> PhaseHints:
        return PhaseHints(
            POSE_AT_WHEEL,
            free_waypoints or FREE_WAYPOINTS,
            turn_step=TURN_STEP,
            rates=rates if phase.moving else {},
            passes=passes if phase.moving else (),
            torque_share=TORQUE_SHARE,
            depth_reserve_m=PEG_RESERVE,
        )

    return hint


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
        if hand is None or hand.rotation is None or not phase.moving:
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
