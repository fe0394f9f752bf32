"""Steps in which the robot changes what it stands on: given stances, or footsteps to a place on the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.scene import Scene
from service.demands.contacts.contact_task import START_PATCHES, make_stances
from service.demands.contacts.phases import FINISH, list_contact_phases
from service.demands.contacts.stances import ContactStance, place_patch_as_it_is
from service.demands.contacts.surfaces import FLOOR, make_surfaces
from service.demands.phase import TaskPhase
from service.demands.steps.holding import Holding, carry_along
from service.errors import RequestError
from service.request.tasks.contacts import ContactsRequest, PlaceRequest, StanceRequest
from service.request.tasks.steps import StepRequest, WalkStep

LARGEST_TURN = float(np.deg2rad(15.0))  # of a foot against the other in a step
SIDEWAYS_M = 1e-3  # from which on a way counts as one to the right
NEAR_M, NEAR_RAD = 5e-3, float(np.deg2rad(1.0))  # within which the robot stands where it is to go


def read_stances(
    holding: Holding, scene: Scene, step: StepRequest, name: str, q: Float[np.ndarray, "n"]
) -> tuple[tuple[ContactStance, ...], str | None]:
    """Return the stances of a step from a configuration on, that of its beginning first, and the posture to end in.

    Raises:
        RequestError: contacts do not fit robot or scene; the message names the step.
    """
    section = step.contacts
    try:
        if step.walk is not None:
            section = plan_footsteps(holding, scene, step.walk, q)
        assert section is not None
        if any(place.slack_m for stance in section.stances for place in stance.make.values()):
            raise RequestError("slack_m: contacts of a step have their places; expected 0")
        stances = make_stances(section, holding.robot, scene, q[: holding.robot.n], holding.braced)
    except RequestError as error:
        lines = [f"step '{name}': {problem.replace('task.contacts', step.kind)}" for problem in error.problems]
        raise RequestError(lines) from None
    named = tuple(replace(stance, name=f"{name}: {stance.name}") for stance in stances)
    return named, section.finish


def list_walking_phases(
    holding: Holding, stances: tuple[ContactStance, ...], finish: str | None, name: str
) -> tuple[TaskPhase, ...]:
    """Return the phases of a step that changes contacts, as any motion has to keep them."""
    phases = list_contact_phases(stances, has_finish=finish is not None)
    return tuple(carry_along(rename_finish(phase, name), holding) for phase in phases)


def rename_finish(phase: TaskPhase, name: str) -> TaskPhase:
    """Return a phase named after its step."""
    return replace(phase, name=f"{name}: {FINISH}") if phase.name == FINISH else phase


def plan_footsteps(holding: Holding, scene: Scene, walk: WalkStep, q: Float[np.ndarray, "n"]) -> ContactsRequest:
    """Return footsteps straight to a place on the floor: the feet turn and move in equal shares, one after the other.

    Raises:
        RequestError: the robot has no two feet, or stands there already.
    """
    robot, feet = holding.robot, [patch for patch in START_PATCHES if patch in holding.robot.contacts]
    if len(feet) != 2:
        raise RequestError(f"walk: {robot.name} names no two feet ({' and '.join(START_PATCHES)})")
    floor = make_surfaces({}, scene, "walk")[FLOOR]
    here = {patch: place_patch_as_it_is(robot, q[: robot.n], patch, floor) for patch in feet}
    middle = np.mean([contact.points.mean(axis=0) for contact in here.values()], axis=0)
    yaws = {patch: _find_yaw(contact.planted.pose_world_link) for patch, contact in here.items()}
    yaw = float(np.mean(list(yaws.values())))
    wanted = float(np.deg2rad(walk.yaw_deg)) if walk.yaw_deg is not None else yaw
    turn = float((wanted - yaw + np.pi) % (2.0 * np.pi) - np.pi)
    way = np.array([*walk.to, middle[2]]) - middle
    length = float(np.linalg.norm(way[:2]))
    if length < NEAR_M and abs(turn) < NEAR_RAD:
        raise RequestError("walk: the robot stands there already")
    count = max(int(np.ceil(length / walk.stride_m)), int(np.ceil(abs(turn) / LARGEST_TURN)), 1)
    # The foot towards which the way leads goes first, so that the feet never cross.
    side = np.array([-np.sin(yaw), np.cos(yaw)]) @ way[:2] + 1e-3 * turn
    order = feet if side > -SIDEWAYS_M else feet[::-1]
    stances = []
    for number in range(1, count + 1):
        for patch in order:
            share = number / count
            spun = _turn(share * turn) @ (here[patch].points.mean(axis=0) - middle)
            x, y, z = (middle + share * way + spun).tolist()
            place = PlaceRequest(FLOOR, (x, y, z), float(np.rad2deg(yaws[patch] + share * turn)))
            stances.append(StanceRequest(f"{patch.replace('_', ' ')} {number}", {patch: place}))
    return ContactsRequest(stances=tuple(stances), finish=walk.finish)


def _find_yaw(pose: Float[np.ndarray, "4 4"]) -> float:
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def _turn(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
