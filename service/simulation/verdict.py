"""Verdict on a plan in physics: whether its work was done, and why not."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.demands.resistance import MechanismPhysics
from service.execution.reference import PlannedReference
from service.replay.simulation_claims import DONE, FELL, STOOD, TRAVEL_SHARE, Verdict
from service.simulation.seen import Seen
from service.simulation.travel import (
    STRAY,
    JointMove,
    find_row,
    format_value,
    measure_moves,
    read_unit,
)
from service.verify import Motion, Phase, PoseTarget, list_phases, outside_polygon, place_frames, split_motion

PLACE_M = 0.02  # of a hand from its goal, and of a contact from its place [m]
TURNED = float(np.deg2rad(10.0))  # of an object from how it is put down
REST_S = 0.5  # in which what is at rest moves at most by the following
REST_COM_M, REST_JOINT = 1e-3, 1e-3  # of the centre of mass [m], of a joint of the mechanism [rad, m]


@dataclass(frozen=True)
class Judgement:
    """What became of a plan in physics.

    Attributes:
        verdict: ``DONE``: the robot stands and its work is done; ``STOOD``: it stands, the work is not done; ``FELL``.
        reasons: sentences on what is missing; empty where it is done or the robot fell early.
        moves: of the mechanism's joints.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    moves: tuple[JointMove, ...]


def judge(reference: PlannedReference, seen: Seen, physics: MechanismPhysics) -> Judgement:
    """Return the verdict on a run that went on until the robot was at rest, or for as long as one waits for that.

    Args:
        reference: the plan.
        seen: the run.
        physics: what the mechanism opposes.
    """
    moves = measure_moves(reference, seen, physics)
    undone = tuple(move.describe() for move in moves if not move.is_done)
    if seen.fell_at_s is not None:
        return Judgement(FELL, undone, moves)
    outside = measure_outside(reference, seen)
    moving = find_unrest(reference, seen.configuration[find_row(seen.times, seen.times[-1] - REST_S) :])
    if outside is not None and outside > 0.0 and moving:
        after = seen.times[-1] - reference.duration_s
        reason = f"falls {after:.1f} s after the end: the centre of mass is {1e3 * outside:.0f} mm outside its feet"
        return Judgement(FELL, (reason, *undone), moves)
    reasons = [*undone, *_list_latched(reference, seen), *_list_displaced(reference, seen, physics, moves)]
    if moving:
        reasons.append(f"{moving} {seen.times[-1] - reference.duration_s:.1f} s after the end")
    if outside is not None and outside > 0.0:
        reasons.append(f"the centre of mass ends {1e3 * outside:.0f} mm outside its feet")
    reasons += _list_misplaced(reference, seen)
    reasons += _list_lost(reference, seen)
    return Judgement(STOOD if reasons else DONE, tuple(reasons), moves)


def find_unrest(reference: PlannedReference, q: Float[np.ndarray, "S n"]) -> str:
    """Return what moves in half a second of configurations, in words; empty where everything is at rest."""
    model: pin.Model = reference.robot.model
    data = model.createData()
    com = np.array([pin.centerOfMass(model, data, row) for row in q])
    if float(np.linalg.norm(np.ptp(com, axis=0))) > REST_COM_M:
        return "the robot still moves"
    first = reference.robot.n - len(reference.mechanism_names)
    moved = np.ptp(q[:, first:], axis=0)
    names = [name for name, value in zip(reference.mechanism_names, moved, strict=True) if value > REST_JOINT]
    return f"{names[0]} still moves" if names else ""


def measure_outside(reference: PlannedReference, seen: Seen) -> float | None:
    """Return how far the centre of mass ends outside the feet or regions of the last phase [m]; None without any."""
    phase = list_phases(reference.motion)[-1]
    polygon = find_support(phase)
    if polygon is None:
        return None
    model: pin.Model = reference.robot.model
    com = pin.centerOfMass(model, model.createData(), seen.configuration[-1])
    return float(outside_polygon(polygon, com[None, :2])[0])


def find_support(phase: Phase) -> np.ndarray | None:
    """Return the polygon (E, 2) of the centre of mass at the end of a phase [m], or None."""
    if phase.support is not None:
        return phase.support.polygon
    return phase.regions[-1].vertices if phase.regions else None


def _list_latched(reference: PlannedReference, seen: Seen) -> Iterator[str]:
    """Yield a sentence per latch that the plan frees and that held throughout."""
    first = reference.robot.n - len(reference.mechanism_names)
    for k, release in enumerate(reference.motion.releases):
        column = first + reference.mechanism_names.index(release.latch)
        sense = np.sign(release.latch_at)
        planned, true = (float((sense * table[:, column]).max()) for table in (seen.planned, seen.configuration))
        if planned >= abs(release.latch_at) and bool(seen.is_latched[:, k].all()):
            unit = read_unit(reference, release.latch)
            yield (
                f"the latch of {release.joint} held: {release.latch} reached {format_value(true, unit)} of "
                f"{format_value(abs(release.latch_at), unit)}"
            )


