"""Places of a task that changes contacts, displaced by what an operator or a new measurement says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown, would_do
from service.request.schema import PlanRequest
from service.request.tasks.contacts import ContactsRequest, StanceRequest, SurfaceRequest
from service.request.tasks.registry import TaskRequest
from service.tasks.kind import displace_place


def move_contacts(
    request: ContactsRequest, target: str, offset: Float[np.ndarray, "3"], obstacles: Sequence[str]
) -> ContactsRequest:
    """Return a task with the next place of a patch displaced, or all places on an obstacle that is displaced.

    Args:
        request: the task.
        target: patch or obstacle.
        offset: displacement in world axes [m].
        obstacles: names of those that can be displaced.

    Raises:
        RequestError: neither a patch that is set down anew, nor an obstacle.
    """
    patches = list(dict.fromkeys(patch for stance in request.stances for patch in stance.make))
    if target in patches:
        k = next(k for k, stance in enumerate(request.stances) if target in stance.make)
        stances = list(request.stances)
        stances[k] = _move_places(stances[k], [target], offset)
        return _with(request, request.surfaces, stances)
    if target not in obstacles:
        expected = would_do(target, [*patches, *obstacles])
        words = f"adjust: this plan has no target {shown(target)} that can be displaced; expected {expected}"
        raise RequestError(words)
    on = [name for name, surface in request.surfaces.items() if target in (surface.piece, *surface.pieces)]
    surfaces = {name: _move_surface(own, offset) if name in on else own for name, own in request.surfaces.items()}
    stances = [
        _move_places(stance, [patch for patch, place in stance.make.items() if place.surface in on], offset)
        for stance in request.stances
    ]
    return _with(request, surfaces, stances)


def _with(
    request: ContactsRequest, surfaces: Mapping[str, SurfaceRequest], stances: Sequence[StanceRequest]
) -> ContactsRequest:
    return ContactsRequest(dict(surfaces), request.start, tuple(stances), request.finish)


def _move_surface(surface: SurfaceRequest, offset: Float[np.ndarray, "3"]) -> SurfaceRequest:
    if surface.corners is None:
        return surface  # it moves with its piece
    corners = tuple(displace_place(corner, offset) for corner in surface.corners)
    return SurfaceRequest(None, surface.normal, corners, surface.pieces, surface.friction)


def _move_places(stance: StanceRequest, patches: Sequence[str], offset: Float[np.ndarray, "3"]) -> StanceRequest:
    make = {
        patch: replace(place, at=displace_place(place.at, offset)) if patch in patches else place
        for patch, place in stance.make.items()
    }
    return StanceRequest(stance.name, make, stance.release, stance.posture)


def displace_contacts(
    request: PlanRequest, contacts: ContactsRequest, target: str, offset: Float[np.ndarray, "3"]
) -> PlanRequest:
    """Return a request with a place of a patch displaced, or an obstacle with all that is on it."""
    obstacles = request.scene.obstacles
    moved = move_contacts(contacts, target, offset, [obstacle.name for obstacle in obstacles])
    scene = request.scene
    if not any(target in stance.make for stance in contacts.stances):
        pieces = [
            replace(piece, position=displace_place(piece.position, offset)) if piece.name == target else piece
            for piece in obstacles
        ]
        scene = replace(scene, obstacles=tuple(pieces))
    return replace(request, scene=scene, task=TaskRequest(contacts=moved))
