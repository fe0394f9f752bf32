"""A tool that is held at a place or led along a line: its residuals, and configurations that follow it in balance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.robot import RobotModel
from costs.state import MotionState
from costs.support import SupportPolygon
from costs.terms import AxisDirection, CentreOfMassAt, FramePose, Joined, NormWithin, WithinTolerance
from scopt import Residual
from service.body.comfort import RESERVE_M
from service.body.forces.loaded_regions import PlannedRegion
from service.body.holds import Hold, project_within_limits
from service.body.inverse_kinematics import solve_holds
from service.body.whole_body import WholeBody
from service.demands.phase import AXIS, FrameMotion, find_rotation_onto
from service.demands.stance import BALANCE_RESERVE

FOLLOW_STEPS = 12  # of Newton's method from one waypoint to the next
NEAR = 0.01  # largest residual of a configuration that the optimiser had better begin with than the guess [m, rad]
FOLLOWED = 1e-3  # largest residual of a waypoint that follows the tool [m, rad]
LINE_ROOM = 1e-3  # of a frame on a line that it keeps, along each axis [m]
TURN_RESERVE = float(np.deg2rad(0.3))  # of its turn about each axis, for the curve between the waypoints [rad]
INSIDE_ROUNDS = 20  # of moves onto the borders of polygons
INSIDE_RESERVE = 3e-3  # beyond the margin, for what moves the centre of mass later [m]
INSIDE_SHARE = 0.75  # of a small region's depth that the centre of mass is brought to, where all of it is less


def make_hold(robot: RobotModel, hand: FrameMotion) -> Hold:
    """Return the hold of a hand at its place: position, but for its slide; with a rotation also its turn."""
    return lambda waypoints: place_tool(robot, hand, waypoints, hand.place[None])


def place_tool(
    robot: RobotModel,
    hand: FrameMotion,
    waypoints: Int[np.ndarray, "S"] | Sequence[int],
    places: Float[np.ndarray, "#S 3"],
) -> Residual[MotionState]:
    """Return a tool's distance from its places, but for its slide; with a rotation also its turn about its axis."""
    if hand.rotation is not None:
        turns = not hand.turns_freely
        return _measure_off(robot, hand, waypoints, places, hand.rotation, (True, True, True, False, False, turns))
    is_free = hand.slide is None
    axes = (True, True, is_free, False, False, False)
    return _measure_off(robot, hand, waypoints, places, _find_slide_axes(hand), axes)


def keep_near_line(
    robot: RobotModel,
    frame: FrameMotion,
    waypoints: Int[np.ndarray, "S"] | Sequence[int],
    places: Float[np.ndarray, "#S 3"],
) -> Residual[MotionState]:
    """Return how far a frame is beyond the room that it has about its places, and about its rotation.

    Tilted about all three axes at once it stays within its tilt, with room between the waypoints.
    """
    rotation = np.eye(3) if frame.rotation is None else frame.rotation
    pose = _measure_off(robot, frame, waypoints, places, rotation, (True,) * 6)
    turn = frame.tilt_rad / np.sqrt(3.0) - TURN_RESERVE
    return WithinTolerance(pose, np.array([*(LINE_ROOM,) * 3, *(turn,) * 3]))


def slide_tool(
    robot: RobotModel,
    hand: FrameMotion,
    waypoints: Int[np.ndarray, "S"] | Sequence[int],
    places: Float[np.ndarray, "#S 3"],
) -> Residual[MotionState]:
    """Return how far a tool that may slide is along its slide from its places [m]."""
    axes = (False, False, True, False, False, False)
    return _measure_off(robot, hand, waypoints, places, _find_slide_axes(hand), axes)


def _find_slide_axes(hand: FrameMotion) -> Float[np.ndarray, "3 3"]:
    """Return axes of the place's link whose third is along the slide; the link's own without a slide."""
    return np.eye(3) if hand.slide is None else find_rotation_onto(AXIS, hand.slide / np.linalg.norm(hand.slide))


def _measure_off(
    robot: RobotModel,
    hand: FrameMotion,
    waypoints: Int[np.ndarray, "S"] | Sequence[int],
    places: Float[np.ndarray, "#S 3"],
    rotation: Float[np.ndarray, "3 3"],
    axes: tuple[bool, ...],
) -> FramePose:
    """Return some components of a tool's pose relative to its places, in axes of the place's link."""
    targets, point = np.tile(np.eye(4), (len(places), 1, 1)), np.eye(4)
    at_place = np.eye(3) if hand.rotation is None else hand.rotation
    targets[:, :3, :3], targets[:, :3, 3] = rotation, places + at_place @ hand.point
    point[:3, 3] = hand.point
    target = targets if len(places) > 1 else targets[0]
    return FramePose(robot, hand.tool, waypoints, target, axes, hand.link, point)


def aim_tool(robot: RobotModel, hand: FrameMotion, waypoints: Int[np.ndarray, "S"]) -> AxisDirection:
    """Return how far a tool's axis leans from the direction that it should have."""
    return AxisDirection(robot, hand.tool, waypoints, AXIS, hand.axis, hand.turns_with)


def lean_tool(
    robot: RobotModel, hand: FrameMotion, way: Float[np.ndarray, "3"], waypoints: Int[np.ndarray, "S"]
) -> Residual[MotionState]:
    """Return how far a rod that pushes by its side leans too far along its way, and against it [rad]."""
    most = 0.5 * np.pi + hand.way_lean_rad
    angles = (AxisDirection(robot, hand.tool, waypoints, AXIS, sense * way, hand.turns_with) for sense in (1.0, -1.0))
    return Joined([NormWithin(angle, 2, most) for angle in angles])


