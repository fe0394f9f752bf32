"""Paths on plane faces as phases: reach, approach, the path with its rounded corners, retreat."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.guide import Guide
from costs.robot import RobotModel
from costs.rotation import turn_towards
from service.demands.regions import find_axis
from service.demands.steps.blends import choose_cuts, round_corner
from service.demands.steps.faces import find_middle, lean_tool, list_places, point_axis
from service.demands.steps.frames import Company, allow, find_frames, keep_others, locate, make_thrust, read_limits
from service.demands.steps.phases import Led, PhaseMaker, StepPhase
from service.demands.targets import make_pose_goal
from service.errors import RequestError
from service.request.fields import HAND_FRICTION
from service.request.tasks.hand_steps import FollowStep
from service.request.tasks.reach import GoalRequest
from service.verify import HandLoad

STEEPEST_DEG = float(np.rad2deg(np.arctan(HAND_FRICTION[0])))  # lean of a tool that is pressed onto a face
OFF_FACE_M = 1e-4  # tolerance of where a line to a face begins


def list_follow(robot: RobotModel, company: Company, step: FollowStep, name: str) -> Iterator[PhaseMaker]:
    """Yield the phases of a path on a face: reach, approach, the path, retreat."""
    (frame,) = find_frames(robot, step.hand, step.frame)
    normal = np.asarray(step.face.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    axis = lean_tool(-normal, step)
    places = list_places(step, normal)
    off = -step.approach_m * axis

    def begin(q: Float[np.ndarray, "n"]) -> StepPhase:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = point_axis(step.tool_axis, axis), places[0] + off
        goal = make_pose_goal(frame, pose, OFF_FACE_M, 0.1, step.tool_axis[-1])
        kept = keep_others(robot, company, q, (frame,), step.other_hand)
        return StepPhase(f"{name}: reach", goal=GoalRequest(poses=(goal,)), **kept)  # type: ignore[arg-type]

    yield PhaseMaker(f"{name}: reach", begin)
    ways = [_PathPart("approach", lambda R: Guide.line(places[0] + off, R, -off), is_path=False)]
    if step.circle is not None:
        middle, angle = find_middle(step, normal), float(np.deg2rad(step.circle.angle_deg))
        sense = -1.0 if step.circle.sense == "clockwise" else 1.0
        ways.append(_PathPart("path", lambda R: Guide.screw(places[0], R, middle, normal, sense * angle, turns=False)))
    else:
        ways += _list_lines(np.stack(places), step.blend_m)
    end = places[-1] if step.circle is None else ways[-1].guide(np.eye(3)).positions(np.ones(1))[0]
    ways.append(_PathPart("retreat", lambda R: Guide.line(end, R, off), is_path=False))
    touches = allow(robot, frame, step.face.pieces, max(step.depth_m, 0.0) + step.touch_depth_m)
    if step.thrust_n and step.tilt_deg > STEEPEST_DEG:
        raise RequestError(
            f"follow.tilt_deg: {step.tilt_deg:g} deg with a thrust_n: the tool would slide off; expected at most "
            f"{STEEPEST_DEG:.1f} deg, the angle of friction of {HAND_FRICTION[0]:g}, or no thrust"
        )
    for part in ways:
        own = f"{name}: {part.name}"
        yield PhaseMaker(own, partial(_make_part, robot, company, step, own, frame, axis, part, touches))


@dataclass(frozen=True)
class _PathPart:
    """One line or arc of a path.

    Attributes:
        name: of it.
        guide: the way, given the orientation of the tool.
        is_path: whether the tool is on the face.
        flows: whether the next part goes on without a rest.
        is_entered: whether it goes on from the part before without a rest.
        is_corner: whether it rounds a corner.
    """

    name: str
    guide: Callable[[Float[np.ndarray, "3 3"]], Guide]
    is_path: bool = True
    flows: bool = False
    is_entered: bool = False
    is_corner: bool = False


def _list_lines(places: Float[np.ndarray, "P 3"], blend_m: float) -> Iterator[_PathPart]:
    """Yield the lines of a polyline, and the arcs at its corners if these are rounded."""
    cuts, steps = choose_cuts(places, blend_m), np.diff(places, axis=0)
    for k, step in enumerate(steps):
        name = "path" if len(steps) == 1 else f"path {k + 1}"
        into = step / np.linalg.norm(step)
        first, last = places[k] + cuts[k] * into, places[k + 1] - cuts[k + 1] * into
        yield _PathPart(
            name, partial(Guide.line, first, shift=last - first), flows=cuts[k + 1] > 0.0, is_entered=cuts[k] > 0.0
        )
        if cuts[k + 1]:
            arc = round_corner(last, np.eye(3), step, steps[k + 1], float(cuts[k + 1]))
            assert arc is not None
            yield _PathPart(f"corner {k + 1}", partial(_turn_tool, arc), flows=True, is_entered=True, is_corner=True)


def _turn_tool(guide: Guide, rotation: Float[np.ndarray, "3 3"]) -> Guide:
    """Return a way with another orientation of the tool at its beginning."""
    return replace(guide, rotation=rotation)


def _make_part(
    robot: RobotModel,
    company: Company,
    step: FollowStep,
    name: str,
    frame: str,
    axis: Float[np.ndarray, "3"],
    part: _PathPart,
    touches: tuple[Allowance, ...],
    q: Float[np.ndarray, "n"],
) -> StepPhase:
    """Return one line or arc of a path; the tool keeps the turn about its axis, or is free to turn."""
    here = locate(robot, q, frame)[:3, :3]
    about = find_axis(step.tool_axis)
    assert about is not None
    rotation = turn_towards(point_axis(step.tool_axis, axis)[None], here[None], about)[0]
    limits = {**read_limits(step), **({} if part.is_path else {"speed_m_s": None})}
    free = about if step.turn == "free" else None
    led = Led(frame, part.guide(rotation), free_axis=free, is_corner=part.is_corner, **limits)  # type: ignore[arg-type]
    keeping = keep_others(robot, company, q, (frame,), step.other_hand)
    loads: tuple[HandLoad, ...] = ()
    if part.is_path and step.thrust_n:
        thrust = make_thrust(frame, led.guide, step.thrust_n * axis)
        loads = (replace(thrust, across_n=step.across_n, twist_nm=step.twist_nm),)
    made = StepPhase(name, (led,), touches=touches, loads=loads, **keeping)  # type: ignore[arg-type]
    return replace(made, flows=part.flows, is_entered=part.is_entered)
