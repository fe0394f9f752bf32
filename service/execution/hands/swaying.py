"""Hands of a robot whose base something else lets sway: joints that keep them at their places in the world."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.execution.driver import RobotReading
from service.execution.guards import Finding, Severity
from service.verify import Motion, PoseTarget

SPEED_SHARE = 0.5  # of the joints' speed limits that a correction may use
DAMPING = 1e-4  # of the least squares, as a share of a joint's lever of 1 m
RETURN_PER_S = 1.0  # rate at which joints go back to the plan where no hand needs them
SLACK_M, SLACK_DEG = 0.001, 0.05  # beyond the sway of the certificate that still counts as within it


class SwayCorrection:
    """Damped least squares on the poses of all frames that a plan brings to places in the world.

    The plan has the base where the scene has it.  A base that is measured elsewhere carries its hands along, so that
    each cycle turns the joints towards ``T^-1 X``, where ``T`` is the base's measured displacement and ``X`` the
    frame's planned pose.  Between two cycles a joint turns by at most a share of its speed limit.
    """

    def __init__(self, motion: Motion, period_s: float) -> None:
        """Prepare the correction of a plan.

        Args:
            motion: with the sway that its certificate allows for, and targets in the world.
            period_s: of the cycle [s].
        """
        robot, self._sway, self._period_s = motion.robot, motion.sway, period_s
        targets = [
            t for phase in motion.phases for t in phase.targets if isinstance(t, PoseTarget) and t.at is not None
        ]
        self._turns = {t.frame: False for t in targets}
        for target in targets:
            self._turns[target.frame] |= target.rotation is not None
        self._model, self._data = robot.model, robot.model.createData()
        self._planned = robot.model.createData()
        self._lower, self._upper = robot.lower, robot.upper
        self._most = SPEED_SHARE * np.where(np.isfinite(robot.velocity), robot.velocity, 1.0) * period_s
        self._offset = np.zeros(robot.n)

    def step(
        self, planned: Float[np.ndarray, "n"], base: Float[np.ndarray, "4 4"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return how far all coordinates are moved off the plan, and how fast.

        Args:
            planned: configuration of the plan.
            base: measured pose of the base, against the one that the plan has.
        """
        model, data = self._model, self._data
        q = planned + self._offset
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, self._planned, planned)
        inverse = pin.SE3(base).inverse()
        rows, errors = [np.zeros((0, model.nv))], [np.zeros(0)]
        for name, turns in self._turns.items():
            frame = model.getFrameId(name)
            now = pin.updateFramePlacement(model, data, frame)
            wanted = inverse * pin.updateFramePlacement(model, self._planned, frame)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
            off = (
                pin.log6(now.inverse() * wanted).vector
                if turns
                else now.rotation.T @ (wanted.translation - now.translation)
            )
            rows.append(jacobian[: len(off)])
            errors.append(off)
        jacobian, error = np.concatenate(rows), np.concatenate(errors)
        back = -RETURN_PER_S * self._period_s * self._offset
        square = jacobian @ jacobian.T + DAMPING * np.eye(len(error))
        change = back + jacobian.T @ np.linalg.solve(square, error - jacobian @ back)
        change *= min(1.0, float((self._most / np.maximum(np.abs(change), 1e-12)).min(initial=1.0)))
        change = np.clip(q + change, self._lower, self._upper) - q
        self._offset = self._offset + change
        return self._offset, change / self._period_s

    def judge(self, reading: RobotReading) -> tuple[Finding, ...]:
        """Return a finding where the base is measured beyond the sway for which the certificate holds."""
        if reading.base_offset is None:
            return ()
        base = np.asarray(reading.base_offset)
        off = float(np.linalg.norm(base[:3, 3]))
        angle = float(np.rad2deg(np.linalg.norm(pin.log3(base[:3, :3]))))
        if off <= self._sway.distance_m + SLACK_M and angle <= self._sway.angle_deg + SLACK_DEG:
            return ()
        words = (
            f"the base is {1e3 * off:.0f} mm and {angle:.1f} deg off its place; the plan holds within "
            f"{1e3 * self._sway.distance_m:g} mm and {self._sway.angle_deg:g} deg"
        )
        return (Finding(Severity.HOLD, "base", off, self._sway.distance_m, words, name="sway"),)