def bring_tool(
    body: WholeBody, frames: Sequence[FrameMotion], guesses: Float[np.ndarray, "B n"], prescribed: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "B n"]:
    """Return the guesses with the tools where their motions begin, as far as they come near; others as they were.

    Planted links are at their places and joints within their limits; obstacles and balance are left to the optimiser.

    Args:
        body: the robot, with the mechanism that the tool may move with.
        frames: where the tools should be.
        guesses: configurations.
        prescribed: coordinates that keep their values.
    """
    holds = (*body.holds(), *_hold_all(body.robot, frames, 2, [0]))
    found, error = solve_holds(body, guesses, holds, prescribed)
    return np.where((error < NEAR)[:, None], found, guesses)


def follow_tool(
    body: WholeBody,
    frames: Sequence[FrameMotion],
    guess: Float[np.ndarray, "T n"],
    prescribed: Bool[np.ndarray, "n"],
    *,
    is_backwards: bool = False,
) -> Float[np.ndarray, "T n"] | None:
    """Return a path on which the tools are where they should be, one waypoint after the other; None where it cannot be.

    Each waypoint continues the two before it and is then brought to its place, with the planted links at theirs and the
    joints within their limits.  Nothing else is kept: obstacles and balance are left to the optimiser.

    Args:
        body: the robot, with the mechanism that the tool may move with.
        frames: where the tools should be.
        guess: the path begins at its first waypoint and steps as it does while there is nothing to continue.
        prescribed: coordinates that are as in the guess at every waypoint.
        is_backwards: whether the path begins at the guess' last waypoint instead.
    """
    path, count = guess.copy(), len(guess)
    order = range(count - 1, -1, -1) if is_backwards else range(count)
    for number in range(1, count):
        at, before = order[number], order[number - 1]
        step = path[before] - path[order[number - 2]] if number > 1 else guess[at] - guess[before]
        start = np.where(prescribed, guess[at], path[before] + step)
        holds = (*body.holds(), *_hold_all(body.robot, frames, count, [at]))
        found, error = solve_holds(body, start[None], holds, prescribed, FOLLOW_STEPS)
        if error[0] > FOLLOWED:
            return None
        path[at] = found[0]
    return path


def follow_in_balance(
    body: WholeBody,
    frames: Sequence[FrameMotion],
    path: Float[np.ndarray, "T n"],
    regions: Sequence[PlannedRegion],
    is_fixed: Bool[np.ndarray, "T"],
    prescribed: Bool[np.ndarray, "n"],
) -> Float[np.ndarray, "T n"]:
    """Return a path of tools with the centre of mass in the regions of its loads, as near as it was.

    The optimiser alone moves the centre of mass in many short steps, since the tool leaves its place in long ones: it
    is brought as far inside as is enough for position servos here, or as a small region allows.  Obstacles are left to
    the optimiser.

    Args:
        body: the robot, with the mechanism that the tool may move with.
        frames: where the tools are.
        path: with the tools at their places.
        regions: of the whole path.
        is_fixed: waypoints that stay as they are.
        prescribed: coordinates that keep their values.
    """
    least = body.aims.balance_margin + BALANCE_RESERVE + INSIDE_RESERVE
    middles = body.engine.place(path).com[:, :2].copy()
    for _ in range(2):  # stretches share the waypoints at their ends
        for planned in regions:
            part = slice(planned.first, planned.last + 1)
            polygon = planned.region.polygon
            deepest = INSIDE_SHARE * (polygon.depth - planned.shift_m)
            margin = planned.shift_m + max(least, min(RESERVE_M, deepest))
            middles[part] = _move_inside(polygon, middles[part], margin)
    free = np.flatnonzero(~is_fixed)
    held = (
        *body.holds(),
        *_hold_all(body.robot, frames, len(path), free),
        lambda waypoints: CentreOfMassAt(middles[free], waypoints),
    )
    moved = path.copy()
    moved[free] = project_within_limits(body.engine, path[free], held, *body.bounds(1, {}), prescribed)
    return moved


def _move_inside(polygon: SupportPolygon, points: Float[np.ndarray, "N 2"], margin: float) -> Float[np.ndarray, "N 2"]:
    """Return points moved onto the nearest borders of a polygon that is smaller by a margin, in a few rounds."""
    points = points.copy()
    for _ in range(INSIDE_ROUNDS):
        outside = points @ polygon.normals.T - polygon.offsets + margin
        edge = outside.argmax(axis=1)
        beyond = np.maximum(outside[np.arange(len(points)), edge], 0.0)
        if not beyond.any():
            break
        points -= beyond[:, None] * polygon.normals[edge]
    return points


def _hold_all(
    robot: RobotModel, frames: Sequence[FrameMotion], n_waypoints: int, waypoints: Int[np.ndarray, "S"] | Sequence[int]
) -> tuple[Hold, ...]:
    """Return the holds of tools where their motions have them at some of a phase's waypoints."""
    return tuple(
        hold for frame in frames for hold in _hold_at(robot, frame, frame.places(n_waypoints)[list(waypoints)])
    )


def _hold_at(robot: RobotModel, hand: FrameMotion, places: Float[np.ndarray, "#S 3"]) -> tuple[Hold, ...]:
    """Return the holds of a tool at one place, or at one per waypoint, and of its axis."""
    at_place: Hold = lambda waypoints: place_tool(robot, hand, waypoints, places)  # noqa: E731
    axis: Hold = lambda waypoints: aim_tool(robot, hand, waypoints)  # noqa: E731
    return (at_place,) if hand.turns_freely else (at_place, axis)
