"""Phases of steps as data: frames that are led on ways, joints on straight lines, goals, and what stays where it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.guide import Guide
from costs.robot import RobotModel
from costs.rotation import pose_matrix
from service.demands.phase import TaskPhase
from service.demands.steps.holding import Holding
from service.demands.targets import make_goal_targets
from service.request.tasks.reach import GoalRequest
from service.verify import HandLoad, JointWayTarget, Profile, RelativePoseTarget, Target, WayTarget

KEPT_M, KEPT_RAD = 2e-3, float(np.deg2rad(0.5))  # by which a frame that keeps its pose may be off
STILL = 1e-4  # by which a locked joint, or one on a straight line, may be off [rad, m]
LEAST_RAMP_M, RAMP_SHARE = 5e-3, 0.25  # of a way on which the speed rises and falls: least length, most of its length
RAMP_M_S2 = 0.5  # acceleration that a ramp is long enough for


@dataclass(frozen=True)
class Led:
    """A frame that is led on a way.

    Attributes:
        frame: of the robot.
        guide: the way.
        free_axis: (3,) unit, in the frame, about which it may turn, or None.
        turns_freely: whether its orientation does not count.
        moves_freely: whether its place does not count.
        tolerance_m, rotation_tolerance_rad: along the whole way.
        speed_m_s: of its origin between the ramps; None for any.
        is_corner: whether the way rounds a corner, where the frame may be slower.
    """

    frame: str
    guide: Guide
    free_axis: Float[np.ndarray, "3"] | None = None
    turns_freely: bool = False
    moves_freely: bool = False
    tolerance_m: float = 1e-3
    rotation_tolerance_rad: float = KEPT_RAD
    speed_m_s: float | None = None
    is_corner: bool = False

    @property
    def ramp_m(self) -> float:
        """Length of the way at each end on which the speed rises or falls."""
        if self.speed_m_s is None:
            return 0.0
        wanted = max(LEAST_RAMP_M, 0.5 * self.speed_m_s**2 / RAMP_M_S2)
        return min(wanted, RAMP_SHARE * self.guide.length)

    def make_target(self) -> WayTarget:
        """Return the promise that the frame stays on its way."""
        guide = self.guide
        return WayTarget(
            self.frame,
            guide.position,
            guide.rotation,
            guide.centre,
            guide.axis,
            guide.angle,
            guide.shift,
            guide.turn,
            np.inf if self.moves_freely else self.tolerance_m,
            np.inf if self.turns_freely else self.rotation_tolerance_rad,
            self.free_axis,
            None if self.is_corner else self.speed_m_s,
            ramp_m=self.ramp_m,
        )


@dataclass(frozen=True)
class StepPhase:
    """One phase of a step, from a configuration on.

    Attributes:
        name: as the user sees it.
        led: frames on ways, all at the same shares.
        straight: joint and value at the end of joints that move on a straight line of configurations [rad, m].
        goal: at the end of a free motion.
        kept: frame and pose_world_frame (4, 4) of frames that stay where they are.
        locked: joints that stay where they are.
        profile: of the share of a straight line over time.
        duration_s: of the phase; None for the fastest.
        touches: pairs that may touch besides feet and floor.
        loads: that the surroundings put on a hand.
        fingers: joints that move in equal steps besides, and their values at the end [rad, m].
        targets: further promises.
        is_chosen: whether goal, straight line and fingers are the planner's choice, which nobody demands.
        holding: the objects and who carries them, and where the robot stands.
        lands: objects that rest at the end.
        flows: whether the next phase goes on without a rest.
        is_entered: whether it goes on from the phase before without a rest.
    """

    name: str
    led: tuple[Led, ...] = ()
    straight: dict[str, float] = field(default_factory=dict)
    goal: GoalRequest | None = None
    kept: tuple[tuple[str, Float[np.ndarray, "4 4"]], ...] = ()
    locked: tuple[str, ...] = ()
    profile: Profile = "any"
    duration_s: float | None = None
    touches: tuple[Allowance, ...] = ()
    loads: tuple[HandLoad, ...] = ()
    fingers: Mapping[str, float] = field(default_factory=dict)
    targets: tuple[Target, ...] = ()
    is_chosen: bool = False
    holding: Holding | None = None
    lands: tuple[str, ...] = ()
    flows: bool = False
    is_entered: bool = False

    def list_touches(
        self, robot: RobotModel, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"] | None
    ) -> tuple[Allowance, ...]:
        """Return the pairs that may touch between two configurations; without the last at the end that is wanted."""
        if self.holding is None:
            return self.touches
        touches = [*self.touches, *self.holding.list_touches()]
        for name in self.lands:
            pose = self._find_end(robot, name, first) if last is None else self.holding.locate(name, last)
            touches += self.holding.list_rest_touches(name, self.holding.find_rest(name, pose)[1])
        return tuple(dict.fromkeys(touches))

    def _find_end(self, robot: RobotModel, name: str, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "4 4"]:
        """Return where an object is to be at the end; as it is where nothing says that."""
        assert self.holding is not None
        here = self.holding.locate(name, q)
        hold = self.holding.held.get(name)
        frames = (name, *(() if hold is None else hold.tools))
        for led in self.led:
            if led.frame in frames:
                begin, end = led.guide.poses(np.array([0.0, 1.0]))
                return np.asarray(end @ np.linalg.inv(begin) @ here)
        for pose in () if self.goal is None else self.goal.poses:
            if pose.link == name:
                return pose_matrix(pose.origin, pose.quaternion_wxyz) if pose.quaternion_wxyz else here
        return here

    def demand(self, robot: RobotModel, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> TaskPhase:
        """Return what the phase demands of any motion.

        Args:
            robot: without what a task moves.
            first, last: (n,) configurations at its ends.
        """
        columns = {name: k for k, name in enumerate(robot.joint_names)}
        targets: list[Target] = [led.make_target() for led in self.led]
        targets += [
            RelativePoseTarget(frame, None, pose[:3, 3], pose[:3, :3], KEPT_M, KEPT_RAD) for frame, pose in self.kept
        ]
        if self.locked:
            values = first[[columns[name] for name in self.locked]]
            targets.append(JointWayTarget(self.locked, values, values, STILL))
        if self.holding is not None:
            targets += [target for hold in self.holding.held.values() for target in hold.list_chain()]
        targets += self.targets
        if self.straight and not self.is_chosen:
            start = first[[columns[name] for name in self.straight]]
            end = np.array(list(self.straight.values()))
            targets.append(JointWayTarget(tuple(self.straight), start, end, STILL, self.profile, self.duration_s))
        elif self.duration_s is not None:
            targets.append(JointWayTarget((), np.zeros(0), np.zeros(0), STILL, duration_s=self.duration_s))
        goal = () if self.goal is None or self.is_chosen else make_goal_targets(robot, self.goal, last)
        touches = self.list_touches(robot, first, last)
        carriers = () if self.holding is None else self.holding.carriers
        stands = None if self.holding is None else self.holding.stands
        braced = () if self.holding is None else self.holding.braced
        if self.holding is not None:
            touches = (*touches, *self.holding.list_brace_touches())
        own = tuple(targets)
        return TaskPhase(
            self.name,
            touches=touches,
            goal=goal,
            targets=own,
            loads=self.loads,
            carriers=carriers,
            contacts=braced or None,
            stands=stands,
            flows=self.flows,
        )


@dataclass(frozen=True)
class PhaseMaker:
    """A phase that is made from the configuration at which it begins.

    Attributes:
        name: of the phase.
        make: returns the phase, given the configuration (n,).
    """

    name: str
    make: Callable[[Float[np.ndarray, "n"]], StepPhase]
