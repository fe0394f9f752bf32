"""Turn a valve: reach the wheel, insert the hook, turn, retract; again with a new hold where one is not enough."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_frame
from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from service.body.held_load import find_held_shares
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands.phase_spec import REACH_WAYPOINTS, PhaseSpec
from service.demands.strokes import TURN, TurnChoice, make_turn_phases
from service.demands.wheel import Wheel, make_wheel_mechanism
from service.request.names import VALVE_LINK
from service.request.schema import ValveRequest
from service.tasks.sequence import PhaseSequence
from service.verify import Motion


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel, with the choices of hand, entry and number of strokes.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel, request: the wheel and the task.
        choice: the choices.
        reach_waypoints: of the phases that reach for the wheel.
    """

    solver: PhaseSolver
    wheel: Wheel
    request: ValveRequest
    choice: TurnChoice
    reach_waypoints: int = REACH_WAYPOINTS

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    def plan(self) -> TaskPlan:
        """Plan all strokes in order, each backwards from its turn."""
        body, choice = self.solver.body, self.choice
        mechanism = make_wheel_mechanism(self.wheel, float(np.deg2rad(self.request.turn_deg)))
        sequence = PhaseSequence(self.solver, mechanism, self.list_phases())
        phases, stuck = sequence.plan(body.nominal)
        note = (
            f"{choice.hand.side} hand in {self.request.mode} mode, {self._describe_place()} at "
            f"{np.rad2deg(choice.entry):.0f} deg of the rim"
        )
        return TaskPlan(body, phases, stuck=stuck, measure=self.measure, notes=() if stuck else (note,))

    def list_phases(self) -> tuple[PhaseSpec, ...]:
        """Return the phases of all strokes."""
        return make_turn_phases(self.wheel, self.request, self.choice, self.reach_waypoints)

    def _describe_place(self) -> str:
        """Return a word about what is at the entry."""
        return "its peg on the spoke" if self.request.mode == "hook" and self.wheel.spokes else "inserted"

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the tool's angle of travel about the valve's axis on the executed curve."""
        total = 0.0
        joint, pose_joint_tool = locate_frame(motion.robot, self.choice.hand.peg)
        first, second = make_tangent_basis(np.asarray(self.wheel.axis))
        for phase in motion.phases:
            if phase.name.split(" ")[0] == TURN:
                kinematics = KinematicsEngine(motion.robot)(motion.curve(np.linspace(phase.first, phase.last, 400)))
                positions: Float[np.ndarray, "S 3"]
                positions = kinematics.rotation[:, joint] @ pose_joint_tool[:3, 3] + kinematics.position[:, joint]
                offset = positions - self.wheel.centre
                angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
                total += float(angle[-1] - angle[0])
        figures = {"turned_deg": float(np.rad2deg(total))}
        torque = self.request.torque_nm
        share = find_held_shares(motion).get(VALVE_LINK) if torque > 0.0 else None
        return figures if share is None else figures | {"holds_torque_nm": share * torque}
