"""Configurations from which poses are solved: the robot's postures, and random ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from service.body.whole_body import WholeBody

JOINT_SPREAD, BASE_SPREAD = 0.5, 0.1  # of random guesses, standard deviations [rad, m]

Seed = tuple[str, Float[np.ndarray, "n"]]
"""A configuration by name."""


def posture_guesses(body: WholeBody) -> list[Seed]:
    """Return configurations to start from by name: the nominal one, then the robot's postures where it stands."""
    guesses = [("nominal", body.nominal.copy())]
    for name, posture in sorted(body.robot.postures.items()):
        guess = posture.copy()
        if body.robot.is_floating:
            guess[: len(BASE_NAMES)] = body.nominal[: len(BASE_NAMES)]
        if not np.array_equal(guess, body.nominal):
            guesses.append((name, guess))
    return guesses


def random_guesses(body: WholeBody, count: int, seed: int) -> list[Float[np.ndarray, "n"]]:
    """Return random configurations about the nominal one, within the limits."""
    robot, rng = body.robot, np.random.default_rng(seed)
    spread = np.full(robot.n, JOINT_SPREAD)
    if robot.is_floating:
        spread[: len(BASE_NAMES)] = BASE_SPREAD
    steps = spread * rng.normal(size=(count, robot.n))
    return list(np.clip(body.nominal + steps, robot.lower, robot.upper))


def name_seeds(name: str, guesses: Iterable[Float[np.ndarray, "n"]]) -> Iterator[Seed]:
    """Yield configurations under one name."""
    return ((name, guess) for guess in guesses)
