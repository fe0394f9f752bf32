"""Trajectories of joints as other planners write them: points with times, positions, and perhaps their derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown
from service.replay.exchange.start_state import StartState

MAX_POINTS = 50_000
MAX_JOINTS = 500
LONGEST_S = 24 * 3600.0
UNIX_S = 1e8  # times of the clock are later, in seconds since 1970
KINDS = ("velocities", "accelerations")


@dataclass(frozen=True)
class JointTrajectory:
    """Points of a trajectory; every array (or list) has one row per point and is copied.

    Attributes:
        joint_names: columns of ``positions``.
        times: (K,) from the beginning [s]; None for a path without times.
        positions: (K, j) [rad, m].
        velocities, accelerations: (K, r) [rad/s, m/s; rad/s^2, m/s^2], or None.
        rate_names: columns of the derivatives where they differ from ``joint_names`` (a base whose orientation is a
            quaternion turns by ``base_yaw``, ``base_pitch`` and ``base_roll``).
        source: file, message or program that the trajectory comes from.
        model_id: name of the robot that it was planned for; empty if it is not known.
        start: state that it was planned from; None if it is not known.
        notes: what was read past, and assumptions of the reader.
    """

    joint_names: tuple[str, ...]
    times: Float[np.ndarray, "K"] | None
    positions: Float[np.ndarray, "K j"]
    velocities: Float[np.ndarray, "K r"] | None = None
    accelerations: Float[np.ndarray, "K r"] | None = None
    rate_names: tuple[str, ...] = ()
    source: str = "trajectory"
    model_id: str = ""
    start: StartState | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        for name in ("times", "positions", *KINDS):
            values = getattr(self, name)
            if values is None:
                continue
            try:
                object.__setattr__(self, name, np.array(values, dtype=float))
            except (TypeError, ValueError):
                raise RequestError(f"{self.source}: {name} must be numbers, one row per point") from None
        problems = list(self._list_problems())
        if problems:
            raise RequestError([f"{self.source}: {problem}" for problem in problems])

    @property
    def columns_of_rates(self) -> tuple[str, ...]:
        """Names of the columns of velocities and accelerations."""
        return self.rate_names or self.joint_names

    def _list_problems(self) -> Iterator[str]:
        names = self.joint_names
        if not names:
            yield "names no joint; joint_names is needed"
            return
        if len(names) > MAX_JOINTS:
            yield f"has {len(names)} joints; expected at most {MAX_JOINTS}"
            return
        yield from _list_bad_names(names)
        yield from _list_bad_names(self.rate_names)
        if self.positions.ndim != 2 or self.positions.shape[1] != len(names):
            yield f"positions has the shape {self.positions.shape}; expected one row per point of {len(names)} numbers"
            return
        count = len(self.positions)
        if not 2 <= count <= MAX_POINTS:
            yield f"has {count} points; expected 2 to {MAX_POINTS}"
            return
        yield from _list_not_finite("positions", self.positions, names)
        for kind in KINDS:
            values = getattr(self, kind)
            if values is None:
                continue
            if values.shape != (count, len(self.columns_of_rates)):
                expected = (count, len(self.columns_of_rates))
                yield f"{kind} has the shape {values.shape}; expected {expected}"
            else:
                yield from _list_not_finite(kind, values, self.columns_of_rates)
        if self.accelerations is not None and self.velocities is None:
            yield "gives accelerations and no velocities; both are needed to read it as quintics"
        if self.times is not None:
            yield from _list_bad_times(self.times, count)


def _list_bad_names(names: Sequence[str]) -> Iterator[str]:
    seen = set[str]()
    for name in names:
        if not name or len(name) > 200 or not name.isprintable():
            yield f"{shown(name)} is no name of a joint; expected 1 to 200 printable characters"
        if name in seen:
            yield f"joint {shown(name)} is given twice"
        seen.add(name)


def _list_not_finite(kind: str, values: np.ndarray, names: Sequence[str]) -> Iterator[str]:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0].tolist()
        yield f"{kind} of {shown(names[column])} at point {row} is {values[row, column]}; a finite number is needed"


def _list_bad_times(times: np.ndarray, count: int) -> Iterator[str]:
    if times.shape != (count,):
        yield f"has {times.size} times for {count} points"
    elif not np.all(np.isfinite(times)):
        row = int(np.argmin(np.isfinite(times)))
        yield f"the time of point {row} is {times[row]}; a finite number is needed"
    elif times[0] >= UNIX_S:
        yield f"begins at {times[0]:.0f} s; are these times of the clock? Subtract the first"
    elif times[0] < 0.0:
        yield f"begins at {times[0]:g} s; expected 0 or later"
    elif not np.any(np.diff(times)):
        yield f"all {count} points are at {times[0]:g} s; expected times that increase, or none"
    elif np.any(np.diff(times) <= 0.0):
        row = int(np.argmax(np.diff(times) <= 0.0))
        yield f"times do not increase: point {row} is at {times[row]:g} s, point {row + 1} at {times[row + 1]:g} s"
    elif times[-1] > LONGEST_S:
        yield f"lasts {times[-1]:g} s; expected at most {LONGEST_S:g} s (are these milliseconds or microseconds?)"
