"""Demands of a task that moves a given mechanism on any motion, and on the rest of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from costs.robot import (
    Mechanism,
    RobotModel,
    with_mechanism,
)
from service.demands.figures.travel import measure_ends
from service.demands.hands import Hand
from service.demands.mechanism.given import GivenMechanism
from service.demands.mechanism.phases import make_mechanism_phases, turn_fingers
from service.demands.mechanism.settling import keep_aside, settle_handle
from service.demands.mechanism.tips import list_pushing_hands
from service.demands.phase import TaskPhase
from service.demands.rest.phases import RestTask, check_travel, start_mechanism
from service.errors import RequestError
from service.request.fields import HAND_FRICTION
from service.request.resume import HoldChoice, ResumeRequest
from service.verify import Motion, RelativePoseTarget, Target

SAME_TURN = 1e-6  # entries of a rotation that a record holds


@dataclass(frozen=True)
class GivenMechanismDemand:
    """What the task of moving a given mechanism demands of any motion, and the choice it leaves: the hand.

    Attributes:
        given: the mechanism and the task.
        robot: without the mechanism.
        friction: least and largest coefficient between hand and mechanism.
    """

    given: GivenMechanism
    robot: RobotModel
    friction: tuple[float, float] = HAND_FRICTION

    @property
    def mechanism(self) -> Mechanism:
        """The joints of the URDF."""
        return self.given.mechanism

    def read_choices(self, recorded: Motion) -> tuple[tuple[TaskPhase, ...], tuple[str, ...]]:
        """Return the phases with the record's hand, or a sentence that no permitted hand holds the handle."""
        hand = self.find_hand(recorded)
        if hand is None:
            return (), ("no hand that the task permits holds the handle",)
        robot = with_mechanism(self.robot, self.given.mechanism.joints)
        return make_mechanism_phases(settle_handle(self.given, robot, hand, self.friction), hand), ()

    def find_hand(self, recorded: Motion) -> Hand | None:
        """Return the hand that holds the handle in a record; None if none does that the task permits."""
        targets = [target for phase in recorded.phases for target in phase.targets]
        tools = {
            target.frame
            for target in targets
            if isinstance(target, RelativePoseTarget) and target.reference == self.given.handle.link
        }
        pushing = list_pushing_hands(self.robot, self.given)
        held = [hand for hand in pushing if tools & {hand.peg, hand.tool, hand.stub}]
        return next((hand for hand in held if self._is_turned(hand, targets)), next(iter(held), None))

    def _is_turned(self, hand: Hand, targets: Sequence[Target]) -> bool:
        """Return whether targets of a record hold the side of a gripper's fingers as a hand does."""
        turned = turn_fingers(self.given, hand)
        return turned is None or any(
            isinstance(target, RelativePoseTarget)
            and target.frame == hand.tool
            and target.reference == self.given.handle.link
            and float(np.abs(target.rotation - turned).max()) <= SAME_TURN
            for target in targets
        )

    def keep_choices(self, recorded: Motion) -> dict[str, Any] | str:
        """Return the hand of a record, or a sentence that it has none."""
        hand = self.find_hand(recorded)
        return "no hand holds the mechanism" if hand is None else {"hold": HoldChoice(hand.side)}

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the values of the moved joints at the end of a motion [deg, m]."""
        return measure_ends(self.mechanism, [move.joint for move in self.given.request.moves], motion)


def read_kept_hand(demand: GivenMechanismDemand, resume: ResumeRequest) -> Hand:
    """Return the hand of an earlier plan, which the rest of it keeps.

    Raises:
        RequestError: the request has none, or the task forbids it.
    """
    if resume.hold is None:
        raise RequestError("resume.hold: is missing; a mechanism is moved with the hand of the earlier plan")
    side = demand.given.request.hand
    if side not in ("auto", resume.hold.hand):
        raise RequestError(f"resume.hold.hand: {resume.hold.hand}; task.mechanism.hand permits {side}")
    pushing = list_pushing_hands(demand.robot, demand.given)
    hand = next((hand for hand in pushing if hand.side == resume.hold.hand), None)
    if hand is None:
        raise RequestError(f"resume.hold.hand: the robot has no {resume.hold.hand} hand that can push it")
    return hand


def make_mechanism_rest(demand: GivenMechanismDemand, resume: ResumeRequest) -> RestTask:
    """Return what the rest of a task with a given mechanism demands.

    Raises:
        RequestError: its phase, mechanism or hand do not fit the task.
    """
    hand = read_kept_hand(demand, resume)
    robot = with_mechanism(demand.robot, demand.mechanism.joints)
    given = settle_handle(demand.given, robot, hand, demand.friction)
    specs = make_mechanism_phases(given, hand)
    specs = keep_aside(specs, robot, given.mechanism, demand.friction)
    mechanism = start_mechanism(given.mechanism, resume.mechanism)
    check_travel(mechanism, specs, resume.phase)
    return RestTask(mechanism, specs, resume.phase, demand.measure)
