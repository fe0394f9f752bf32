"""Stances of a request, made from its robot, scene and start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.demands.contacts.stances import (
    ContactStance,
    StanceContact,
    Surface,
    find_link_pose,
    find_unjoined,
    place_patch,
    place_patch_as_it_is,
)
from service.errors import RequestError, would_do
from service.request.contacts import ContactsRequest, PlaceRequest, SurfaceRequest
from service.start.standing import FLOOR_KIND
from service.verify.ground import GROUND_TOLERANCE_M, UNSEEN_KIND, find_surface_gaps

FLOOR = "floor"
FLAT_M = 1e-3  # height of what belongs to one side of a piece
STRIP_M = 4e-3  # width of the surface on a piece's edge
TILT_ROUNDING = 1e-4  # of a contact's tilt [rad]
START_PATCHES = ("left_foot", "right_foot")


def make_stances(
    request: ContactsRequest, robot: RobotModel, scene: Scene, start: Float[np.ndarray, "n"]
) -> tuple[ContactStance, ...]:
    """Return the stance at the start and all that follow.

    Raises:
        RequestError: one line per unknown patch or surface, contact off its surface, or two stances without a contact
            in common.
    """
    if not robot.is_floating:
        raise RequestError("task.contacts: this robot's base is fixed; it needs no contacts")
    surfaces = make_surfaces(request.surfaces, scene)
    held = _start_contacts(request, robot, scene, start, surfaces)
    stances = [ContactStance("start", tuple(held.values()))]
    problems: list[str] = []
    for index, stance in enumerate(request.stances):
        field = f"task.contacts.stances[{index}]"
        for patch in stance.release:
            if patch not in held:
                carried = ", ".join(held) or "nothing"
                problems.append(f"{field}.release: {patch} is not in contact then; {carried} is")
            held.pop(patch, None)
        for patch, place in sorted(stance.make.items()):
            line = _find_unknown(robot, surfaces, patch, place.surface, f"{field}.make")
            if line is not None:
                problems.append(line)
                continue
            contact = _place(robot, scene, surfaces[place.surface], patch, place)
            off = find_off(contact, scene, f"{field}.make.{patch}")
            problems += [off] if off else []
            # Another patch of the same link lets go.
            held = {k: v for k, v in held.items() if v.planted.link != contact.planted.link}
            held[patch] = contact
        stances.append(ContactStance(stance.name, tuple(held.values())))
    unjoined = find_unjoined(stances)
    if not problems and unjoined is not None:
        problems.append(f"task.contacts: {unjoined}")
    if problems:
        raise RequestError(problems)
    return tuple(stances)


def make_surfaces(requests: Mapping[str, SurfaceRequest], scene: Scene) -> dict[str, Surface]:
    """Return the surfaces of a request and the floor, by name.

    Raises:
        RequestError: one line per unknown piece, side that is not flat, or polygon that is none.
    """
    pieces = {piece.name: piece for piece in scene.pieces}
    surfaces, problems = dict[str, Surface](), list[str]()
    floors = [piece for piece in scene.pieces if piece.kind == FLOOR_KIND]
    if floors:
        top = _find_side(floors[0], np.array([0.0, 0.0, 1.0]))
        if top is not None:
            surfaces[FLOOR] = Surface.on_pieces(FLOOR, *top, 1.0, floors)
    for name, request in requests.items():
        field = f"task.contacts.surfaces.{name}"
        behind = request.pieces if request.piece is None else (request.piece,)
        unknown = [piece for piece in behind if piece not in pieces]
        if unknown:
            problems.append(
                f"{field}: no piece {unknown[0]!r} in the scene, which has {would_do(unknown[0], sorted(pieces))}"
            )
            continue
        normal = np.array(request.normal) / np.linalg.norm(request.normal)
        if request.piece is not None:
            side = _find_side(pieces[request.piece], normal)
        else:
            side = _order_corners(np.array(request.corners), normal)
        if side is None:
            problems.append(f"{field}: {request.piece or 'the polygon'} has no flat side along {list(request.normal)}")
            continue
        surfaces[name] = Surface.on_pieces(name, *side, request.friction, [pieces[piece] for piece in behind])
    if problems:
        raise RequestError(problems)
    return surfaces


def _find_side(
    piece: ConvexPiece, normal: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return corners and normal of the side of a piece that faces along a direction; None without a flat one."""
    height = piece.vertices @ normal
    return _order_corners(piece.vertices[height >= height.max() - FLAT_M], normal)


