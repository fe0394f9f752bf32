"""Whether a door or a mechanism that a request gives could be built: parts that hang in the air or fill each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import MechanismJoint
from costs.scene import ConvexPiece
from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from service.demands.mechanism.given import GivenMechanism
from service.verify import CoalSolid, DistanceQuery

MOST_OUT_M = 0.15  # of any part of a handle's bar in front of the leaf's face
BESIDE_LEAF_M = 0.02  # by which a bar's end may reach beyond the leaf's border
LEAST_ALONG_LEAF = 0.9  # cosine between a push bar and the leaf's width
# A moving part may be this deep in a still one: fronts lie flush in frames, hinges in posts, drawings are coarse.
MOST_INSIDE_M = 0.03
# Points this near to the axis of their joint, or to a line along it, are a shaft or a rod in a hole that is not drawn.
MOST_SHAFT_M = 0.05
WAY_STEPS = 8  # looked at per move


def list_door_problems(geometry: DoorGeometry) -> Iterator[str]:
    """Yield one line per place of a given door's handle that is not on its leaf, with the distance."""
    handle = geometry.handle
    if handle is None:
        return
    field = "task.door.handle"
    across, out, up = _place_on_leaf(geometry, handle.centre)
    where = f"{field}.centre: {np.round(handle.centre, 3).tolist()} is"
    if not 0.0 <= out <= MOST_OUT_M:
        side = "in front of" if out > 0.0 else "behind"
        yield f"{where} {abs(out):.2f} m {side} the leaf's face; expected 0 to {MOST_OUT_M:g} m in front of it"
        return
    for value, size, before, behind in (
        (across, geometry.width, "beside the hinge, off the leaf", "beyond the leaf's free edge"),
        (up, geometry.height, "below the leaf's lower edge", "above the leaf's top"),
    ):
        if not 0.0 <= value <= size:
            beyond = f"{-value:.2f} m {before}" if value < 0.0 else f"{value - size:.2f} m {behind}"
            yield f"{where} {beyond}; the leaf is {geometry.width:.2f} m wide and {geometry.height:.2f} m high"
            return
    yield from _list_bar_problems(geometry, handle)


def _list_bar_problems(geometry: DoorGeometry, handle: HandleGeometry) -> Iterator[str]:
    """Yield one line where the ends of a handle's bar are not before the leaf, or a push bar is not along it."""
    field = "task.door.handle"
    along = abs(float(handle.direction @ geometry.along))
    if handle.kind == "knob":
        return
    if handle.kind == "push_bar" and along < LEAST_ALONG_LEAF:
        degrees = float(np.rad2deg(np.arccos(min(along, 1.0))))
        yield f"{field}.direction: a push bar {degrees:.0f} deg off the leaf's width; expected along it"
        return
    shares = (1.0,) if handle.kind == "lever" else (-0.5, 0.5)
    for share in shares:
        end = handle.centre + share * handle.length * handle.direction
        across, out, up = _place_on_leaf(geometry, end)
        beside = max(-across, across - geometry.width, -up, up - geometry.height)
        what = f"{field}: the end of the {handle.kind.replace('_', ' ')}, {handle.length:g} m long, is"
        if beside > BESIDE_LEAF_M:
            yield f"{what} {beside:.2f} m beside the leaf; expected on it (centre, direction, length_m)"
            return
        if not 0.0 <= out <= MOST_OUT_M:
            side = "in front of" if out > 0.0 else "behind"
            yield f"{what} {abs(out):.2f} m {side} the leaf's face; expected 0 to {MOST_OUT_M:g} m in front (direction)"
            return


