"""How much more than the stated loads a motion could carry, until the ground or a joint no longer holds it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.contact import GRAVITY, WorldContacts
from service.verify import (
    Ground,
    LinearProgram,
    Motion,
    Phase,
    compute_forces,
    find_times,
    list_load_cases,
    split_motion,
)

N_SAMPLES = 9  # per phase
MOST = 20.0  # times the stated load


def find_held_shares(motion: Motion) -> dict[str, float]:
    """Return for each link that carries a load the largest multiple of it that every sampled pose still carries.

    Torques grow in proportion to the load, and contact forces inside the friction pyramids have to balance it. It is an
    estimate at samples, not part of the certificate.
    """
    shares: dict[str, float] = {}
    for phase, part in zip(motion.phases, split_motion(motion), strict=False):  # a load may be on what a hand holds
        if phase.loads:
            share = _find_share(part, phase)
            shares |= {load.link: min(share, shares.get(load.link, share)) for load in phase.loads}
    return shares


def _find_share(motion: Motion, phase: Phase) -> float:
    s = np.linspace(phase.first, phase.last, N_SAMPLES)
    share = MOST
    if motion.law is not None:
        dynamics = compute_forces(motion, motion.law, phase, find_times(motion.law, s))
        limited = np.flatnonzero(np.isfinite(motion.robot.effort) & (motion.robot.effort > 0.0))
        free, full = dynamics.torque[0][:, limited], dynamics.torque[-1][:, limited]
        rise, effort = full - free, motion.robot.effort[limited]
        with np.errstate(divide="ignore"):
            room = np.where(rise >= 0.0, effort - free, effort + free) / np.abs(rise)
        share = min(share, float(np.maximum(room, 0.0).min(initial=MOST)))
    if phase.support is not None and phase.contacts:
        q = motion.curve(s)
        wrenches = list_load_cases(motion.robot, q, phase.loads)[-1].wrench
        share = min(share, float(_find_held(motion, phase, q, wrenches).min()))
    return share


def _find_held(
    motion: Motion, phase: Phase, q: Float[np.ndarray, "S n"], wrenches: Float[np.ndarray, "S 6"]
) -> Float[np.ndarray, "S"]:
    """Return the largest multiples of wrenches that the ground's forces balance together with the weight."""
    model = motion.robot.model
    data = model.createData()
    ground = WorldContacts(*Ground.under(phase.contacts))
    fans = np.asarray(ground.list_pyramid_edges())
    arms = np.cross(ground.points[:, None], fans)
    edges = np.concatenate([fans, arms], axis=2).reshape(-1, 6).T
    weight = np.array([0.0, 0.0, -GRAVITY * float(pin.computeTotalMass(model))])
    cost = np.append(np.zeros(edges.shape[1]), -1.0)
    most = np.append(np.full(edges.shape[1], np.inf), MOST)
    program = LinearProgram(cost, np.column_stack([edges, wrenches[0]]), most)
    shares = np.zeros(len(q))
    for k, wrench in enumerate(wrenches):
        program.change_column(edges.shape[1], wrench)
        com = np.array(pin.centerOfMass(model, data, q[k]))
        solved = program.solve(-np.concatenate([weight, np.cross(com, weight)]))
        shares[k] = 0.0 if solved is None else solved[-1]
    return shares
