"""Choices of hands and grasps for taking an object: what suits it, and what is reached wherever it goes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.kinematics import locate_frame, locate_links
from costs.robot import LinkBody, RobotModel
from costs.scene import ConvexPiece
from costs.terms import FramePose
from service.body.holds import Hold
from service.body.inverse_kinematics import solve_holds
from service.body.poses import posture_guesses
from service.body.whole_body import WholeBody
from service.demands.grasping.grasps import Grasp, close_on, generate_poses, list_grasps
from service.demands.grasping.gripper import Gripper
from service.demands.steps.holding import Item
from service.request.tasks.step_objects import GraspStep
from service.verify import GRAVITY, CoalSolid, DistanceQuery, make_coal_convex

REACHED = 5e-3  # largest residual of a pose that counts as reached [m, rad]
MOST_TRIED = 48  # grasps whose poses inverse kinematics looks for
MOST_CHOICES = 6  # of them that are planned; once so many are reached with all links apart, no more are looked for
STEEPEST = 0.4  # largest upward part of the way on which a hand comes
SEEDS = 2  # configurations from which inverse kinematics starts
SPANS = (0.5, 0.4, 0.6, 0.3, 0.7, 0.8)  # between two hands on a long object [m]
OUTSIDE_M = 0.05  # of the centre of mass from the support polygon in a configuration that counts as reached
SLIPPING_RAD = 20.0  # the same of one in which the object turns in the fingers
INSIDE_RAD = 10.0  # by which a configuration in which links meet counts as farther away, over all joints
ROOM_M = 5e-4  # between a hand and what stands around
ASIDE = (0.25, -0.25, 0.4, -0.4)  # of its length, off the middle of an object
SPAN_ROOM_M = 0.05  # of a hand from the end of such an object


@dataclass(frozen=True, eq=False)
class Pick:
    """An object that hands are to take.

    Attributes:
        item: the object.
        step: that takes it.
        places: (4, 4) poses in the world where it is taken and brought until it is let go, each with words for where.
        holder: bodies of the hand that holds it as it is taken, in the world.
    """

    item: Item
    step: GraspStep
    places: tuple[tuple[Float[np.ndarray, "4 4"], str], ...]
    holder: tuple[ConvexPiece, ...] = ()


@dataclass(frozen=True, eq=False)
class Choice:
    """Grasps of one hand or of two that carry an object together, the leading one first."""

    grasps: tuple[Grasp, ...]

    @property
    def grippers(self) -> tuple[Gripper, ...]:
        """The hands."""
        return tuple(grasp.gripper for grasp in self.grasps)

    def describe(self) -> str:
        """Return the choice in words."""
        words = [f"the {grasp.gripper.side} hand" for grasp in self.grasps]
        numbered = [f"grasp {grasp.number}" for grasp in self.grasps if grasp.number is not None]
        return " and ".join(words) + (f" at {' and '.join(numbered)}" if numbered else "")


def list_choices(pick: Pick, grippers: Sequence[Gripper]) -> tuple[list[Choice], tuple[str, ...]]:
    """Return the grasps that suit the hands, and phrases why others do not."""
    if pick.step.hand == "both":
        return _list_pairs(pick, grippers)
    choices, refused = list[Choice](), list[str]()
    for gripper in grippers:
        grasps, reasons = list_grasps(pick.item.body, gripper, pick.item.given.grasps, pick.step.opening_m)
        wanted = (grasp for grasp in grasps if pick.step.grasp is None or grasp.number == pick.step.grasp)
        choices += [Choice((grasp,)) for grasp in wanted]
        refused += reasons
    return choices, tuple(dict.fromkeys(refused))


def list_off_middle(pick: Pick, grippers: Sequence[Gripper]) -> list[Choice]:
    """Return grasps of one hand off the middle of an object, along its longest side; none where a grasp is given."""
    if pick.step.hand == "both" or pick.step.grasp is not None or pick.item.given.grasps:
        return []
    size = np.ptp(pick.item.body.vertices, axis=0)
    axis = np.eye(3)[int(size.argmax())]
    made = (_list_beside(pick, gripper, axis, share * float(size.max())) for gripper in grippers for share in ASIDE)
    return [Choice((grasp,)) for grasps in made for grasp in grasps if not isinstance(grasp, str)]


def _list_pairs(pick: Pick, grippers: Sequence[Gripper]) -> tuple[list[Choice], tuple[str, ...]]:
    """Return grasps of two hands beside each other along the longest side of an object, either leading."""
    first, second = grippers
    size = np.ptp(pick.item.body.vertices, axis=0)
    length, axis = float(size.max()), np.eye(3)[int(size.argmax())]
    choices, refused = [], list[str]()
    for span in SPANS:
        if span > length - 2.0 * SPAN_ROOM_M:
            continue
        for sense in (1.0, -1.0):
            offsets = ((first, 0.5 * sense * span), (second, -0.5 * sense * span))
            sides = [list(_list_beside(pick, gripper, axis, offset)) for gripper, offset in offsets]
            refused += [reason for side in sides for reason in side if isinstance(reason, str)]
            for one in sides[0]:
                for other in sides[1]:
                    if isinstance(one, str) or isinstance(other, str):
                        continue
                    if np.allclose(one.along, other.along):
                        choices.append(Choice((one, other)))
    if not choices and not refused:
        refused.append(f"{1e3 * length:.0f} mm long; two hands need {1e3 * (min(SPANS) + 2 * SPAN_ROOM_M):.0f} mm")
    return choices, tuple(dict.fromkeys(refused))


def _list_beside(pick: Pick, gripper: Gripper, axis: Float[np.ndarray, "3"], offset: float) -> Iterator[Grasp | str]:
    """Yield the grasps across an axis of an object, off its middle; phrases for those that do not suit the hand."""
    for pose in generate_poses(pick.item.body, gripper):
        closing, along = pose[:3, :3] @ gripper.closing, pose[:3, 2]
        if max(abs(closing @ axis), abs(along @ axis)) > 1e-6:
            continue
        moved = pose.copy()
        moved[:3, 3] += offset * axis
        made = close_on(pick.item.body, gripper, moved, pick.step.opening_m)
        yield made if isinstance(made, str) else Grasp(gripper, moved, *made)


def rank_choices(body: WholeBody, pick: Pick, choices: Sequence[Choice], friction: float) -> list[Choice]:
    """Return the choices that are reached wherever the object goes, the nearest to the nominal pose first.

    Those whose links would meet something, and those in which the object would turn between the fingers at the given
    friction, come later.  Obstacles and balance are left out.
    """
    poses = locate_links(body.engine, body.nominal, sorted({g.tool for choice in choices for g in choice.grippers}))
    ahead = sorted(choices, key=lambda choice: _measure_turn(pick, choice, poses))
    ranked, n_clear = list[tuple[float, Choice]](), 0
    for choice in ahead[:MOST_TRIED]:
        if n_clear == MOST_CHOICES:
            break
        if any(_comes_from_below(choice, place) for place, _ in pick.places):
            continue
        guesses = [_open_fingers(body, choice, q) for q in (body.nominal, *(q for _, q in posture_guesses(body)[1:]))]
        nominal = before = guesses[0]
        effort, n_inside = 0.0, 0
        for place, _ in pick.places:
            q = _reach(body, choice, place, guesses)
            if q is None:
                break
            effort += float(np.abs(q - before).sum())
            n_inside += body.measure_nearest(q) < 0.0
            guesses, before = [q, nominal], q
        else:
            effort += SLIPPING_RAD * _turns_in_fingers(pick, choice, friction)
            ranked.append((effort + INSIDE_RAD * n_inside, choice))
            n_clear += n_inside == 0
    ranked.sort(key=lambda entry: entry[0])
    return [choice for _, choice in ranked]


def hold_grasps(body: WholeBody, choice: Choice, pose_world_item: Float[np.ndarray, "4 4"]) -> tuple[Hold, ...]:
    """Return the holds of the choice's tools on an object at a pose."""
    return tuple(
        lambda waypoints, grasp=grasp: FramePose(
            body.robot, grasp.gripper.tool, waypoints, pose_world_item @ grasp.pose_object_tool
        )
        for grasp in choice.grasps
    )


