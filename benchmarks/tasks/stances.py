"""Random stances of a robot on all kinds of contacts, and solvers that decide their equilibrium independently."""

from __future__ import annotations

import clarabel
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from costs.contact import GRAVITY, WorldContacts
from costs.static_region import StaticRegion

UP = np.array([0.0, 0.0, 1.0])
SOLE = np.array([[x, y, 0.0] for x in (-0.09, 0.17) for y in (-0.06, 0.06)])


def make_contacts(points: ArrayLike, normals: ArrayLike, friction: ArrayLike, caps: ArrayLike) -> WorldContacts:
    """Return contacts of broadcast values; normals need not be of unit length."""
    points = np.atleast_2d(np.asarray(points, dtype=float))
    normals = np.broadcast_to(np.asarray(normals, dtype=float), points.shape)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    n = len(points)
    return WorldContacts(points, normals, np.broadcast_to(friction, n), np.broadcast_to(caps, n))


def foot(x: float, y: float, z: float = 0.0) -> Float[np.ndarray, "4 3"]:
    """Return the corners of a level sole."""
    return SOLE + np.array([x, y, z])


def random_stance(rng: np.random.Generator) -> tuple[WorldContacts, float]:
    """Return contacts and mass [kg]: feet on ground that leans, hands on walls and rails, a body between two walls."""
    mass = rng.uniform(30.0, 160.0)
    weight = mass * GRAVITY
    friction = rng.uniform(0.2, 1.1)
    parts = []
    for side in ((1.0, -1.0), (1.0,), ())[rng.choice(3, p=[0.6, 0.3, 0.1])]:
        turn = Rotation.from_euler("zyx", rng.uniform(-1.0, 1.0, 3) * [1.5, 0.3, 0.3]).as_matrix()
        at = [rng.uniform(-0.3, 0.3), side * rng.uniform(0.09, 0.3), rng.uniform(0.0, 0.4)]
        parts.append(make_contacts(SOLE @ turn.T + at, turn[:, 2], friction, rng.uniform(0.6, 2.0) * weight))
    for _ in range(rng.integers(0, 3)):  # hands: on a wall or a rail
        normal = rng.normal(size=3) * [1.0, 1.0, 0.2] if rng.random() < 0.5 else UP + rng.normal(size=3) * 0.4
        at = rng.uniform([-0.8, -0.8, 0.7], [0.8, 0.8, 1.6])
        parts.append(make_contacts(at, normal, rng.uniform(0.0, 1.0), rng.uniform(0.05, 0.6) * weight))
    if rng.random() < 0.35 or not parts:  # squeezed between two walls
        away = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
        chest = np.array([[0.25, y, z] for y in (-0.15, 0.15) for z in (0.9, 1.2)])
        pressing = rng.uniform(0.1, 2.0) * weight
        parts.append(make_contacts(chest @ away.T, -away[:, 0], friction, pressing))
        parts.append(make_contacts((chest * [-1.0, 1.0, 1.0]) @ away.T, away[:, 0], friction, pressing))
    return WorldContacts.join(parts), mass


def random_load(rng: np.random.Generator, mass: float, share: float = 0.15) -> Float[np.ndarray, "6"]:
    """Return a push at a place within reach, as force and moment about the world origin [N, Nm]."""
    force = rng.normal(size=3) * share * mass * GRAVITY / 3.0
    return np.concatenate([force, np.cross(rng.uniform([-0.7, -0.7, 0.2], [0.7, 0.7, 1.6]), force)])


def _balance(
    contacts: WorldContacts, forces: Float[np.ndarray, "C K 3"], mass: float, wrench: Float[np.ndarray, "6"]
) -> tuple[Float[np.ndarray, "6 columns"], Float[np.ndarray, "6"]]:
    """Return rows ``A x = b`` over force columns (C * K) and the centre of mass (2)."""
    weight = mass * GRAVITY
    count, per_point = forces.shape[:2]
    rows = np.zeros((6, count * per_point + 2))
    rows[:3, :-2] = forces.reshape(-1, 3).T
    rows[3:, :-2] = np.cross(np.repeat(contacts.points, per_point, axis=0), forces.reshape(-1, 3)).T
    rows[3, -1], rows[4, -2] = -weight, weight
    return rows, np.concatenate([[0.0, 0.0, weight], np.zeros(3)]) - wrench


