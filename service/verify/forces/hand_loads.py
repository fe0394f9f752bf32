"""Wrenches on the robot of the loads that its hands carry, from the mechanism's own coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.curve import Curve
from costs.robot.model import RobotModel
from costs.work_space import borrow_data
from service.verify.forces.equilibrium import list_slid_loads, list_turned_loads
from service.verify.motion import WORLD, HandLoad, Motion, VerifyError

STILL = 1e-5  # by which a joint at rest may be off [rad, m]


def bound_coordinate(curve: Curve, column: int, first: float, last: float) -> tuple[float, float]:
    """Return the least and greatest value of a coordinate between two path parameters, exactly [rad, m]."""
    values = curve(_list_extremes(curve, column, first, last))[:, column]
    return float(values.min()), float(values.max())


def measure_retreat(curve: Curve, column: int, first: float, last: float) -> float:
    """Return by how much a coordinate goes back on its way between two path parameters, exactly [rad, m]."""
    values = curve(_list_extremes(curve, column, first, last))[:, column]
    values = values if values[-1] >= values[0] else -values
    return float((np.maximum.accumulate(values) - values).max())


def _list_extremes(curve: Curve, column: int, first: float, last: float) -> Float[np.ndarray, "P"]:
    """Return the ends of a stretch, its knots and where a coordinate's derivative vanishes, in order."""
    knots, coefficients = curve.knots, curve.coefficients()
    places = [first, last, *knots[(knots > first) & (knots < last)].tolist()]
    for k in np.flatnonzero((knots[1:] >= first) & (knots[:-1] <= last)).tolist():
        _, c1, c2, c3 = (float(part[k, column]) for part in coefficients)
        roots = np.roots([3.0 * c3, 2.0 * c2, c1]) if c3 or c2 else np.zeros(0)
        at = [root.real + knots[k] for root in roots if abs(root.imag) < 1e-12]
        low, high = max(first, knots[k]), min(last, knots[k + 1])
        places += [s for s in at if low < s < high]
    return np.sort(np.array(places))


def list_load_wrenches(
    motion: Motion, loads: tuple[HandLoad, ...], first: float, last: float
) -> Float[np.ndarray, "G 6"]:
    """Return wrenches on the robot whose convex hull has those of all loads on a stretch, of any size down to zero.

    Raises:
        VerifyError: more than one joint that carries the loads moves on the stretch, or a link is unknown.
    """
    model = motion.robot.model
    moving, span = _find_moving_joint(motion, loads, first, last)
    q = motion.curve(np.array([first]))[0].copy()
    if moving is not None:
        q[int(model.joints[moving].idx_q)] = 0.0
    data = borrow_data(model)
    pin.framesForwardKinematics(model, data, q)
    corners = [_corners_of(motion, data, load, moving, span) for load in loads]
    wrenches = [np.zeros((1, 6))]
    for choice in product(*corners):  # where each load acts on its slide
        for share in product((0.0, 1.0), repeat=len(loads)):
            if any(share):
                wrenches.append(np.sum([s * part for s, part in zip(share, choice, strict=True)], axis=0))
    return np.unique(np.concatenate(wrenches), axis=0)


def _find_moving_joint(
    motion: Motion, loads: tuple[HandLoad, ...], first: float, last: float
) -> tuple[int | None, tuple[float, float]]:
    """Return the only joint that moves one of the loaded links on a stretch, or None, and what it goes through."""
    model, moving = motion.robot.model, dict[int, tuple[float, float]]()
    for joint in {joint for load in loads for joint in _list_carrying(motion, load)}:
        span = bound_coordinate(motion.curve, int(model.joints[joint].idx_q), first, last)
        if span[1] - span[0] > STILL:
            moving[joint] = span
    if len(moving) > 1:
        names = ", ".join(model.names[joint] for joint in sorted(moving))
        raise VerifyError(f"{names} move at once; loads can be followed while one joint moves")
    return next(iter(moving.items()), (None, (0.0, 0.0)))


def _list_carrying(motion: Motion, load: HandLoad) -> list[int]:
    """Return the joints that carry the link of a load (VerifyError where there is no such link)."""
    model = motion.robot.model
    if not model.existFrame(load.link):
        raise VerifyError(f"unknown link '{load.link}' of a load")
    joints = list[int]()
    above = int(model.frames[model.getFrameId(load.link)].parentJoint)
    while above > 0:
        joints.append(above)
        above = int(model.parents[above])
    return joints


