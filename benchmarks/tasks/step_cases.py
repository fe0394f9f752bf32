"""Requests that change contacts, drawn from stated ranges: stones, a step with a handrail, and rising from a chair."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel
from scopt import Constraint, Sense
from service.body.aims import Aims
from service.body.forces.equilibrium_pose import ForceLimits, solve_equilibrium_pose
from service.body.holds import project_onto_holds
from service.body.whole_body import WholeBody
from service.demands import compose_scene
from service.demands.contacts.stances import find_link_pose, make_contact_allowances, place_patch
from service.demands.contacts.surfaces import make_surfaces
from service.request.file import parse_request
from service.setup.world import build_obstacles

Data = dict[str, Any]
SOLE_MIDDLE_M = 0.0425  # of Atlas's sole ahead of its ankle
HALF_STANCE_M = 0.11
SEATED_MARGIN_M = 5e-3  # clearance of a solved start


def make_stones(seed: int) -> Data:
    """Return a walk over three flat stones: rise 2-10 cm, steps of 26-36 cm, turned by up to 12 deg."""
    rng = np.random.default_rng([1, seed])
    obstacles, surfaces, stances = [], Data(), []
    x = {"right": SOLE_MIDDLE_M, "left": SOLE_MIDDLE_M}
    for k, side in enumerate(("right", "left", "right")):
        other = "left" if side == "right" else "right"
        x[side] = max(x[other] + rng.uniform(0.13, 0.33), x[side] + 0.33)
        y = (-1.0 if side == "right" else 1.0) * rng.uniform(0.115, 0.15)
        rise, yaw = rng.uniform(0.02, 0.10), rng.uniform(-12.0, 12.0)
        name = f"stone {k + 1}"
        turn = Rotation.from_euler("z", yaw, degrees=True).as_quat(scalar_first=True).tolist()
        obstacles.append(
            {
                "name": name,
                "type": "box",
                "size": [0.30, 0.18, rise],
                "position": [x[side], y, 0.5 * rise],
                "quaternion_wxyz": turn,
            }
        )
        surfaces[name] = {"piece": name}
        place = {"surface": name, "at": [x[side], y, 0.0], "yaw_deg": yaw}
        stances.append({"name": f"{side} foot on {name}", "make": {f"{side}_foot": place}})
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True, "obstacles": obstacles},
        "task": {"contacts": {"surfaces": surfaces, "stances": stances, "finish": "reach_ready"}},
    }


def make_stair(seed: int) -> Data:
    """Return a step of 15-20 cm with a round handrail on either side, 0.42-0.52 m from the middle, 0.95-1.05 m high."""
    rng = np.random.default_rng([2, seed])
    rise, ahead = rng.uniform(0.15, 0.20), rng.uniform(0.24, 0.30)
    side = "right" if rng.random() < 0.5 else "left"
    sign = -1.0 if side == "right" else 1.0
    y, z, radius = sign * rng.uniform(0.44, 0.54), rng.uniform(0.95, 1.05), rng.uniform(0.016, 0.024)
    foot = ahead + 0.02 + 0.13
    hand = f"{side}_hook"
    other = "left" if side == "right" else "right"

    def step(which: str) -> Data:
        place = {"surface": "step", "at": [foot, (-1.0 if which == "right" else 1.0) * HALF_STANCE_M, 0.0]}
        return {"name": f"{which} foot on the step", "make": {f"{which}_foot": place}}

    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {
            "floor": True,
            "obstacles": [
                {"name": "step", "type": "box", "size": [0.9, 1.2, rise], "position": [ahead + 0.45, 0.0, 0.5 * rise]},
                {
                    "name": "rail",
                    "type": "cylinder",
                    "radius": radius,
                    "height": 1.5,
                    "position": [0.95, y, z - radius],
                    "quaternion_wxyz": [0.5**0.5, 0.0, 0.5**0.5, 0.0],
                },
            ],
        },
        "task": {
            "contacts": {
                "surfaces": {"step": {"piece": "step"}, "rail": {"piece": "rail", "friction": 0.4}},
                "stances": [
                    {
                        "name": "hand on the rail",
                        "make": {hand: {"surface": "rail", "at": [rng.uniform(0.35, 0.5), y, z]}},
                    },
                    step(side),
                    step(other),
                    {"name": "hand off the rail", "release": [hand]},
                ],
                "finish": "reach_ready",
            }
        },
    }


def make_chair(seed: int, robot: RobotModel) -> Data:
    """Return a rise from a narrow seat 0.45-0.6 m high, the feet 0.16-0.28 m ahead of the hip."""
    rng = np.random.default_rng([3, seed])
    height, ahead, half = rng.uniform(0.45, 0.60), rng.uniform(0.16, 0.28), rng.uniform(0.11, 0.16)
    data: Data = {
        "robot": {"name": "atlas"},
        "start": {"posture": "stand"},
        "scene": {
            "floor": True,
            "obstacles": [
                {"name": "seat", "type": "box", "size": [0.3, 0.08, height], "position": [-0.08, 0.0, 0.5 * height]}
            ],
        },
        "task": {
            "contacts": {
                "surfaces": {"seat": {"piece": "seat"}},
                "start": {"hip": "seat", "left_foot": "floor", "right_foot": "floor"},
                "stances": [{"name": "rise", "release": ["hip"]}],
                "finish": "stand",
            }
        },
    }
    places = {
        "hip": ("seat", [-0.04, 0.0, height]),
        "left_foot": ("floor", [ahead, half, 0.0]),
        "right_foot": ("floor", [ahead, -half, 0.0]),
    }
    bent = {"hpy": -1.5, "kny": 1.5, "aky": 0.0}
    return sit_down(data, robot, places, [0.0, 0.0, height + 0.095], bent)


def sit_down(
    data: Data,
    robot: RobotModel,
    places: Mapping[str, tuple[str, list[float]]],
    base: list[float],
    joints: Mapping[str, float],
) -> Data:
    """Return a request whose start has the contacts of ``places`` and is in equilibrium.

    Args:
        data: request with the posture to begin from.
        robot: of the request.
        places: surface and place by patch [m].
        base: place of the base in the first guess [m].
        joints: values in the first guess by the ends of the joints' names [rad].

    Raises:
        ValueError: no such configuration was found.
    """
    request = parse_request(copy.deepcopy(data))
    guess = robot.postures[data["start"]["posture"]].copy()
    guess[:3] = base
    for k, name in enumerate(robot.joint_names):
        guess[k] = next((value for end, value in joints.items() if name.endswith(end)), guess[k])
    scene, _ = compose_scene(request, robot, guess, (), build_obstacles(request)[0])
    task = request.task
    assert task is not None
    assert task.contacts is not None
    surfaces = make_surfaces(task.contacts.surfaces, scene, "task.contacts.surfaces")
    contacts = []
    for name, (surface, place) in places.items():
        placed = find_link_pose(robot.contacts[name], surfaces[surface], np.array(place), 0.0)
        contacts.append(place_patch(robot.contacts[name], name, surfaces[surface], placed))
    aims = Aims(SEATED_MARGIN_M, request.options.balance_margin_m)
    body = WholeBody.standing(robot, scene, guess, (), aims)
    one = np.zeros(1, dtype=int)
    constraints = [
        Constraint(contact.patch, body.keep_planted(contact.planted, one), Sense.EQUAL_ZERO, 1e-5)
        for contact in contacts
    ]
    own = [robot.contacts[contact.patch] for contact in contacts]
    limits = ForceLimits(world_normals={k: contact.surface.normal for k, contact in enumerate(contacts)})
    touches = make_contact_allowances(contacts)
    pose = solve_equilibrium_pose(body, own, guess, limits, (), constraints, allowances=touches)
    if not pose.is_feasible:
        raise ValueError("; ".join(pose.violations))
    holds = [
        lambda waypoints, contact=contact: body.keep_planted(contact.planted, waypoints)  # type: ignore[misc]
        for contact in contacts
    ]
    q = project_onto_holds(body.engine, pose.q[None], holds)[0]
    n_base = len(BASE_NAMES)
    turn = Rotation.from_euler("ZYX", q[3:n_base]).as_quat(scalar_first=True, canonical=True)
    start = {
        "joints": dict(zip(robot.joint_names[n_base:], q[n_base:].tolist(), strict=True)),
        "base": {"position": q[:3].tolist(), "quaternion_wxyz": turn.tolist()},
    }
    return {**data, "start": start}


def list_cases(robot: RobotModel) -> Mapping[str, Callable[[int], Data]]:
    """Return the makers of requests by kind, each taking a seed."""
    return {"stones": make_stones, "stair": make_stair, "chair": lambda seed: make_chair(seed, robot)}
