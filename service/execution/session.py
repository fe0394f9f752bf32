"""Plans in a loop: one robot in one scene that goes from goal to goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import BASE_NAMES, turn_near
from costs.rotation import make_quaternions
from scopt import Clock
from service.demands.targets import find_goal_joints
from service.errors import RequestError
from service.planner import plan
from service.request.schema import PlanRequest, PoseRequest, StartRequest
from service.request.tasks.reach import GoalPartRequest, GoalRequest
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.start.robot import load_requested_robot

MOST_KEPT = 64  # motions of a session
NEAR = 0.3  # of an end of an earlier motion that is used again: each joint, or each link of the goal [rad, m]
REACHED = (Verdict.CERTIFIED, Verdict.FEASIBLE_AT_SAMPLES)

Path = Float[np.ndarray, "T n"]


class ReachSession:
    """A robot that reaches for one goal after another, each from where the last plan that was found ended.

    Robot and scan are read once.  A search begins with an earlier motion of the session whose ends are near the new
    ones, forwards or backwards; a note says where there is none.  Each plan gets a certificate of its own.

    Attributes:
        last: the last result; None before the first.
    """

    def __init__(self, request: PlanRequest) -> None:
        """Read robot and scan of a request.

        Raises:
            RequestError: one line per problem of the request, or it has a task and no goal.
        """
        if request.goal is None:
            raise RequestError("goal: is missing; a session plans reaches")
        self.last: PlanResult | None = None
        self._request = request
        self._robot = load_requested_robot(request, finds_package=True)
        setup = prepare(request, robot=self._robot, finds_package=True)
        self._around = setup.surroundings
        self._engine = KinematicsEngine(setup.robot)
        self._q = setup.start
        self._rates: dict[str, float] = {}
        self._paths: list[Path] = []

    def plan(
        self,
        goal: GoalRequest | None = None,
        start: StartRequest | None = None,
        should_stop: Callable[[], bool] | None = None,
        clock: Clock | None = None,
    ) -> PlanResult:
        """Plan the reach of a goal, and keep its motion.

        Args:
            goal: by default that of the session's request.
            start: where the robot is now; by default at the end of the last plan that was found.
            should_stop, clock: as of ``service.plan``.

        Raises:
            RequestError: one line per problem of goal and start.
        """
        request = replace(self._request, goal=self._request.goal if goal is None else goal)
        if start is not None:
            request = replace(request, start=start)
            self._q = prepare(request, robot=self._robot, around=self._around, checks_start=False).start
        elif self.last is not None:
            request = replace(request, start=self._write_start())
        chosen = self._choose_path(request.goal)
        result = plan(
            request,
            should_stop=should_stop,
            robot=self._robot,
            around=self._around,
            clock=clock,
            start_from=chosen,
        )
        if self._paths and chosen is None:
            note = (
                f"start_from: none of {len(self._paths)} earlier motions leads from within {NEAR:g} rad or m of the "
                "start to as near the goal; the motion is searched anew"
            )
            result = replace(result, notes=(*result.notes, note))
        if result.verdict in REACHED:
            self._q, self._rates = result.waypoints[-1], request.end_rates[1]
            self._paths = [*self._paths, result.waypoints][-MOST_KEPT:]
        self.last = result
        return result

    def _write_start(self) -> StartRequest:
        """Return the section of a request that starts where the robot is, as it moves at the end of the last plan."""
        robot, q = self._engine.robot, self._q
        first = len(BASE_NAMES) if robot.is_floating else 0
        base = None
        if robot.is_floating:
            x, y, z = q[:3].tolist()
            turn = make_quaternions(q[None, 3:first])[0].tolist()
            base = PoseRequest((x, y, z), (turn[0], turn[1], turn[2], turn[3]))
        names, positions = robot.joint_names[first:], tuple(q[first:].tolist())
        return StartRequest(joint_names=names, positions=positions, base=base, rates=self._rates)

    def _choose_path(self, goal: GoalRequest | None) -> Path | None:
        """Return the earlier path whose ends are nearest to the robot and to a goal; None where none is near."""
        paths = [way for path in self._paths for way in (path, path[::-1])]
        if goal is None or not paths:
            return None
        offs = [self._measure_off(path, goal) for path in paths]
        best = int(np.argmin(offs))
        return paths[best] if offs[best] <= NEAR else None

    def _measure_off(self, path: Path, goal: GoalRequest) -> float:
        """Return how far the ends of a path are from the robot and from a goal: the farthest joint or link [rad, m]."""
        first = float(np.abs(turn_near(self._engine.robot, path[0], self._q) - self._q).max())
        if first > NEAR:
            return np.inf
        return min(max([first, *self._list_offs(path[-1], part)]) for part in goal.alternatives)

    def _list_offs(self, q: Float[np.ndarray, "n"], goal: GoalPartRequest) -> Iterator[float]:
        """Yield how far each joint or link of a goal is from its place at a configuration, but of regions [rad, m]."""
        for index, value in find_goal_joints(self._engine.robot, goal, q).items():
            yield abs(float(q[index]) - value)
        poses = [pose for pose in goal.poses if pose.relative_to is None and pose.position is not None]
        places = locate_links(self._engine, q, [pose.link for pose in poses]) if poses else {}
        for pose in poses:
            yield float(np.linalg.norm(places[pose.link][:3, 3] - np.array(pose.origin)))
