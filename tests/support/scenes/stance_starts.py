"""Starts on given contacts: configurations solved for, and written as sections of a request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.contact import Contact
from costs.robot import BASE_NAMES, RobotModel
from costs.scene import Scene
from service.body.aims import Aims
from service.body.forces.equilibrium_pose import ForceLimits, solve_equilibrium_pose
from service.body.holds import project_onto_holds
from service.body.whole_body import WholeBody
from service.demands.contacts.stances import StanceContact, make_contact_allowances


def solve_start(
    robot: RobotModel, scene: Scene, contacts: Sequence[StanceContact], guess: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Return a configuration in equilibrium with contacts in their places, near a guess."""
    body = replace(
        WholeBody.standing(robot, scene, guess, (), Aims(0.01, 0.02)),
        planted=tuple(contact.planted for contact in contacts),
        touches=make_contact_allowances(contacts),
    )
    own = [
        Contact(
            c.planted.link,
            c.planted.sole,
            np.tile(c.surface.normal @ c.planted.pose_world_link[:3, :3], (len(c.planted.sole), 1)),
            c.planted.friction,
            c.planted.force_cap_n,
        )
        for c in contacts
    ]
    normals = {k: contact.surface.normal for k, contact in enumerate(contacts)}
    pose = solve_equilibrium_pose(body, own, guess, ForceLimits(world_normals=normals))
    assert pose.is_feasible, pose.violations
    return np.asarray(project_onto_holds(body.engine, pose.q[None], body.holds())[0])


def write_start(robot: RobotModel, q: Float[np.ndarray, "n"]) -> Mapping[str, Any]:
    """Return the ``start`` section of a request for a configuration of a robot with a free base."""
    n_base = len(BASE_NAMES)
    turn = Rotation.from_euler("ZYX", q[3:n_base]).as_quat(scalar_first=True, canonical=True)
    return {
        "joints": dict(zip(robot.joint_names[n_base:], q[n_base:].tolist(), strict=True)),
        "base": {"position": q[:3].tolist(), "quaternion_wxyz": turn.tolist()},
    }