def solve_pyramid(
    contacts: WorldContacts,
    mass: float,
    wrench: Float[np.ndarray, "6"],
    direction: Float[np.ndarray, "2"] | None = None,
    com: Float[np.ndarray, "2"] | None = None,
) -> Float[np.ndarray, "2"] | None:
    """Return the farthest centre of mass in a direction (any for None), by scipy; None where nothing holds."""
    weight = mass * GRAVITY
    edges = weight * contacts.list_pyramid_edges()
    A, b = _balance(contacts, edges, mass, wrench)
    n = A.shape[1] - 2
    caps = np.zeros((len(edges), n + 2))
    caps[np.repeat(np.arange(len(edges)), edges.shape[1]), np.arange(n)] = 1.0
    cost = np.zeros(n + 2)
    if direction is not None:
        cost[n:] = -np.asarray(direction)
    bounds = [(0, None)] * n + ([(None, None)] * 2 if com is None else [(c, c) for c in com])
    solution = linprog(cost, caps, contacts.caps / weight, A / weight, b / weight, bounds, method="highs-ipm")
    if solution.status not in (0, 2):
        solution = linprog(cost, caps, contacts.caps / weight, A / weight, b / weight, bounds, method="highs-ds")
    if solution.status not in (0, 2):
        raise RuntimeError(solution.message)
    return solution.x[n:] if solution.status == 0 else None


def solve_cone(
    contacts: WorldContacts,
    mass: float,
    wrench: Float[np.ndarray, "6"],
    direction: Float[np.ndarray, "2"] | None = None,
    com: Float[np.ndarray, "2"] | None = None,
) -> Float[np.ndarray, "2"] | None:
    """Return the same with exact friction cones, by Clarabel; None where it finds no forces."""
    weight, count = mass * GRAVITY, len(contacts.points)
    axes = np.broadcast_to(weight * np.eye(3), (count, 3, 3))
    A, b = _balance(contacts, axes, mass, wrench)
    if com is not None:
        A, b = (
            np.vstack([A, weight * np.eye(2, A.shape[1], A.shape[1] - 2)]),
            np.concatenate([b, weight * np.asarray(com)]),
        )
    n = A.shape[1]
    blocks, limits, cones = [A / weight], [b / weight], [clarabel.ZeroConeT(len(b))]
    caps = np.zeros((count, n))
    for i, normal in enumerate(contacts.normals):
        caps[i, 3 * i : 3 * i + 3] = normal
    blocks, limits = [*blocks, caps], [*limits, contacts.caps / weight]
    cones.append(clarabel.NonnegativeConeT(count))
    for i, (normal, mu) in enumerate(zip(contacts.normals, contacts.friction, strict=True)):
        rows = np.zeros((4, n))
        rows[0, 3 * i : 3 * i + 3] = -mu * normal
        rows[1:, 3 * i : 3 * i + 3] = -(np.eye(3) - np.outer(normal, normal))
        blocks, limits = [*blocks, rows], [*limits, np.zeros(4)]
        cones.append(clarabel.SecondOrderConeT(4))
    cost = np.zeros(n)
    if direction is not None:
        cost[n - 2 :] = -np.asarray(direction)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    nothing = sparse.csc_matrix((n, n))
    matrix = sparse.csc_matrix(np.vstack(blocks))
    solution = clarabel.DefaultSolver(nothing, cost, matrix, np.concatenate(limits), cones, settings).solve()
    is_solved = solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    return np.array(solution.x)[n - 2 :] if is_solved else None


def witness_defects(contacts: WorldContacts, mass: float, region: StaticRegion) -> Float[np.ndarray, "3"]:
    """Return the largest defect of balance, friction cone and force cap over all witnesses, in weights (times 1 m)."""
    weight = mass * GRAVITY
    worst = np.zeros(3)
    for vertex, by_wrench in zip(region.vertices, region.witnesses, strict=True):
        for forces, wrench in zip(by_wrench, region.wrenches, strict=True):
            gravity = np.array([0.0, 0.0, -weight])
            force = forces.sum(axis=0) + wrench[:3] + gravity
            moment = np.cross(contacts.points, forces).sum(axis=0) + wrench[3:] + np.cross([*vertex, 0.0], gravity)
            pressing = np.einsum("ci,ci->c", forces, contacts.normals)
            sideways = np.linalg.norm(forces - pressing[:, None] * contacts.normals, axis=1)
            defects = [
                max(np.abs(force).max(), np.abs(moment).max()),
                (sideways - contacts.friction * pressing).max(),
                (pressing - contacts.caps).max(),
            ]
            worst = np.maximum(worst, np.array(defects) / weight)
    return worst
