"""Regions of a frame's pose in the optimiser: as constraints, as holds, and as what leads a pose into them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.collision import Contacts
from costs.kinematics import Kinematics, KinematicsEngine, locate_frame
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import AxisDirection, Between, BeyondBall, BeyondBox, FramePose, LookAt, NormWithin, Scaled
from scopt import Constraint, Residual
from service.body.holds import DRIFT, DRIFT_SHARE, REGION_M, REGION_RAD, REGION_SHARE, START_SHARE, Hold
from service.verify import RegionTarget

FAR = 1e3  # bound that stands for none [m, rad]
RESERVE_M, RESERVE_RAD = 2.5e-3, 0.02  # most of a goal's limit that is left to the optimiser's inaccuracy
RESERVE_SHARE = 0.25  # of a goal's limit that is left to it at most
ONE_SIDED_M = 2e-3  # left to it at a bound without an opposite one
NO_PLAY: Mapping[str, float] = {"m": 0.0, "rad": 0.0}
MOST_RESERVE = {"m": 0.02, "rad": 0.2}  # of a kept region for the curve between waypoints
AT_WAYPOINTS = 1e-4  # tolerance of the optimiser's rows [m, rad]


@dataclass(frozen=True)
class _Limit:
    """One limit of a region: rows in a box, or vectors of ``k`` rows in a ball about zero.

    Attributes:
        title: what it limits.
        unit: m or rad.
        residual: of a frame.
        lower, upper: (k,) of a box; FAR where there is none.
        ball: largest norm; None for a box.
    """

    title: str
    unit: str
    residual: Residual[MotionState]
    lower: Float[np.ndarray, "k"]
    upper: Float[np.ndarray, "k"]
    ball: float | None = None

    @property
    def is_narrow(self) -> bool:
        """Whether it is held rather than moved in."""
        most = REGION_M if self.unit == "m" else REGION_RAD
        half = 0.5 * float((self.upper - self.lower).max()) if self.ball is None else self.ball
        return half <= most

    def shrink(self, reserve: Float[np.ndarray, "k"]) -> _Limit:
        """Return the part with its limits moved inwards by a reserve."""
        ball = None if self.ball is None else self.ball - float(reserve[0])
        lower = np.where(self.lower > -FAR, self.lower + reserve, self.lower)
        return replace(self, lower=lower, upper=np.where(self.upper < FAR, self.upper - reserve, self.upper), ball=ball)

    @property
    def half(self) -> Float[np.ndarray, "k"]:
        """Half the width of each row's bounds; infinite where one is missing."""
        if self.ball is not None:
            return np.full(len(self.lower), self.ball)
        is_closed = (self.lower > -FAR) & (self.upper < FAR)
        return np.where(is_closed, 0.5 * (self.upper - self.lower), np.inf)

    def limit(self) -> Residual[MotionState]:
        """Return rows that are at most zero inside."""
        if self.ball is None:
            return Between(self.residual, self.lower, self.upper)
        return NormWithin(self.residual, len(self.lower), self.ball)

    def beyond(self) -> Residual[MotionState]:
        """Return rows that are zero inside, and else lead there."""
        if self.ball is None:
            return BeyondBox(self.residual, self.lower, self.upper)
        return BeyondBall(self.residual, len(self.lower), self.ball)


def _list_parts(robot: RobotModel, target: RegionTarget, waypoints: Int[np.ndarray, "S"]) -> Iterator[_Limit]:
    frame, reference = target.frame, target.reference
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = target.rotation, target.position
    own = f"{frame} relative to {reference or 'the world'}"

    def rows(axes: Sequence[bool]) -> FramePose:
        return FramePose(robot, frame, waypoints, pose, axes, reference)

    def ball(title: str, unit: str, residual: Residual[MotionState], k: int, limit: float) -> _Limit:
        return _Limit(f"{title} of {own}", unit, residual, np.full(k, -FAR), np.full(k, FAR), limit)

    bounded = np.isfinite(target.lower) | np.isfinite(target.upper)
    if bounded.any():
        lower, upper = (np.clip(bound, -FAR, FAR)[bounded] for bound in (target.lower, target.upper))
        yield _Limit(f"place of {own}", "m", rows((*bounded.tolist(), False, False, False)), lower, upper)
    if np.isfinite(target.radius_m):
        yield ball("distance from the axis", "m", rows((True, True, False, False, False, False)), 2, target.radius_m)
    if np.isfinite(target.distance_m):
        yield ball("position", "m", rows((True,) * 3 + (False,) * 3), 3, target.distance_m)
    if np.isfinite(target.turn_rad):
        yield ball("orientation", "rad", rows((False,) * 3 + (True,) * 3), 3, target.turn_rad)
    turned = target.turns_rad < np.pi
    if turned.any():
        most = target.turns_rad[turned]
        yield _Limit(f"turn of {own}", "rad", rows((False, False, False, *turned.tolist())), -most, most)
    if target.axis is not None and target.lean_rad < np.pi:
        if target.place is None:
            wanted = target.rotation @ target.axis
            yield ball(
                "axis",
                "rad",
                AxisDirection(robot, frame, waypoints, target.axis, wanted, reference),
                2,
                target.lean_rad,
            )
        else:
            look = LookAt(robot, frame, waypoints, target.axis, target.place, reference)
            yield ball("sight", "rad", look, 2, target.lean_rad)


