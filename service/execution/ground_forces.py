"""Forces of the ground that carry a planned motion, continuous in time, and the joint torques under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from service.verify import (
    ContactShare,
    Joints,
    Motion,
    Phase,
    compute_inverse_dynamics,
    list_levers,
    list_load_cases,
    make_contact_share,
    make_joints,
    map_axes,
    share_weight,
)

_EXACT = 1e3  # weight of the wrench against the size of forces in the least-squares program
_EDGE = 1e-4  # weight of each edge of a friction pyramid: of two ways to make a force, the shorter
_CAPPED = 30.0  # weight of a normal force beyond its cap
_CAP_SHARE = 0.85  # of a cap that is used where other contacts can carry the rest
_UNLOADED = 30.0  # weight of the forces at a contact that comes or goes, against 1 of the others


@dataclass(frozen=True)
class CarriedMotion:
    """Forces of a phase at ``S`` times.

    Attributes:
        torque: (S, n) generalised forces of all coordinates, contact forces and loads taken off [N m, N].
        forces: (S, C, 3) of the surroundings at the phase's contact points, world axes [N].
        missing_n: (S,) of the wrench of the motion, by how much the contacts miss it [N].
    """

    torque: Float[np.ndarray, "S n"]
    forces: Float[np.ndarray, "S C 3"]
    missing_n: Float[np.ndarray, "S"]


def carry_motion(
    motion: Motion,
    phase: Phase,
    q: Float[np.ndarray, "S n"],
    v: Float[np.ndarray, "S n"],
    a: Float[np.ndarray, "S n"],
    *,
    loaded: Float[np.ndarray, "S"],
    loosened: Float[np.ndarray, "S C"],
) -> CarriedMotion:
    """Return the torques and contact forces of a phase's motion.

    Torques are ``rnea(q, v, a) - J^T f``: those of the floating robot without contact forces make legs collapse.

    Args:
        q, v, a: (S, n) states of the motion.
        loaded: (S,) shares of the loads of the hands that act, 0 to 1.
        loosened: (S, C) for each contact point 0 where it carries freely, 1 where it should carry nothing.
    """
    inverse = compute_inverse_dynamics(motion, q, v, a)
    torque, wrench = inverse.torque.copy(), inverse.wrench.copy()
    model = motion.robot.model
    for joint, part in list_load_cases(motion.robot, q, phase.loads)[-1].parts:
        part = part * loaded[:, None]
        wrench -= part
        torque -= np.einsum("sij,si->sj", inverse.jacobians, part) @ map_axes(model, joint)
    shared = share_weight(
        motion, phase, q, lambda j, w: np.einsum("sij,si->sj", inverse.jacobians, w) @ map_axes(model, j)
    )
    torque = torque if shared is None else torque + shared
    if not phase.contacts:
        return CarriedMotion(torque, np.zeros((len(q), 0, 3)), np.zeros(len(q)))
    share = make_contact_share(motion, phase)
    levers = list_levers(model, phase, inverse.jacobians)
    forces = share_forces(share, wrench, make_joints(motion, torque, levers), loosened)
    torque -= np.einsum("skc,sc->sk", levers, forces.reshape(len(q), -1))
    made = forces.reshape(len(q), -1) @ share.grasp.T
    missing = np.abs(made - share.about_middle(wrench)).max(axis=1)
    return CarriedMotion(torque, forces, missing)


def share_forces(
    share: ContactShare, wrench: Float[np.ndarray, "S 6"], joints: Joints, loosened: Float[np.ndarray, "S C"]
) -> Float[np.ndarray, "S C 3"]:
    """Return forces inside the friction pyramids that make wrenches about the world's origin [N].

    Normal forces stay below 85 % of their caps where other contacts can carry the rest.  Forces are small, and so are
    the joints' torques relative to their limits: least squares with a strictly convex cost, so that forces change
    continuously with wrench and weights.
    """
    from scipy.optimize import nnls  # slow to import, and rarely needed

    wanted = share.about_middle(wrench) / share.weight
    edges = share.edges
    count, n_edges, n_joints = len(share.ground.points), share.edges.shape[1], len(joints.effort)
    forces = np.zeros((len(wrench), count, 3))
    caps = _CAP_SHARE * share.ground.caps / share.weight
    capped = np.flatnonzero(caps < 1.0)  # one that could carry the whole robot does not bind
    # The last columns are what is left of each cap: normal force + rest = cap, and no rest is negative.
    table = np.zeros((6 + 3 * count + n_joints + n_edges + len(capped), n_edges + len(capped)))
    target = np.zeros(len(table))
    points, torques = slice(6, 6 + 3 * count), slice(6 + 3 * count, 6 + 3 * count + n_joints)
    last = len(table) - len(capped)
    table[:6, :n_edges] = _EXACT * share.grasp @ edges
    table[last - n_edges : last, :n_edges] = _EDGE * np.eye(n_edges)
    of_point = np.repeat(np.eye(count), n_edges // count, axis=1)  # each edge has a unit normal force
    table[last:, :n_edges] = _CAPPED * of_point[capped]
    table[last:, n_edges:] = _CAPPED * np.eye(len(capped))
    target[last:] = _CAPPED * caps[capped]
    for k, row in enumerate(wanted):
        poll()
        weights = np.repeat(1.0 + (_UNLOADED - 1.0) * loosened[k], 3)
        table[points, :n_edges] = weights[:, None] * edges
        table[torques, :n_edges] = share.weight * (joints.lever[k] @ edges) / joints.effort[:, None]
        target[:6], target[torques] = _EXACT * row, joints.torque[k] / joints.effort
        try:
            amount = np.asarray(nnls(table, target)[0])[:n_edges]
        except RuntimeError:  # too many steps
            forces[k] = forces[k - 1] if k else 0.0
            continue
        forces[k] = share.weight * (edges @ amount).reshape(count, 3)
    return forces
