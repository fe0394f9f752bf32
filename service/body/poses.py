"""Search for single poses: one seed after the other, until enough different feasible ones are found.

The goal of a reach, the anchor of a turn, a pose between stances, the node of an egress and the candidate of a stance
are poses that differ in their problems and seeds only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from scopt import Result
from service.body.monitor import Monitor
from service.body.whole_body import WholeBody

JOINT_SPREAD, BASE_SPREAD = 0.5, 0.1  # of random guesses, standard deviations [rad, m]

Seed = tuple[str, Float[np.ndarray, "n"]]
"""A configuration by name."""


class SolvedPose(Protocol):
    """A configuration that was solved for, feasible or not."""

    @property
    def q(self) -> Float[np.ndarray, "n"]:
        """The configuration."""

    @property
    def is_feasible(self) -> bool:
        """Whether it keeps every constraint."""

    @property
    def shortfall(self) -> float:
        """By how much it misses its constraints; poses of one problem are compared by it."""

    @property
    def result(self) -> Result:
        """Result of the optimiser."""


Pose = TypeVar("Pose", bound=SolvedPose)


def is_feasible(pose: SolvedPose) -> bool:
    """Return whether a pose keeps every constraint."""
    return pose.is_feasible


def measure_shortfall(pose: SolvedPose) -> Any:
    """Return by how much a pose misses its constraints."""
    return pose.shortfall


@dataclass(frozen=True)
class PoseProblem(Generic[Pose]):
    """A pose to find.

    Attributes:
        step: its name.
        solve: from a seed, a configuration or whatever the problem needs to begin with.
        monitor: checked before every solve, and told of it; None in a process that works for another.
        fraction: of the plan that is done, for its progress; None where a surrounding step reports it.
        most: largest number of seeds of one search.
        accepts: whether a pose is what is wanted.
        miss: by how much a pose that is not misses it; such poses are compared by it.
    """

    step: str
    solve: Callable[[Any], Pose]
    monitor: Monitor | None = None
    fraction: float | None = None
    most: int | None = None
    accepts: Callable[[Pose], bool] = is_feasible
    miss: Callable[[Pose], Any] = measure_shortfall

    def try_seed(self, name: str, seed: Any) -> Pose:
        """Solve from a seed and record what it cost."""
        monitor = self.monitor
        if monitor is None:
            return self.solve(seed)
        monitor.check()
        mark = monitor.mark()
        if self.fraction is None:
            pose = self.solve(seed)
        else:
            with monitor.step(self.step, self.fraction):
                pose = self.solve(seed)
        monitor.log_start(self.step, name, mark, pose.is_feasible, len(pose.result.history))
        return pose


@dataclass
class Poses(Generic[Pose]):
    """Different poses of one problem that were found so far.

    Attributes:
        problem: the problem.
        apart: least difference of a joint between two of them [rad, m]; 0 where equal ones are welcome.
        found: configurations that count as known.
        best: the pose that missed least, until one is found.
    """

    problem: PoseProblem[Pose]
    apart: float = 0.0
    found: list[Float[np.ndarray, "n"]] = field(default_factory=list)
    best: Pose | None = None

    def is_new(self, q: Float[np.ndarray, "n"]) -> bool:
        """Return whether a configuration differs from those that were found."""
        return self.apart == 0.0 or all(np.abs(q - other).max() > self.apart for other in self.found)

    def find(self, seeds: Iterable[tuple[str, Any]]) -> Iterator[Pose]:
        """Yield the poses that seeds lead to, each different from those before."""
        for name, seed in islice(seeds, self.problem.most):
            pose = self.problem.try_seed(name, seed)
            if self.problem.accepts(pose):
                if self.is_new(pose.q):
                    self.found.append(pose.q)
                    yield pose
            elif self.best is None or self.problem.miss(pose) < self.problem.miss(self.best):
                self.best = pose


def find_pose(problem: PoseProblem[Pose], seeds: Iterable[tuple[str, Any]]) -> Pose:
    """Return the first pose that is found, or the one that missed least.

    Raises:
        ValueError: no seed is given.
    """
    poses = Poses(problem)
    for pose in poses.find(seeds):
        return pose
    if poses.best is None:
        raise ValueError("at least one start is needed")
    return poses.best


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