def _place_on_leaf(geometry: DoorGeometry, point: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Return a point's distance from the hinge along the leaf, before its face, and above its lower edge [m]."""
    offset = point - geometry.hinge
    return float(offset @ geometry.along), float(offset @ geometry.normal - geometry.face), float(offset @ UP)


def list_mechanism_problems(given: GivenMechanism, obstacles: Sequence[ConvexPiece]) -> Iterator[str]:
    """Yield a line for the part of a given mechanism that is inside what stands still at the start, and too deep.

    It is measured at the start and on the way.  What is met only on the way is in the way, and the planner says so.

    Args:
        given: the mechanism.
        obstacles: pieces that the request gives besides.
    """
    names = [joint.name for joint in given.mechanism.joints]
    deepest = max(_find_embedded(given, (*given.pieces, *obstacles)), key=lambda part: part.depth, default=None)
    if deepest is not None and deepest.depth > MOST_INSIDE_M:
        where = f"{deepest.piece} with {deepest.joint} at {deepest.values[names.index(deepest.joint)]:.3g}"
        yield (
            f"task.mechanism.urdf: {deepest.name} is {deepest.depth:.2f} m inside {where}; expected at most "
            f"{MOST_INSIDE_M:g} m (give what is hollow by its walls: a mesh counts as its hull)"
        )


@dataclass(frozen=True)
class _Embedded:
    """A moving body that overlaps a piece by ``depth`` with the joints at ``values`` [m]."""

    name: str
    joint: str
    piece: str
    values: Float[np.ndarray, "k"]
    depth: float


def _find_embedded(given: GivenMechanism, still: Sequence[ConvexPiece]) -> Iterator[_Embedded]:
    """Yield the overlaps of moving bodies and pieces at the start, and on the way of the moves of those pairs."""
    solids, query = [CoalSolid.of_piece(piece) for piece in still], DistanceQuery()
    low = np.array([piece.vertices.min(axis=0) for piece in still]).reshape(-1, 3)
    high = np.array([piece.vertices.max(axis=0) for piece in still]).reshape(-1, 3)
    for joint, name, way in _list_ways(given):
        rows = np.arange(len(still))
        for station, (values, vertices) in enumerate(way):
            near = np.all((low[rows] < vertices.max(axis=0)) & (high[rows] > vertices.min(axis=0)), axis=1)
            body = CoalSolid.of_piece(ConvexPiece(name, vertices)).convex
            depth = {row: -query.measure(body, solids[row].convex) for row in rows[near].tolist()}
            inside = [row for row, deep in depth.items() if deep > 0.0]
            yield from (_Embedded(name, joint.name, still[row].name, values, depth[row]) for row in inside)
            if station == 0:
                rows = np.array(inside, dtype=int)


def _list_ways(
    given: GivenMechanism,
) -> Iterator[tuple[MechanismJoint, str, list[tuple[Float[np.ndarray, "k"], Float[np.ndarray, "V 3"]]]]]:
    """Yield joint and name of every moving body but shafts, with values of all joints and its vertices there [m].

    The start comes first, then the way of the moves.
    """
    joints = given.mechanism.joints
    names = [joint.name for joint in joints]
    stations = [given.mechanism.start]
    for move in given.request.moves:
        column, values = names.index(move.joint), stations[-1]
        for share in np.arange(1, WAY_STEPS + 1) / WAY_STEPS:
            at = values.copy()
            at[column] += share * (move.to - values[column])
            stations.append(at)
    for joint in joints:
        poses = [given.locate(joint.name, values) for values in stations]
        for name, points in joint.bodies.items():
            if not _is_shaft(joint, points):
                own = points - joint.origin
                placed = [own @ pose[:3, :3].T + pose[:3, 3] for pose in poses]
                yield joint, name, list(zip(stations, placed, strict=True))


def _is_shaft(joint: MechanismJoint, points: Float[np.ndarray, "V 3"]) -> bool:
    """Return whether a body is a shaft about the axis of its joint, or a rod along the way that it slides."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    middle = joint.origin if joint.kind == "revolute" else 0.5 * (points.min(axis=0) + points.max(axis=0))
    offset = points - middle
    away = np.linalg.norm(offset - (offset @ axis)[:, None] * axis, axis=1)
    return bool(away.max() <= MOST_SHAFT_M)
