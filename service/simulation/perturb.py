"""Random errors of the physics against the plan: places of surfaces, masses, friction, and the robot's first pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from service.simulation.options import SimulationOptions
from service.verify import Motion

# Largest errors at size 1.
PLACE_M = 0.01  # of every piece of the world along each axis [m]
MASS_SHARE = 0.05  # of every link of the robot
FRICTION = 0.1  # of the coefficient between robot and world
JOINT_RAD = 0.01  # of the joints when the robot is put down [rad, m for 0.1 of it]
TOUCHING_M = 0.02  # between a first contact and the piece that carries it [m]


@dataclass(frozen=True)
class Perturbation:
    """Errors of one simulation.

    Attributes:
        places: displacement by piece (3,) [m]; none of pieces that carry the robot's first pose, and the same of pieces
            that an object may touch in one phase: the walls of its hole, and what is below them, are one body.
        masses: factor by joint of the robot's model.
        friction: added to the coefficient between robot and world.
        start: (k,) error of the servo joints when the robot is put down [rad, m].
    """

    places: Mapping[str, Float[np.ndarray, "3"]]
    masses: Mapping[int, float]
    friction: float
    start: Float[np.ndarray, "k"]


def draw_perturbation(motion: Motion, is_turning: np.ndarray, options: SimulationOptions) -> Perturbation:
    """Draw the errors of a simulation, of the size ``options.perturb`` and repeatable by ``options.seed``.

    Args:
        motion: of the plan.
        is_turning: (k,) whether each servo joint is revolute.
        options: of the simulation.
    """
    size, draw = options.perturb, np.random.default_rng([options.seed, 1]).uniform
    first = motion.phases[0].contacts if motion.phases else ()
    held = np.concatenate([contact.points for contact in first]) if first else np.zeros((0, 3))
    places = {}
    for piece in motion.scene.pieces:
        error = draw(-size * PLACE_M, size * PLACE_M, 3)
        places[piece.name] = np.zeros(3) if _is_near(piece.vertices, held) else error
    for names in group_pieces(motion):
        still = [name for name in names if not places[name].any()]
        places |= dict.fromkeys(names, places[(still or names)[0]])
    masses = {
        joint: float(draw(1.0 - size * MASS_SHARE, 1.0 + size * MASS_SHARE))
        for joint in range(1, motion.robot.model.njoints)
    }
    friction = float(draw(-size * FRICTION, size * FRICTION))
    reach = size * JOINT_RAD * np.where(is_turning, 1.0, 0.1)
    return Perturbation(places, masses, friction, draw(-reach, reach))


def group_pieces(motion: Motion) -> list[list[str]]:
    """Return the names of pieces that objects may touch together in a phase, in groups without a common piece."""
    items, order = {item.name for item in motion.objects}, [piece.name for piece in motion.scene.pieces]
    groups: list[set[str]] = []
    for phase in motion.phases:
        touched: dict[str, set[str]] = {}
        for allowance in phase.allowances:
            one, other = allowance.first, allowance.second
            if one.link in items and other.owner == "scene" and other.body in order:
                touched.setdefault(str(one.link), set()).add(other.body)
        for names in touched.values():
            apart = [group for group in groups if not group & names]
            groups = [*apart, names.union(*(group for group in groups if group & names))]
    return [sorted(group, key=order.index) for group in groups if len(group) > 1]


def _is_near(vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "C 3"]) -> bool:
    """Return whether any of the points is in a hull or less than 2 cm beyond its faces."""
    if not len(points):
        return False
    try:
        faces = ConvexHull(vertices).equations
    except QhullError:  # flat
        return False
    return bool((points @ faces[:, :3].T + faces[:, 3]).max(axis=1).min() < TOUCHING_M)