def _corners_of(
    motion: Motion, data: pin.Data, load: HandLoad, moving: int | None, span: tuple[float, float]
) -> Iterator[Float[np.ndarray, "K 6"]]:
    """Yield the corners of one load's wrenches, once per end of its slide."""
    model = motion.robot.model
    chain = _list_carrying(motion, load)
    if load.link == WORLD:
        count = 1 if moving is None else _count_corners(model, moving, span)
        for wrench in list_world_wrenches(load):
            yield np.tile(wrench, (count, 1))
        return
    pose = data.oMf[model.getFrameId(load.link)]
    force = -pose.rotation @ load.force
    slides = [np.zeros(3)] if load.slide is None else [-load.slide, load.slide]
    for slide in slides:
        point = pose.rotation @ (load.place + slide) + pose.translation
        if moving is None:
            yield np.concatenate([force, np.cross(point, force)])[None]
            continue
        axis = _read_axis(model, moving)
        if moving not in chain:
            fixed = np.concatenate([force, np.cross(point, force)])
            yield np.tile(fixed, (_count_corners(model, moving, span), 1))
        elif np.any(axis[3:]):
            turned = data.oMi[moving].rotation @ axis[3:]
            yield list_turned_loads(force, point, turned, np.array(data.oMi[moving].translation), *span)
        else:
            yield list_slid_loads(force, point, data.oMi[moving].rotation @ axis[:3], *span)


def _read_axis(model: pin.Model, moving: int) -> Float[np.ndarray, "6"]:
    """Return the last column of a joint's motion: linear, then angular."""
    joint = model.joints[moving]
    made = joint.createData()
    joint.calc(made, np.zeros(model.nq), np.zeros(model.nv))
    return np.asarray(made.S).reshape(6, -1)[:, -1]


def _count_corners(model: pin.Model, moving: int, span: tuple[float, float]) -> int:
    """Return how many corners a load has that a joint moves; those that it does not move have as many."""
    if not np.any(_read_axis(model, moving)[3:]):
        return 2
    up, away = np.array([0.0, 0.0, 1.0]), np.ones(3)
    return len(list_turned_loads(up, away, up, away, *span))


def list_world_wrenches(load: HandLoad) -> list[Float[np.ndarray, "6"]]:
    """Return wrenches on the robot about the world's origin whose hull, with none, has those of a load on the world."""
    slides = [np.zeros(3)] if load.slide is None else [-load.slide, load.slide]
    wrenches = []
    for slide in slides:
        for off in list_offsets(load):
            point = load.place + slide + off
            for part in list_parts(load):
                wrenches.append(-np.concatenate([part[:3], np.cross(point, part[:3]) + part[3:]]))
    return wrenches


def list_parts(load: HandLoad) -> Float[np.ndarray, "K 6"]:
    """Return corners of what a load exerts at its place: force and moment, in the axes of its link [N, N m].

    Their hull, with none, has the force of any size up to its largest, with any force across it and any moment about
    it up to theirs.
    """
    if not load.across_n and not load.twist_nm:
        return np.concatenate([load.force, np.zeros(3)])[None]
    axis = load.force / np.linalg.norm(load.force)
    sides = load.across_n * _list_square(axis) if load.across_n else np.zeros((1, 3))
    turns = load.twist_nm * np.outer([1.0, -1.0], axis) if load.twist_nm else np.zeros((1, 3))
    return np.array(
        [np.concatenate([share * load.force + side, turn]) for share in (0.0, 1.0) for side in sides for turn in turns]
    )


def measure_most(load: HandLoad) -> float:
    """Return the largest force of a load, with what acts across it [N]."""
    return float(np.linalg.norm(list_parts(load)[:, :3], axis=1).max())


