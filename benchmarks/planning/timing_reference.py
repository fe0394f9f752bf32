"""The fastest time law of a curve by a linear program on a fine grid, to hold ``service.motion.timing`` against."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy.sparse as sp
from jaxtyping import Float
from scipy.optimize import linprog

from costs.curve import Curve
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel, RobotSource
from service.motion.spline import PhasePath, make_spline


@dataclass(frozen=True)
class TimingProblem:
    """A robot of revolute joints with individual speed and acceleration limits, and a curve for it."""

    kind: str
    robot: RobotModel
    curve: Curve


def fastest_duration(
    curve: Curve,
    velocity: Float[np.ndarray, "n"],
    acceleration: Float[np.ndarray, "n"],
    rests: Sequence[float] = (),
    cells: int = 60,
) -> float:
    """Return the shortest time from rest to rest within these limits [s].

    With x = (ds/dt)^2 at grid points and constant d2s/dt2 between them, limits of speed and acceleration (at both ends
    of each cell) are linear in x; the largest sum of x is the largest x everywhere.  ds/dt vanishes at a rest only
    where the tangent does not: where it does, the robot rests however fast the path parameter runs.

    Args:
        curve: from rest to rest.
        velocity, acceleration: limits, symmetric.
        rests: path parameters within the curve at which the robot rests as well.
        cells: per knot interval.
    """
    knots = curve.knots
    even = (knots[:-1, None] + np.diff(knots)[:, None] * np.arange(cells) / cells).ravel()
    grid = np.unique(np.concatenate([even, knots[-1:], rests]))
    width = np.diff(grid)
    piece = np.clip(np.searchsorted(knots, 0.5 * (grid[1:] + grid[:-1])) - 1, 0, len(knots) - 2)
    _, _, c2, c3 = curve.coefficients()[:, piece]
    rows, here = [], np.arange(len(width))
    for end in (0, 1):
        s = grid[end : len(width) + end]
        slope, bend = curve(s, 1), 2.0 * c2 + 6.0 * c3 * (s - knots[piece])[:, None]
        for j in np.flatnonzero(np.isfinite(acceleration)):
            gain = slope[:, j] / (2.0 * width)
            values = np.stack([-gain, gain])
            values[end] += bend[:, j]
            at = (np.tile(here, 2), np.concatenate([here, here + 1]))
            rows.append(sp.coo_matrix((values.ravel() / acceleration[j], at), (len(width), len(grid))))
    half = sp.vstack(rows).tocsr()
    highest = 1.0 / np.maximum((np.abs(curve(grid, 1)) / velocity).max(axis=1), 1e-6) ** 2
    stops = np.searchsorted(grid, [knots[0], *rests, knots[-1]])
    highest[stops] = np.where(np.abs(curve(grid[stops], 1)).max(axis=1) > 1e-9, 0.0, highest[stops])
    found = linprog(
        -np.ones(len(grid)),
        A_ub=sp.vstack([half, -half]),
        b_ub=np.ones(2 * half.shape[0]),
        bounds=np.stack([np.zeros(len(grid)), highest], axis=1),
        method="highs",
    )
    if found.status != 0:
        raise ValueError(f"no fastest law found: {found.message}")
    speed = np.sqrt(np.maximum(found.x, 0.0))
    return float(np.sum(2.0 * width / (speed[1:] + speed[:-1])))


def timing_problems(seed: int) -> Iterator[TimingProblem]:
    """Yield endless problems: 1 to 6 joints, 3 to 15 waypoints on straight lines, waves and random walks in turn."""
    rng = np.random.default_rng(seed)
    while True:
        for kind in ("straight", "wave", "walk"):
            n, count = int(rng.integers(1, 7)), int(rng.integers(3, 16))
            robot = chain(rng.uniform(0.5, 3.0, n), 10.0 ** rng.uniform(0.0, 1.0, n))
            u = np.linspace(0.0, 1.0, count)[:, None]
            if kind == "straight":
                q = u * rng.normal(size=n)
            elif kind == "wave":
                turns = [np.sin(np.pi * k * u + rng.uniform(0.0, 6.0, n)) / k for k in (1, 2, 3)]
                q = sum((turn * rng.normal(size=n) for turn in turns), np.zeros((count, n)))
            else:
                q = np.cumsum(rng.normal(size=(count, n)) * 0.3, axis=0)
            yield TimingProblem(kind, robot, spline_through(robot, q))


def spline_through(robot: RobotModel, q: Float[np.ndarray, "T n"]) -> Curve:
    """Return the curve that plans take through these waypoints."""
    path = PhasePath("path", q, ())
    return make_spline(KinematicsEngine(robot), [path], robot.lower, robot.upper, robot.velocity).curve


def chain(velocity: Float[np.ndarray, "n"], acceleration: Float[np.ndarray, "n"]) -> RobotModel:
    """Return a chain of revolute joints without bodies or weight."""
    model = pin.Model()
    for k in range(len(velocity)):
        model.addJoint(k, pin.JointModelRZ(), pin.SE3.Identity(), f"joint{k}")
    free = np.full(model.nq, np.inf)
    return RobotModel(
        name="chain",
        model=model,
        joint_names=tuple(f"joint{k}" for k in range(model.nq)),
        lower=-free,
        upper=free,
        velocity=velocity,
        acceleration=acceleration,
        effort=free,
        bodies=(),
        is_floating=False,
        groups={},
        link_groups={},
        postures={},
        ignored_pairs=frozenset(),
        fixed_links=frozenset(),
        mechanism_links=frozenset(),
        source=RobotSource("", "", {}),
    )
