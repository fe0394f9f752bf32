"""Configurations near one that is unfit: off what it nearly touches, or out of what it is in collision with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.poses import Seed, find_pose
from service.body.sampling import free_coordinates
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody

SPREADS = (0.2, 0.2, 0.4, 0.4, 0.8, 0.8)  # of random guesses about a configuration [rad, m]
LEAST_GAIN = 0.25  # of the clearance that is aimed at


def find_clear_pose(
    solver: PhaseSolver, step: str, q: Float[np.ndarray, "n"], margin: float
) -> Float[np.ndarray, "n"] | None:
    """Return a configuration near ``q`` with more clearance; None where none is found.

    Args:
        solver: of the robot.
        step: its name.
        q: where links are nearer to each other, or to pieces, than ``margin``.
        margin: clearance that is aimed at [m].
    """
    body = replace(solver.body, aims=replace(solver.body.aims, margin=margin), nominal=q)
    near = replace(solver, body=body).pose_problem(step, ends=(), fraction=0.2)
    moved = find_pose(near, [("itself", q)]).q
    return moved if body.measure_nearest(moved) > body.measure_nearest(q) + LEAST_GAIN * margin else None


def find_free_pose(solver: PhaseSolver, step: str) -> Solved:
    """Return a configuration near the nominal one, from it or from random ones ever farther away."""
    return find_pose(replace(solver.pose_problem(step), most=None), _draw_about(solver.body, solver.seed))


def _draw_about(body: WholeBody, seed: int) -> Iterator[Seed]:
    """Yield the nominal configuration, then random ones of what carries nothing."""
    yield "itself", body.nominal
    rng, joints = np.random.default_rng(seed), free_coordinates(body)
    for reach in SPREADS:
        guess = body.nominal.copy()
        guess[joints] += rng.uniform(-reach, reach, len(joints))
        yield f"random within {reach:g} rad", np.clip(guess, body.robot.lower, body.robot.upper)