def _turns_in_fingers(pick: Pick, choice: Choice, friction: float) -> bool:
    """Return whether an object held off its middle turns between the pads of one hand, where it is taken."""
    if len(choice.grasps) > 1:
        return False
    grasp, item = choice.grasps[0], pick.item.body
    gripper, pose = grasp.gripper, grasp.pose_object_tool
    middle = pose[:3, 3] + 0.5 * sum(gripper.pads) * pose[:3, 2]
    down = -pick.places[0][0][2, :3]
    moment = (
        GRAVITY * item.inertia.mass * np.cross(item.inertia.centre - middle, down) @ (pose[:3, :3] @ gripper.closing)
    )
    radius = 0.25 * abs(gripper.pads[1] - gripper.pads[0])
    return bool(abs(moment) > 2.0 * friction * pick.step.force_n * radius)


def _open_fingers(body: WholeBody, choice: Choice, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Return a configuration with the hands open as they come to the object."""
    opened = q.copy()
    for joint, value in (entry for grasp in choice.grasps for entry in grasp.opened.items()):
        opened[body.robot.joint_names.index(joint)] = value
    return opened


def _reach(
    body: WholeBody,
    choice: Choice,
    pose_world_item: Float[np.ndarray, "4 4"],
    guesses: Sequence[Float[np.ndarray, "n"]],
) -> Float[np.ndarray, "n"] | None:
    """Return a configuration with the tools on an object; None where none of the guesses leads to one.

    One with the centre of mass over the middle of the feet comes first.
    """
    fixed = np.zeros(body.robot.n, dtype=bool)
    holds = (*body.holds(), *hold_grasps(body, choice, pose_world_item))
    for more in dict.fromkeys((body.hold_in_balance(), ())):
        found, error = solve_holds(body, np.array(guesses[:SEEDS]), (*holds, *more), fixed)
        best = int(error.argmin())
        if error[best] < REACHED and _measure_outside(body, found[best]) < OUTSIDE_M:
            return np.asarray(found[best])
    return None


def _measure_outside(body: WholeBody, q: Float[np.ndarray, "n"]) -> float:
    """Return how far the centre of mass is outside the support polygon [m]; negative infinity without one."""
    if body.polygon is None:
        return -np.inf
    com = body.engine.place(q[None]).com[0, :2]
    return float((body.polygon.normals @ com - body.polygon.offsets).max())


def find_blocked(body: WholeBody, pick: Pick, choice: Choice) -> str | None:
    """Return which part of an open hand would be inside what stands around the object, where it is or is brought."""
    query = DistanceQuery()
    shapes = [(grasp, list(list_hand_shapes(body.robot, grasp))) for grasp in choice.grasps]
    for number, (end, where) in enumerate(pick.places):
        around = (*body.scene.pieces, *(pick.holder if number == 0 else ()))
        for grasp, parts in shapes:
            pose = end @ grasp.pose_object_tool
            turned, moved = pose[:3, :3], pose[:3, 3]
            for name, points in parts:
                own = points @ turned.T + moved
                low, high = own.min(axis=0), own.max(axis=0)
                for piece in around:
                    if np.any(piece.lower > high + ROOM_M) or np.any(piece.upper < low - ROOM_M):
                        continue
                    # The hull in the tool's frame is the same for every grasp: it is made once.
                    hull, solid = make_coal_convex(points), CoalSolid.of_piece(piece).convex
                    depth = -query.measure(hull, solid, turned, moved)
                    if depth > -ROOM_M:
                        which = "the grasps" if grasp.number is None else f"grasp {grasp.number}"
                        inside = f"{name} {1e3 * max(depth, 0.0):.0f} mm inside {piece.name}"
                        return f"{which} of {pick.item.name} would have {inside} {where}"
    return None


def list_holder(robot: RobotModel, gripper: Gripper, q: Float[np.ndarray, "n"]) -> Iterator[ConvexPiece]:
    """Yield the bodies of a hand and its fingers in the world at a configuration."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    for part in _list_parts(robot, gripper):
        place = data.oMi[part.joint]
        yield ConvexPiece(part.name, part.vertices @ place.rotation.T + place.translation)


def _list_parts(robot: RobotModel, gripper: Gripper) -> Iterator[LinkBody]:
    fingers = {locate_frame(robot, finger)[0] for finger in gripper.fingers}
    palms = {gripper.link, gripper.front}
    return (part for part in robot.bodies if part.joint in fingers or part.link in palms)


def list_hand_shapes(robot: RobotModel, grasp: Grasp) -> Iterator[tuple[str, Float[np.ndarray, "V 3"]]]:
    """Yield the bodies of an open hand and its fingers by name, in the tool frame [m]."""
    model = robot.model
    data, q = model.createData(), np.zeros(robot.n)
    for joint, value in grasp.opened.items():
        q[robot.joint_names.index(joint)] = value
    pin.framesForwardKinematics(model, data, q)
    tool = data.oMf[model.getFrameId(grasp.gripper.tool)]
    for part in _list_parts(robot, grasp.gripper):
        place = tool.actInv(data.oMi[part.joint])
        yield part.name, part.vertices @ place.rotation.T + place.translation


def _comes_from_below(choice: Choice, pose: Float[np.ndarray, "4 4"]) -> bool:
    return any(float((pose[:3, :3] @ grasp.along)[2]) > STEEPEST for grasp in choice.grasps)


def _measure_turn(pick: Pick, choice: Choice, poses: dict[str, Float[np.ndarray, "4 4"]]) -> float:
    """Return how far the tools are turned and moved from where they are to the object."""
    total = 0.0
    for grasp in choice.grasps:
        own, wanted = poses[grasp.gripper.tool], pick.places[0][0] @ grasp.pose_object_tool
        turn = np.arccos(np.clip(0.5 * (np.trace(own[:3, :3].T @ wanted[:3, :3]) - 1.0), -1.0, 1.0))
        total += float(turn) + float(np.linalg.norm(own[:3, 3] - wanted[:3, 3]))
    return total / len(choice.grasps)
