"""The only place that talks to a driver: its exceptions become problems, and commands are finite or not sent."""

from __future__ import annotations

import numpy as np

from costs.stopping import Stopped
from service.execution.driver import JointCommand, RobotDriver, RobotReading


class DriverLink:
    """A driver and what went wrong with it.

    Attributes:
        driver: the robot.
        sent: the last command that was handed over, or would have been.
        problem: what went wrong in this cycle; empty if nothing did.
        silent_s: time for which the driver has failed without a break [s].
        is_lost: whether it has been silent for too long, so that nothing is commanded any more.
        n_refused: number of commands with values that are not finite, in whose place the last one was held.
    """

    def __init__(self, driver: RobotDriver, at_rest: JointCommand, most_silent_s: float = 0.25) -> None:
        self.driver, self.sent, self.is_lost = driver, at_rest, False
        self.problem, self.silent_s, self.n_refused = "", 0.0, 0
        self._has_failed, self._most_silent_s = False, most_silent_s

    def read(self) -> RobotReading | None:
        """Return what the driver says; None where it fails."""
        if not self._has_failed:
            self.silent_s, self.problem = 0.0, ""
        self._has_failed = False
        try:
            return self.driver.read()
        except Stopped:
            raise
        except Exception as error:  # a driver is foreign code: whatever fails there must not leave the robot alone
            self._fail("read", error)
            return None

    def command(self, command: JointCommand) -> JointCommand:
        """Hand over a command, or the last one at rest if a value is not finite; return what was handed over."""
        n = len(self.sent.q)
        if not all(_is_usable(part, n) for part in (command.q, command.qd, command.tau)):
            self.n_refused += 1
            command = JointCommand(self.sent.q, np.zeros(n), self.sent.tau)
        self.sent = command
        try:
            self.driver.command(JointCommand(command.q.copy(), command.qd.copy(), command.tau.copy()))
        except Stopped:
            raise
        except Exception as error:
            self._fail("command", error)
        return command

    def _fail(self, what: str, error: Exception) -> None:
        self.problem = f"the driver's {what} failed: {type(error).__name__} {error}".strip()
        self.silent_s += 0.0 if self._has_failed else self.driver.period_s
        self._has_failed = True
        self.is_lost = self.is_lost or self.silent_s > self._most_silent_s


def _is_usable(values: np.ndarray, n: int) -> bool:
    return np.shape(values) == (n,) and bool(np.isfinite(values).all())
