"""A door to open, as the search for a place to stand sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.allowance import BodyRef
from costs.robot import Mechanism, RobotModel
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.demands.door.demand import measure_peg
from service.demands.door.door import Door
from service.demands.door.phases import DoorChoice, Push, make_door_phases
from service.demands.hands import Hand
from service.demands.phase import TaskPhase
from service.tasks.door.hints import LEAF, make_door_hints
from service.tasks.door.opening import LEAST_FIRST, list_choices
from service.tasks.door.places import HAND_ROOM, PUSH_ALONG, PUSH_UP
from service.tasks.door.sweep import find_blocked_opening
from service.tasks.stances.poses import (
    Outcome,
    StancePose,
    StancePoseFinder,
    find_shoulder,
    place_on_joint,
    place_turned,
)

DOOR_STEP = np.deg2rad(10.0)  # between the angles that are tried
MOST_PUSHES = 4  # places on the leaf that are tried, the nearest to a shoulder first


@dataclass(frozen=True)
class DoorStance:
    """A door to open.

    Attributes:
        door: leaf, handle and loads.
        hands: that may be used.
        target: opening angle at the end [rad].
        near: required clearances between hands and door [m].
        pegs: length of each hand's free rod [m].
    """

    door: Door
    hands: tuple[Hand, ...]
    target: float
    near: tuple[tuple[BodyRef, BodyRef, float], ...]
    pegs: tuple[float, ...]

    @staticmethod
    def of(
        robot: RobotModel,
        door: Door,
        hands: tuple[Hand, ...],
        target: float,
        near: tuple[tuple[BodyRef, BodyRef, float], ...],
    ) -> DoorStance:
        """Return the task of a robot."""
        return DoorStance(door, hands, target, near, tuple(measure_peg(robot, hand) for hand in hands))

    @property
    def mechanism(self) -> Mechanism:
        """Leaf and handle."""
        return self.door.mechanism

    @property
    def start(self) -> float:
        """Opening angle at the start [rad]."""
        return self.door.geometry.ajar

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: at the handle alone, and at the handle first and on the leaf at the end."""
        ways: list[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...]] = []
        early = min(self.start + 2.0 * DOOR_STEP, self.target)
        for hand, choice in self._list_choices():
            at_handle = choice.first > self.start
            if at_handle:
                held = self._find_anchor(choice)
                ways.append(((hand, self._place(held, (self.start, 0.5 * (self.start + self.target), self.target))),))
            for push in self._list_pushes(self.target):
                pushed = self._find_anchor(replace(choice, first=early if at_handle else self.start, push=push))
                values = (early, self.target) if self.door.is_push else (self.target,)
                on_leaf = (push.hand, self._place(pushed, values))
                first = ((hand, self._place(self._find_anchor(choice), (self.start, early))),) if at_handle else ()
                ways.append((*first, on_leaf))
        return tuple(ways)

    @property
    def whole(self) -> float:
        """Angle to open by [rad]."""
        return self.target - self.start

    @property
    def is_angle(self) -> bool:
        """Yes."""
        return True

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return leaf and handle, shut or ajar as at the start, or open."""
        return place_turned(self.mechanism, self.target if is_end else float(self.mechanism.start[0]))

    def rate_places(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return nothing: no side of the door is preferred."""
        return np.zeros(len(poses))

    def is_in_the_way(
        self, poses: Float[np.ndarray, "N 3"], soles: Float[np.ndarray, "N C 2"], body_m: float
    ) -> Bool[np.ndarray, "N"]:
        """Return whether the robot would stand in the door, or where the leaf moves."""
        door = self.door.geometry
        offset = soles - door.hinge[:2]
        out, along = offset @ door.normal[:2], offset @ door.along[:2]
        base_out = (poses[:, :2] - door.hinge[:2]) @ door.normal[:2]
        blocked = base_out < door.face + body_m
        blocked |= ((out < door.face + 0.02) & (np.abs(along) < door.width + 0.1)).any(axis=1)
        if not self.door.is_push:
            angle = np.arctan2(out, along)
            swept = (np.hypot(out, along) < door.width + 0.03) & (angle > -0.1) & (angle < self.target + 0.1)
            blocked |= swept.any(axis=1)
        return np.asarray(blocked)

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for the planted link and the link of a leg that the leaf would meet."""
        for met in find_blocked_opening(body, self.door, self.target):
            yield met.describe(self.target)

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest angle to which the leaf opens at the handle, or pushed on from there."""
        best = Outcome(0.0, (), "", "pose at the handle")
        for hand, choice in self._list_choices():
            outcome = self._try_choice(StancePoseFinder(solver, self.mechanism, make_door_hints()), hand, choice)
            if outcome.reached > best.reached or not best.hold:
                best = outcome
            if not outcome.missing:
                break
        return best

    def _try_choice(self, finder: StancePoseFinder, hand: Hand, choice: DoorChoice) -> Outcome:
        poses: list[StancePose] = []
        reached, hold = self.start, f"{hand.side} hand"
        if choice.first > self.start:
            hold += " at the handle"
            specs = make_door_phases(self.door, choice)
            anchor = next(spec for spec in specs if LEAF in spec.moving)
            for spec in (specs[1], anchor):  # the line to the handle begins in free space
                pose = finder.find(spec, poses)
                if pose is None:
                    missed = finder.hints(spec).pose_name if spec is anchor else spec.name
                    return Outcome(0.0, tuple(poses), hold, f"{missed}: no pose")
                poses.append(pose)
            for angle in self._list_angles(self.start):
                pose = finder.find(replace(anchor, first=self._at(angle)), poses)
                if pose is not None:
                    poses.append(pose)
                    reached = max(reached, angle)
                if (pose is None) == (angle < self.target):
                    break
            if reached >= self.target:
                return Outcome(self.target - self.start, tuple(poses), hold, "")
            if reached < self.start + LEAST_FIRST - 1e-6:
                return Outcome(0.0, tuple(poses), hold, "no pose with the leaf open and the hand at the handle")
            choice = replace(choice, first=reached)
        pushes = self._list_pushes(self.target)
        room = self.door.geometry.width * np.sin(reached)
        missing = f"no pose with the hand at the handle beyond {np.rad2deg(reached):.0f} deg"
        if not self.door.is_push and room < HAND_ROOM:
            return Outcome(reached - self.start, tuple(poses), hold, f"{missing}, and no room behind the leaf")
        body = finder.solver.body
        shoulders = {push.hand.side: find_shoulder(body.robot, body.nominal, push.hand) for push in pushes}

        def distance(push: Push) -> float:
            spec = self._find_anchor(replace(choice, push=push))
            place = self._place(spec, (0.5 * (reached + self.target),))[0]
            return abs(float(np.linalg.norm(place - shoulders[push.hand.side])) - 0.6)

        for push in sorted(pushes, key=distance)[:MOST_PUSHES]:
            spec = self._find_anchor(replace(choice, push=push))
            first = finder.find(spec, poses)
            last = None if first is None else finder.find(replace(spec, first=spec.last), [*poses, first])
            if first is not None and last is not None:
                words = f"{push.hand.side} hand on the leaf"
                hold = words if choice.first <= self.start else f"{hold} to {np.rad2deg(reached):.0f} deg, then {words}"
                return Outcome(self.target - self.start, (*poses, first, last), hold, "")
        return Outcome(reached - self.start, tuple(poses), hold, f"{missing}, nor on the leaf")

    def _list_choices(self) -> list[tuple[Hand, DoorChoice]]:
        """Return one hold of the handle per hand and sense; of the leaf alone where it is ajar."""
        return [
            (hand, choice)
            for hand, peg in zip(self.hands, self.pegs, strict=True)
            for choice in list_choices(self.door, hand, peg, self.target, most_grips=1)
        ]

    def _list_pushes(self, last: float) -> list[Push]:
        geometry = self.door.geometry
        return [
            Push(hand, share * geometry.width, up - float(geometry.hinge[2]), last)
            for hand in self.hands
            for share in PUSH_ALONG
            for up in PUSH_UP[:2]
        ]

    def _list_angles(self, start: float) -> list[float]:
        """Return the opening angles to try, the target first, then from the smallest on [rad]."""
        between = np.arange(start + 2.0 * DOOR_STEP, self.target - 0.5 * DOOR_STEP, 2.0 * DOOR_STEP)
        return [self.target, start + LEAST_FIRST, *between.tolist()]

    def _find_anchor(self, choice: DoorChoice) -> TaskPhase:
        """Return the phase in which the choice's last hold opens the leaf."""
        return next(spec for spec in reversed(make_door_phases(self.door, choice)) if LEAF in spec.moving)

    def _at(self, angle: float) -> Float[np.ndarray, "k"]:
        """Return the mechanism's joints with the leaf open by an angle and the handle pressed."""
        values = self.mechanism.start.copy()
        if len(values) > 1 and self.door.is_latched:
            values[1] = max(self.door.pressed, float(values[1]))
        values[0] = angle
        return values

    def _place(self, spec: TaskPhase, angles: Sequence[float]) -> Float[np.ndarray, "P 3"]:
        return place_on_joint(self.mechanism, spec, angles)
