"""What the service asks of a robot, and the robots that can be named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown, would_do
from service.execution.driver import RobotDriver
from service.execution.reference import PlannedReference

GROUP = "scopt_robots"  # of entry points
BUNDLED = {
    "sim": "service.work.robot.simulated:open_simulated",
    "udp": "service.work.robot.udp:open_udp",
    "trajectory": "service.work.robot.trajectory:open_trajectory",
}


class Robot(Protocol):
    """A robot, real or simulated, for one plan after the other."""

    @property
    def is_simulated(self) -> bool:
        """Whether it can be put anywhere."""

    def drive(self, reference: PlannedReference, folder: Path, is_placed: bool, tolerance: float) -> RobotDriver:
        """Return the driver for a plan; its joints are compared with the plan's start by the caller.

        Args:
            reference: the plan.
            folder: its result folder, which is removed afterwards.
            is_placed: whether a simulated robot is put at the plan's start first.
            tolerance: how far the base may be from the plan's start, where the robot knows it [m, rad].

        Raises:
            ExecutionError: one sentence: the robot cannot carry out this plan, or stands elsewhere.
        """

    def follow(self, phase: int) -> None:
        """Take note of the phase of the plan after a control cycle."""

    def pose_world_base(self) -> Float[np.ndarray, "4 4"] | None:
        """Return the measured pose of the base (4, 4); None where nothing measures it."""

    def close(self) -> None:
        """Let go of the robot."""


OpenRobot = Callable[[Mapping[str, str]], Robot]


def open_robot(text: str) -> Robot:
    """Open a robot by ``NAME`` or ``NAME,key=value,...``.

    A name is ``sim``, ``udp``, ``trajectory``, or an entry point of the group ``scopt_robots``: a function of the
    options that returns a ``Robot``.

    Raises:
        RequestError: there is no such robot, or an option cannot be used.
        ExecutionError, ResultError: the robot does not answer, or lacks a library.
    """
    name, *parts = text.split(",")
    options = {}
    for part in parts:
        key, equals, value = part.partition("=")
        if not (key and equals):
            raise RequestError(f"--robot {shown(text)}: expected NAME,key=value,..., got {shown(part)}")
        options[key.strip()] = value.strip()
    return _find(name.strip())(options)


def _find(name: str) -> OpenRobot:
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name in BUNDLED:
        module, _, attribute = BUNDLED[name].partition(":")
        bundled: OpenRobot = getattr(import_module(module), attribute)
        return bundled
    if name in found:
        try:
            opened: OpenRobot = found[name].load()
        except Exception as error:  # foreign code
            raise RequestError(f"--robot {name}: {found[name].value} cannot be loaded: {error}") from None
        return opened
    known = sorted({*BUNDLED, *found})
    raise RequestError(f"--robot: unknown robot {shown(name)}; expected {would_do(name, known)}")


def read_options(robot: str, options: Mapping[str, str], defaults: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers of a robot's options, and its defaults for the others.

    Raises:
        RequestError: an option is unknown, or no number.
    """
    values = dict(defaults)
    for key, text in options.items():
        if key not in defaults:
            raise RequestError(f"--robot {robot}: unknown option {shown(key)}; expected {would_do(key, defaults)}")
        try:
            values[key] = float(text)
        except ValueError:
            raise RequestError(f"--robot {robot}: {key}: expected a number, got {shown(text)}") from None
        if not np.isfinite(values[key]):
            raise RequestError(f"--robot {robot}: {key}: expected a finite number, got {text}")
    return values
