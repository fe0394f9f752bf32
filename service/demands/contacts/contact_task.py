"""Stances of a request, made from its robot, scene and start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.contacts.stances import (
    ContactStance,
    StanceContact,
    Surface,
    find_link_pose,
    find_unjoined,
    place_patch,
    place_patch_as_it_is,
)
from service.demands.contacts.surfaces import FLOOR, find_unknown, make_surfaces
from service.errors import RequestError
from service.request.tasks.contacts import ContactsRequest, PlaceRequest
from service.verify import GROUND_TOLERANCE_M, UNSEEN_KIND, find_surface_gaps

TILT_ROUNDING = 1e-4  # of a contact's tilt [rad]
START_PATCHES = ("left_foot", "right_foot")


def make_stances(
    request: ContactsRequest,
    robot: RobotModel,
    scene: Scene,
    start: Float[np.ndarray, "n"],
    standing: tuple[StanceContact, ...] = (),
) -> tuple[ContactStance, ...]:
    """Return the stance at the start and all that follow.

    Args:
        request: the section.
        robot, scene: of the request.
        start: (n,) configuration.
        standing: contacts that an earlier step has made; none where the section says what the robot stands on.

    Raises:
        RequestError: one line per unknown patch or surface, contact off its surface, or two stances without a contact
            in common.
    """
    if not robot.is_floating:
        raise RequestError("task.contacts: this robot's base is fixed; it needs no contacts")
    surfaces = make_surfaces(request.surfaces, scene, "task.contacts.surfaces")
    held = {contact.patch: contact for contact in standing}
    if request.start or not standing:
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
            line = find_unknown(robot, surfaces, patch, place.surface, f"{field}.make")
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
        line = find_unknown(robot, surfaces, patch, name, "task.contacts.start")
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
    return replace(face_pieces(place_patch(own, patch, surface, pose), scene), slack_m=place.slack_m)


def face_pieces(contact: StanceContact, scene: Scene) -> StanceContact:
    """Return a contact with the normal of what it touches, and the angle by which that leans off it.

    On a round piece the normal is that of the round shape where the contact is; elsewhere it is the surface's.
    """
    behind = [piece for piece in scene.pieces if piece.name in contact.surface.pieces]
    normal = contact.surface.find_normal(contact.points)
    _, tilt = find_surface_gaps(contact.points, normal, behind)
    return replace(contact, planted=replace(contact.planted, normal=normal, tilt_rad=tilt + TILT_ROUNDING))


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