def _list_square(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 3"]:
    """Return corners of a square across a unit direction that holds all vectors across it of length 1."""
    side = np.eye(3)[int(np.abs(axis).argmin())]
    x = side - (side @ axis) * axis
    x /= np.linalg.norm(x)
    y = np.cross(axis, x)
    return np.array([x + y, x - y, y - x, -x - y])


def list_offsets(load: HandLoad) -> Float[np.ndarray, "4 3"]:
    """Return corners of a square across a load on the world that holds all places within its drift [m]."""
    return np.asarray(load.drift_m * _list_square(load.force / np.linalg.norm(load.force)))


def list_drifting(loads: tuple[HandLoad, ...]) -> tuple[HandLoad, ...]:
    """Return the loads whose drift counts beside their wrenches: that of loads on the world is in these already."""
    return tuple(load for load in loads if load.link != WORLD)


@dataclass(frozen=True)
class LoadCase:
    """Wrench on the robot and what carries it, at samples of the curve.

    Attributes:
        wrench: (S, 6) force and moment about the world's origin [N, Nm].
        parts: per load, the joint that carries its tool and its wrench (S, 6).
    """

    wrench: Float[np.ndarray, "S 6"]
    parts: tuple[tuple[int, Float[np.ndarray, "S 6"]], ...]


def list_load_cases(
    robot: RobotModel, q: Float[np.ndarray, "S n"], loads: tuple[HandLoad, ...]
) -> tuple[LoadCase, ...]:
    """Return no load, and every combination of the corners of loads, at configurations; the last one has all of them.

    The force of a load that slides acts where the tool is on the slide.

    Raises:
        VerifyError: a load names a tool or a link that the robot does not have.
    """
    if not loads:
        return (LoadCase(np.zeros((len(q), 6)), ()),)
    model, data = robot.model, borrow_data(robot.model)
    for name in (name for load in loads for name in (load.tool, load.link)):
        if not model.existFrame(name):  # pinocchio reads beyond its frames otherwise
            raise VerifyError(f"unknown frame '{name}' of a load")
    tools, links = [model.getFrameId(load.tool) for load in loads], [model.getFrameId(load.link) for load in loads]
    joints = [int(model.frames[tool].parentJoint) for tool in tools]
    turns, points = np.zeros((len(loads), len(q), 3, 3)), np.zeros((len(loads), len(q), 3))
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for index, load in enumerate(loads):
            pose = pin.updateFramePlacement(model, data, links[index])
            place = load.place
            if load.link == WORLD:
                place = _bring_near(load, pin.updateFramePlacement(model, data, tools[index]).translation)
            elif load.slide is not None:
                tool = pin.updateFramePlacement(model, data, tools[index]).translation
                place = _slide_to(load, pose.rotation.T @ (tool - pose.translation))
            turns[index, k] = pose.rotation
            points[index, k] = turns[index, k] @ place + pose.translation
    exerted = [_place_parts(list_parts(load), *placed) for load, *placed in zip(loads, turns, points, strict=True)]
    cases = []
    for choice in product(*((None, *own) for own in exerted)):
        acting = tuple((joint, wrench) for joint, wrench in zip(joints, choice, strict=True) if wrench is not None)
        total = np.sum([wrench for _, wrench in acting], axis=0) if acting else np.zeros((len(q), 6))
        cases.append(LoadCase(total, acting))
    return tuple(cases)


def _place_parts(
    parts: Float[np.ndarray, "K 6"], turn: Float[np.ndarray, "S 3 3"], point: Float[np.ndarray, "S 3"]
) -> Float[np.ndarray, "K S 6"]:
    """Return what the robot bears of a load's corners, whose link is turned and that act at a point of the world."""
    forces, moments = (-np.einsum("sij,kj->ksi", turn, own) for own in (parts[:, :3], parts[:, 3:]))
    return np.concatenate([forces, np.cross(point[None], forces) + moments], axis=2)


def _bring_near(load: HandLoad, tool: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return where a load on the world acts: at the tool, no farther from its place or slide than its drift [m]."""
    near = load.place if load.slide is None else _slide_to(load, tool)
    off = np.asarray(tool - near)
    return np.asarray(near + off * min(1.0, load.drift_m / max(float(np.linalg.norm(off)), 1e-12)))


def _slide_to(load: HandLoad, tool: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the place on a load's slide that is nearest to the tool, both in the load's link [m]."""
    slide = np.zeros(3) if load.slide is None else load.slide
    square = float(slide @ slide)
    share = float(np.clip((tool - load.place) @ slide / square, -1.0, 1.0)) if square > 0.0 else 0.0
    return np.asarray(load.place + share * slide)