def _order_corners(
    points: Float[np.ndarray, "N 3"], direction: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return the hull of points in their plane, counter-clockwise about its normal; None where they have none."""
    middle = points.mean(axis=0)
    if len(points) < 2:
        return None
    _, sizes, axes = np.linalg.svd(points - middle)
    if sizes[0] > FLAT_M and (len(points) == 2 or sizes[1] < FLAT_M):
        return _make_strip(points, axes[0], direction)
    if sizes[1] < FLAT_M or (len(sizes) > 2 and sizes[2] > FLAT_M * np.sqrt(len(points))):
        return None
    normal = axes[2] if axes[2] @ direction >= 0.0 else -axes[2]
    u = axes[0]
    v = np.cross(normal, u)
    flat = np.stack([(points - middle) @ u, (points - middle) @ v], axis=1)
    try:
        around = ConvexHull(flat).vertices  # counter-clockwise
    except QhullError:
        return None
    return middle + flat[around, :1] * u + flat[around, 1:] * v, normal


def _make_strip(
    points: Float[np.ndarray, "N 3"], along: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return corners and normal of a narrow strip on the edge of a piece, as on a rail that is round."""
    normal = direction - (direction @ along) * along
    if np.linalg.norm(normal) < 0.5:
        return None
    normal /= np.linalg.norm(normal)
    side = np.cross(normal, along)
    reach = points @ along
    first, last = points[int(reach.argmin())], points[int(reach.argmax())]
    half = 0.5 * STRIP_M * side
    return np.stack([first - half, last - half, last + half, first + half]), normal


def _start_contacts(
    request: ContactsRequest,
    robot: RobotModel,
    scene: Scene,
    start: Float[np.ndarray, "n"],
    surfaces: Mapping[str, Surface],
) -> dict[str, StanceContact]:
    """Return the contacts of the start by patch."""
    wanted = request.start or {patch: FLOOR for patch in START_PATCHES if patch in robot.contacts}
    held, problems = dict[str, StanceContact](), list[str]()
    if not wanted:
        raise RequestError(f"task.contacts.start: {robot.name} names no feet; give the patches it stands on")
    for patch, name in sorted(wanted.items()):  # a message keeps no order
        line = _find_unknown(robot, surfaces, patch, name, "task.contacts.start")
        if line is None:
            held[patch] = face_pieces(place_patch_as_it_is(robot, start, patch, surfaces[name]), scene)
            line = find_off(held[patch], scene, f"task.contacts.start.{patch}")
        problems += [line] if line else []
    if problems:
        raise RequestError(problems)
    return held


def _place(robot: RobotModel, scene: Scene, surface: Surface, patch: str, place: PlaceRequest) -> StanceContact:
    own = robot.contacts[patch]
    pose = find_link_pose(own, surface, np.array(place.at), float(np.deg2rad(place.yaw_deg)))
    return face_pieces(place_patch(own, patch, surface, pose), scene)


def face_pieces(contact: StanceContact, scene: Scene) -> StanceContact:
    """Return a contact with the normal of what it touches, and the angle by which that leans off it.

    On a round piece the normal is that of the round shape where the contact is; elsewhere it is the surface's.
    """
    behind = [piece for piece in scene.pieces if piece.name in contact.surface.pieces]
    normal = contact.surface.find_normal(contact.points)
    _, tilt = find_surface_gaps(contact.points, normal, behind)
    return replace(contact, planted=replace(contact.planted, normal=normal, tilt_rad=tilt + TILT_ROUNDING))


def _find_unknown(
    robot: RobotModel, surfaces: Mapping[str, Surface], patch: str, surface: str, field: str
) -> str | None:
    """Return a problem where the robot has no such patch, or the request no such surface."""
    if patch not in robot.contacts:
        known = would_do(patch, sorted(robot.contacts)) or "no contact patches; give robot.contacts"
        return f"{field}: unknown contact patch {patch!r}; {robot.name} has {known}"
    if surface not in surfaces:
        return f"{field}.{patch}: unknown surface {surface!r}; expected {would_do(surface, sorted(surfaces))}"
    return None


def find_off(contact: StanceContact, scene: Scene, field: str) -> str | None:
    """Return a problem where a contact's points are off their surface, beyond its edges, or on nothing seen."""
    height = contact.surface.measure_height(contact.points)
    worst = int(np.abs(height).argmax())
    if abs(height[worst]) > GROUND_TOLERANCE_M:
        side = "above" if height[worst] > 0.0 else "below"
        return f"{field}: a point of {contact.patch} is {abs(height[worst]):.3f} m {side} {contact.surface.name}"
    outside = contact.surface.measure_outside(contact.points)
    if outside.max() > GROUND_TOLERANCE_M:
        return f"{field}: a point of {contact.patch} is {outside.max():.3f} m beyond the edge of {contact.surface.name}"
    seen = [piece for piece in scene.pieces if piece.kind != UNSEEN_KIND]
    gaps, _ = find_surface_gaps(contact.points, contact.surface.normal, seen)
    if np.abs(gaps).max() > GROUND_TOLERANCE_M:
        return f"{field}: {contact.surface.name} has no piece of the scene behind a point of {contact.patch}"
    return None
