"""What forbids a grasp whatever the path: sentences that name the object, the piece, the hand or the joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot.carried import PlacedObject, with_objects
from costs.scene import ConvexPiece, Scene
from service.body.whole_body import WholeBody
from service.demands.grasping.gripper import Gripper
from service.demands.steps.holding import Holding
from service.explain.distance import find_out_of_reach
from service.setup.checks import describe_overload
from service.tasks.steps.choices import Pick
from service.verify import GRAVITY, REST_MARGIN_M, CoalSolid, DistanceQuery

ON_TOP_M = 0.01  # above an object, within which a piece rests on it
ON_TOP_SHARE = 0.5  # of an object's height that such a piece is above
JOINED_M = 1e-3  # between pieces that are one thing
INSIDE_M = 3e-3  # of an object in what it rests on
NEAR_M = 0.2  # of a hand's tool from an object's surface


def find_obstacle(
    body: WholeBody, holding: Holding, pick: Pick, put: Float[np.ndarray, "4 4"] | None, grippers: Sequence[Gripper]
) -> str | None:
    """Return a sentence on what forbids a grasp whichever it is; None where nothing does.

    Args:
        body: the robot before it.
        holding: the objects before it.
        pick: what is taken.
        put: (4, 4) where the object is let go; None where no step says so.
        grippers: that may take it.
    """
    item, step = pick.item.body, pick.step
    start = pick.places[0][0]
    above = _find_on_top(body, holding, pick)
    if above:
        return f"{item.name} is under {above}; that has to be taken away first"
    rests = [] if step.object in holding.held else [(start, "where it is")]
    brought = "" if put is None else f"where it is put, at {np.round(put[:3, 3], 3).tolist()}"
    if put is not None:
        rests.append((put, brought))
    for pose, where in rests:
        margin, names = holding.find_rest(item.name, pose)
        if margin >= REST_MARGIN_M:
            continue
        met = _find_inside(body, holding, item.name, pose)
        if met is not None and met[1] > INSIDE_M:
            return f"{item.name} does not rest {where}: it would be {1e3 * met[1]:.0f} mm inside {met[0]}"
        if not names:
            return f"{item.name} does not rest {where}: nothing is within 3 mm below it"
        return f"{item.name} does not rest {where}: {' and '.join(names)} would let it tip or slide"
    met = None if put is None else _find_inside(body, holding, item.name, put)
    if met is not None:
        return f"there is no place for {item.name} {brought}: it would be {1e3 * met[1]:.0f} mm inside {met[0]}"
    weak = [gripper for gripper in grippers if gripper.force_n < step.force_n]
    if weak:
        return (
            f"the fingers of the {weak[0].side} hand press with at most {weak[0].force_n:g} N, "
            f"and {item.name} is to be held with {step.force_n:g} N"
        )
    weight = GRAVITY * item.inertia.mass / (4 if step.hand == "both" else 2)  # of each finger
    if weight > holding.friction * step.force_n:
        need = f"with {weight / holding.friction:.0f} N" if holding.friction > 0.0 else "without end"
        return (
            f"{item.name} of {item.inertia.mass:g} kg is too heavy: each finger would have to press "
            f"{need} at a friction of {holding.friction:g}, it does with {step.force_n:g} N"
        )
    for pose, where in pick.places:
        radius = float(np.linalg.norm(item.vertices, axis=1).max()) + NEAR_M
        reasons = [find_out_of_reach(body, gripper.tool, pose[:3, 3], radius) for gripper in grippers]
        if all(reasons):
            return f"{item.name} is out of reach {where}: {reasons[0]}"
    return None


def describe_weight(body: WholeBody, holding: Holding, name: str, q: Float[np.ndarray, "n"]) -> str | None:
    """Return which joint cannot hold an object that one hand carries; None where all can."""
    hold = holding.held.get(name)
    if hold is None or len(hold.grippers) > 1:
        return None
    line = describe_overload(holding.placed, q[: holding.robot.n], tuple(foot.link for foot in body.planted))
    return (
        None if line is None else f"{name} of {holding.items[name].body.inertia.mass:g} kg is too heavy there: {line}"
    )


def _find_on_top(body: WholeBody, holding: Holding, pick: Pick) -> str:
    """Return the pieces and objects that lie on the object, joined by a word; empty where none does.

    A piece that touches others beside it or above is built in, as the walls of a socket are.
    """
    own, pose = pick.item.body, pick.places[0][0]
    vertices = own.vertices @ pose[:3, :3].T + pose[:3, 3]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    boxes = [(piece.name, piece.lower, piece.upper) for piece in body.scene.pieces]
    for name, other in holding.resting.items():
        if name != own.name:
            corners = holding.items[name].body.vertices @ other[:3, :3].T + other[:3, 3]
            boxes.append((name, corners.min(axis=0), corners.max(axis=0)))
    names = []
    for name, lower, upper in boxes:
        overlaps = np.all(lower[:2] < high[:2] - 1e-3) and np.all(upper[:2] > low[:2] + 1e-3)
        is_above = lower[2] > low[2] + ON_TOP_SHARE * (high[2] - low[2])
        if overlaps and is_above and abs(lower[2] - high[2]) < ON_TOP_M:
            names.append(name)
    pieces = {piece.name: piece for piece in body.scene.pieces}
    return " and ".join(name for name in names if name not in pieces or not is_built_in(pieces[name], body.scene))


def is_built_in(piece: ConvexPiece, scene: Scene) -> bool:
    """Return whether a piece touches another one that is not below it."""
    query, own = DistanceQuery(), CoalSolid.of_piece(piece)
    for other in scene.pieces:
        is_near = np.all(other.lower < piece.upper + JOINED_M) and np.all(other.upper > piece.lower - JOINED_M)
        if other.name == piece.name or not is_near or other.upper[2] < piece.lower[2] + JOINED_M:
            continue
        if query.measure(own.convex, CoalSolid.of_piece(other).convex) < JOINED_M:
            return True
    return False


def _find_inside(
    body: WholeBody, holding: Holding, name: str, pose: Float[np.ndarray, "4 4"]
) -> tuple[str, float] | None:
    """Return in what an object would be deepest where it is put, and how deep [m]; None where in nothing."""
    placed = with_objects(holding.robot, [PlacedObject(holding.items[name].body, None, pose)])
    own = CoalSolid.of_body(placed.bodies[-1])
    below = holding.find_rest(name, pose)[1]
    query, worst = DistanceQuery(), None
    others = holding.list_resting(name)
    for piece in (*body.scene.pieces, *others):
        if np.any(piece.lower > own.vertices.max(axis=0)) or np.any(piece.upper < own.vertices.min(axis=0)):
            continue
        depth = -query.measure(own.convex, CoalSolid.of_piece(piece).convex)
        if depth > (INSIDE_M if piece.name in below else 1e-6) and (worst is None or depth > worst[1]):
            worst = piece.name, depth
    return worst