def limit_goal(
    robot: RobotModel, target: RegionTarget, waypoint: int, label: str = ""
) -> list[Constraint[MotionState]]:
    """Return the constraints of a region at one waypoint; ``label`` tells them from those of other regions."""
    constraints = []
    for part in _list_parts(robot, target, np.array([waypoint])):
        reserve = _reserve_goal(part)
        tolerance = max(0.5 * float(reserve.min()), 1e-5)
        constraints.append(
            Constraint(part.title + label, part.shrink(reserve).limit(), tolerance=tolerance, unit=part.unit)
        )
    return constraints


def _reserve_goal(part: _Limit) -> Float[np.ndarray, "k"]:
    most = RESERVE_M if part.unit == "m" else RESERVE_RAD
    return np.minimum(RESERVE_SHARE * part.half, most)


def lead_into(robot: RobotModel, target: RegionTarget, first: MotionState, share: float) -> tuple[Hold, ...]:
    """Return holds that are zero where a frame has done a share of its way from its place at ``first`` to a region."""
    own = [_beyond(part).value(first) for part in _list_parts(robot, target, np.array([0]))]

    def make(k: int) -> Hold:
        def hold(waypoints: Int[np.ndarray, "S"]) -> Residual[MotionState]:
            part = list(_list_parts(robot, target, waypoints))[k]
            return Scaled(_beyond(part), 1.0, (1.0 - share) * own[k])

        return hold

    return tuple(make(k) for k in range(len(own)))


def _beyond(part: _Limit) -> Residual[MotionState]:
    """Return what leads into a part, well inside of it."""
    return part.shrink(1.5 * _reserve_goal(part)).beyond()