def _list_displaced(
    reference: PlannedReference, seen: Seen, physics: MechanismPhysics, moves: Collection[JointMove]
) -> Iterator[str]:
    """Yield a sentence per joint of the mechanism that does not rest where the plan leaves it.

    As far off as a move may end; a joint with a spring is left out: it returns once the hand has gone.
    """
    undone = {move.joint for move in moves if not move.is_done}
    first = reference.robot.n - len(reference.mechanism_names)
    for k, joint in enumerate(reference.mechanism_names):
        if joint in undone or physics.has_spring(joint):
            continue
        own = [move for move in moves if move.joint == joint]
        unit = read_unit(reference, joint)
        planned, end = float(seen.planned[-1, first + k]), float(seen.configuration[-1, first + k])
        beyond = (end - planned) * (float(np.sign(own[-1].planned)) if own else 1.0)
        short, far = STRAY[unit], STRAY[unit]
        if own:
            short = TRAVEL_SHARE * own[-1].range
            far += short
        if not -short <= beyond <= far:
            yield f"{joint} rests at {format_value(end, unit)} instead of {format_value(planned, unit)}"


def _list_misplaced(reference: PlannedReference, seen: Seen) -> Iterator[str]:
    """Yield a sentence per contact that is not in its place, and per hand of a plan without a mechanism."""
    model: pin.Model = reference.robot.model
    data = model.createData()
    for phase in reference.phases:
        row = find_row(seen.times, phase.end_s)
        pin.framesForwardKinematics(model, data, seen.configuration[row])
        for contact in phase.contacts:
            pose = data.oMf[model.getFrameId(contact.link)]
            true = pose.rotation @ contact.sole.mean(axis=0) + pose.translation
            off = float(np.linalg.norm(true - contact.points.mean(axis=0)))
            if off > PLACE_M:
                yield (
                    f"{contact.link} ends phase '{phase.name}' {1e3 * off:.0f} mm from its place; expected at most "
                    f"{1e3 * PLACE_M:.0f} mm"
                )
    if reference.mechanism_names:
        return
    places = []
    for q in (seen.configuration[-1], seen.planned[-1]):
        pin.framesForwardKinematics(model, data, q)
        places.append([frame.translation.copy() for frame in data.oMf])
    for name in list_goal_frames(reference.motion):
        off = float(np.linalg.norm(np.subtract(*(place[model.getFrameId(name)] for place in places))))
        if off > PLACE_M:
            yield f"{name} ends {1e3 * off:.0f} mm from its goal; expected at most {1e3 * PLACE_M:.0f} mm"


@dataclass(frozen=True)
class ObjectEnd:
    """Where an object is at the end of a run.

    Attributes:
        name: of the object.
        off_m: distance from where the plan leaves it.
        turned_rad: angle from how the plan leaves it.
        is_at_rest: whether it stays there.
    """

    name: str
    off_m: float
    turned_rad: float
    is_at_rest: bool


def measure_objects(reference: PlannedReference, seen: Seen) -> Iterator[ObjectEnd]:
    """Yield where each object ends."""
    if not seen.objects:
        return
    last = split_motion(reference.motion)[-1]
    planned = place_frames(last.robot, seen.planned[-1], list(seen.objects))
    first = find_row(seen.times, seen.times[-1] - REST_S)
    for name, poses in seen.objects.items():
        off = float(np.linalg.norm(poses[-1, :3] - planned[name][:3, 3]))
        w, x, y, z = poses[-1, 3:]
        turn = float(np.linalg.norm(pin.log3(planned[name][:3, :3].T @ pin.Quaternion(w, x, y, z).matrix())))
        moved = float(np.ptp(poses[first:, :3], axis=0).max())
        yield ObjectEnd(name, off, turn, moved <= REST_COM_M)


def _list_lost(reference: PlannedReference, seen: Seen) -> Iterator[str]:
    """Yield a sentence per object that does not rest where the plan leaves it."""
    for end in measure_objects(reference, seen):
        if end.off_m > PLACE_M:
            yield f"{end.name} ends {1e3 * end.off_m:.0f} mm from its place; expected at most {1e3 * PLACE_M:.0f} mm"
        elif end.turned_rad > TURNED:
            most = np.rad2deg(TURNED)
            yield f"{end.name} ends turned by {np.rad2deg(end.turned_rad):.0f} deg; expected at most {most:.0f} deg"
        elif not end.is_at_rest:
            yield f"{end.name} still moves"


def list_goal_frames(motion: Motion) -> tuple[str, ...]:
    """Return the frames with a pose to reach, and the hands."""
    names: dict[str, None] = {}
    for phase in list_phases(motion):
        names |= dict.fromkeys(target.frame for target in phase.targets if isinstance(target, PoseTarget))
    names |= dict.fromkeys(motion.robot.link_groups.get("hands", ()))
    return tuple(name for name in names if motion.robot.model.existFrame(name))
