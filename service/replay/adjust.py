"""Targets of a request, displaced by what an operator or a new measurement says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown, would_do
from service.replay.resume_contacts import displace, move_contacts
from service.request.schema import PlanRequest
from service.request.tasks.contacts import ContactsRequest
from service.request.tasks.door import DoorRequest
from service.request.tasks.registry import TaskRequest
from service.setup.world import Surroundings

VALVE, DOOR = "valve", "door"
STEM = "stem"  # kind of the piece behind a wheel, which goes with it
LARGEST_M = 0.3  # of a displacement


def read_adjustment(text: str) -> tuple[str, Float[np.ndarray, "3"]]:
    """Return target and displacement [m] of a text ``TARGET:X,Y,Z``.

    Raises:
        RequestError: it is none.
    """
    target, _, numbers = text.rpartition(":")
    try:
        offset = np.array([float(number) for number in numbers.split(",")])
        if not target or offset.shape != (3,) or not np.isfinite(offset).all():
            raise ValueError
    except ValueError:
        words = f"--adjust: {shown(text)}; expected TARGET:X,Y,Z in metres, such as right_foot:0.02,0,0"
        raise RequestError(words) from None
    return target, offset


def adjust_request(
    request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
) -> tuple[PlanRequest, Surroundings | None]:
    """Return a request, and what its scan shows, with a target displaced.

    Args:
        request: the request for the rest.
        around: what its scan shows, if it has one.
        target: link of a goal's pose, ``valve``, ``door`` (leaf and handle together), or, where contacts change, a
            patch that is set down anew, or an obstacle of the request with all contacts on it.
        offset: displacement in world axes [m].

    Raises:
        RequestError: the request has no such target, or the displacement makes no sense.
    """
    if offset.shape != (3,) or not np.all(np.isfinite(offset)) or np.linalg.norm(offset) > LARGEST_M:
        raise RequestError(f"adjust: {offset.tolist()}; expected three numbers, at most {LARGEST_M:g} m in all")
    contacts = None if request.task is None else request.task.contacts
    if contacts is not None:
        return _move_contacts(request, contacts, target, offset), around
    task = request.task
    valve, door = (None, None) if task is None else (task.valve, task.door)
    poses = () if request.goal is None else request.goal.poses
    known = [pose.link for pose in poses]
    known += [name for name, wanted in ((VALVE, valve), (DOOR, door)) if wanted is not None]
    if target not in known:
        expected = f"expected {would_do(target, known)}" if known else "only poses of a goal, valves and doors can be"
        raise RequestError(f"adjust: this plan has no target {target!r} that can be displaced; {expected}")
    if door is not None:
        return _move_door(request, door, around, offset)
    if request.goal is not None:
        moved = tuple(
            replace(pose, position=displace(pose.position, offset)) if pose.link == target else pose for pose in poses
        )
        return replace(request, goal=replace(request.goal, poses=moved)), around
    if valve is not None and request.task is not None and valve.centre is not None:
        given = replace(valve, centre=displace(valve.centre, offset))
        return replace(request, task=replace(request.task, valve=given)), around
    if around is None or not around.valves:
        raise RequestError("adjust: the earlier plan recorded no valve")
    first = replace(around.valves[0], centre=around.valves[0].centre + offset)
    pieces = tuple(
        replace(piece, vertices=piece.vertices + offset) if piece.kind == STEM else piece for piece in around.pieces
    )
    return request, replace(around, pieces=pieces, valves=(first, *around.valves[1:]))


def _move_door(
    request: PlanRequest, door: DoorRequest, around: Surroundings | None, offset: Float[np.ndarray, "3"]
) -> tuple[PlanRequest, Surroundings | None]:
    """Return a request, or what its scan shows, with leaf and handle displaced."""
    if door.leaf is not None:
        leaf = replace(door.leaf, hinge=displace(door.leaf.hinge, offset), edge=displace(door.leaf.edge, offset))
        handle = door.handle
        handle = None if handle is None else replace(handle, centre=displace(handle.centre, offset))
        return replace(request, task=TaskRequest(door=replace(door, leaf=leaf, handle=handle))), around
    if around is None or not around.doors:
        raise RequestError("adjust: the earlier plan recorded no door")
    seen = around.doors[0].geometry
    grip = None if seen.handle is None else replace(seen.handle, centre=seen.handle.centre + offset)
    first = replace(around.doors[0], geometry=replace(seen, hinge=seen.hinge + offset, handle=grip))
    return request, replace(around, doors=(first, *around.doors[1:]))


def _move_contacts(
    request: PlanRequest, contacts: ContactsRequest, target: str, offset: Float[np.ndarray, "3"]
) -> PlanRequest:
    """Return a request with a place of a patch displaced, or an obstacle with all that is on it."""
    obstacles = request.scene.obstacles
    moved = move_contacts(contacts, target, offset, [obstacle.name for obstacle in obstacles])
    scene = request.scene
    if not any(target in stance.make for stance in contacts.stances):
        pieces = [
            replace(piece, position=displace(piece.position, offset)) if piece.name == target else piece
            for piece in obstacles
        ]
        scene = replace(scene, obstacles=tuple(pieces))
    return replace(request, scene=scene, task=TaskRequest(contacts=moved))