@dataclass(frozen=True)
class KeptRegion:
    """A frame that keeps to a region relative to another, along a part of the motion.

    Narrow limits of the whole motion are held as they are at the start; the others are regions.

    Attributes:
        region: what the verifier checks.
        label: what tells its constraints from those of other regions.
        shares: (T,) share of the path at each waypoint; None where they are equally spaced.
    """

    region: RegionTarget
    label: str = ""
    shares: Float[np.ndarray, "T"] | None = None

    @property
    def name(self) -> str:
        """Description for messages."""
        return f"{self.region.frame} relative to {self.region.reference or 'the world'}"

    @property
    def is_whole(self) -> bool:
        """Whether it holds along the whole motion."""
        return bool(self.region.during[0] <= 0.0 and self.region.during[1] >= 1.0)

    @property
    def is_held(self) -> tuple[bool, bool]:
        """Whether a limit of the position, and one of the orientation, is held."""
        if not self.is_whole:
            return False, False
        target = self.region
        widths = np.append(0.5 * (target.upper - target.lower), (target.radius_m, target.distance_m))
        turns = np.append(target.turns_rad, (target.turn_rad, target.lean_rad))
        return bool(np.any(widths <= REGION_M)), bool(np.any(turns <= REGION_RAD))

    @property
    def drift(self) -> float:
        """Largest residual of its holds between waypoints [m, rad]."""
        if not any(self.is_held):
            return DRIFT
        target = self.region
        widths = np.append(0.5 * (target.upper - target.lower), (target.radius_m, target.distance_m))
        turns = np.append(target.turns_rad, (target.turn_rad, target.lean_rad))
        return float(min(DRIFT, *(DRIFT_SHARE * np.append(widths, turns)).tolist()))

    def constraints(self, robot: RobotModel, waypoints: Int[np.ndarray, "S"]) -> tuple[Constraint[MotionState], ...]:
        """Return the limits at the waypoints, but at the first, which is given."""
        here = waypoints[self._is_within(len(waypoints))]
        if len(waypoints) > 1:
            here = here[here > 0]
        if not len(here):
            return ()
        return tuple(
            Constraint(part.title + self.label, self._shrink(part).limit(), tolerance=AT_WAYPOINTS, unit=part.unit)
            for part in _list_parts(robot, self.region, here)
        )

    def holds(self, robot: RobotModel) -> tuple[Hold, ...]:
        """Return the holds of the curve: narrow limits of the whole motion, led well inside."""
        if not self.is_whole:
            return ()
        is_narrow = [part.is_narrow for part in _list_parts(robot, self.region, np.array([0]))]

        def make(k: int) -> Hold:
            def hold(waypoints: Int[np.ndarray, "S"]) -> Residual[MotionState]:
                part = list(_list_parts(robot, self.region, waypoints))[k]
                half = part.half
                return part.shrink((1.0 - START_SHARE) * half).beyond()

            return hold

        return tuple(make(k) for k in np.flatnonzero(is_narrow).tolist())

    def are_within(self, robot: RobotModel, placed: Kinematics) -> bool:
        """Return whether every pose is in the region; where it holds on a part of the motion none is looked at."""
        if not self.is_whole:
            return True
        state = MotionState(placed, Contacts.none())
        everywhere = np.arange(placed.n_waypoints)
        parts = _list_parts(robot, self.region, everywhere)
        return all(bool(np.all(self._shrink(part).limit().value(state) <= 0.0)) for part in parts if not part.is_narrow)

    def target(self) -> RegionTarget:
        """Return the verifier's target."""
        return self.region

    def place(self, shares: Float[np.ndarray, "T"]) -> KeptRegion:
        """Return the region for waypoints at these shares of the path."""
        return replace(self, shares=shares)

    def find_start_problems(self, robot: RobotModel, start: Float[np.ndarray, "n"]) -> Iterator[str]:
        """Yield a sentence for each limit that the start is beyond."""
        if self.region.during[0] > 0.0:
            return
        for excess in self.measure_excess(robot, start):
            yield f"at the start the {excess} outside; expected a start in the region, or after above 0"

    def measure_excess(
        self, robot: RobotModel, q: Float[np.ndarray, "n"], play: Mapping[str, float] = NO_PLAY
    ) -> Iterator[str]:
        """Yield each limit that a configuration exceeds by more than some play (by unit), with the excess, in words."""
        state = MotionState(KinematicsEngine(robot)(q[None]), Contacts.none())
        for part in _list_parts(robot, self.region, np.array([0])):
            beyond = float(np.abs(part.beyond().value(state)).max(initial=0.0))
            if beyond > play[part.unit]:
                size = f"{1e3 * beyond:.1f} mm" if part.unit == "m" else f"{np.rad2deg(beyond):.1f} deg"
                yield f"{part.title} is {size}"

    def moves(self, robot: RobotModel) -> bool:
        """Whether a joint moves the frame in its reference."""
        holder = 0 if self.region.reference is None else locate_frame(robot, self.region.reference)[0]
        return locate_frame(robot, self.region.frame)[0] != holder

    def _shrink(self, part: _Limit) -> _Limit:
        """Return the part for waypoints: the rest of it is for the curve between them."""
        half = part.half
        share = 1.0 - START_SHARE if part.is_narrow else 1.0 - REGION_SHARE
        return part.shrink(np.minimum(np.where(np.isfinite(half), share * half, ONE_SIDED_M), MOST_RESERVE[part.unit]))

    def _is_within(self, n_waypoints: int) -> Bool[np.ndarray, "T"]:
        """Return the waypoints on its part of the path, with one more on either side."""
        if n_waypoints == 1:  # a pose: the goal's
            return np.array([self.region.during[1] >= 1.0])
        shares = np.linspace(0.0, 1.0, n_waypoints)
        if self.shares is not None and len(self.shares) == n_waypoints:
            shares = self.shares
        first, last = self.region.during
        inside = (shares >= first) & (shares <= last)
        before, after = np.flatnonzero(shares < first), np.flatnonzero(shares > last)
        inside[before[-1:]] = True
        inside[after[:1]] = True
        return np.asarray(inside)
