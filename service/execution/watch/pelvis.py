"""Comparison of the pelvis with the joints: its lean by the inertial unit and by the feet, and its place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from costs.robot.poses import matrix_rpy
from service.errors import ExecutionError
from service.execution.guards import Finding, Severity
from service.execution.sensing.filters import find_share, low_pass
from service.verify import PlantedContact


@dataclass(frozen=True)
class PelvisSettings:
    """How far the pelvis may be elsewhere than sensors and commands say.

    Attributes:
        lean_rad: between the sole of a foot that stands and the ground of the plan, by joints and inertial unit [rad].
        place_m: between the estimated pelvis and the commanded one [m].
        loaded_n: upright force of a foot that stands flat [N].
        cutoff_hz: of the low-pass filter of both.
        hold_s: time for which a limit must be exceeded [s].
    """

    lean_rad: float = 0.1
    place_m: float = 0.1
    loaded_n: float = 200.0
    cutoff_hz: float = 5.0
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        if not min(vars(self).values()) > 0.0:
            raise ExecutionError("pelvis: expected positive limits")


@dataclass(frozen=True)
class PelvisState:
    """Filtered lean [rad] by foot and place of the pelvis off its command [m], with the time of each [s]."""

    lean: Mapping[str, np.ndarray]
    off: Float[np.ndarray, "3"]
    exceeded_s: Mapping[str, float]


class PelvisWatch:
    """Comparison of pelvis, feet and commands of a robot on its feet."""

    def __init__(self, robot: RobotModel, period_s: float, settings: PelvisSettings | None = None) -> None:
        self.settings, self.period_s = settings or PelvisSettings(), period_s
        self._model, self._data = robot.model, robot.model.createData()
        self._feet = robot.link_groups.get("feet", ())
        self._share = find_share(self.settings.cutoff_hz, period_s)

    def start(self) -> PelvisState:
        """Return the state before the first reading."""
        return PelvisState({}, np.zeros(3), {})

    def step(
        self,
        state: PelvisState,
        q: Float[np.ndarray, "n"],
        commanded: Float[np.ndarray, "n"],
        rotation: Float[np.ndarray, "3 3"],
        planted: tuple[PlantedContact, ...],
        forces: Mapping[str, Float[np.ndarray, "3"]],
    ) -> tuple[tuple[Finding, ...], PelvisState]:
        """Return what contradicts itself, and the state one cycle later.

        Args:
            state: the earlier one.
            q: (n,) configuration that sensors and estimate show.
            commanded: (n,) of the last command.
            rotation: of the inertial unit, pelvis to world.
            planted: contacts of the phase.
            forces: measured by link, world axes [N].
        """
        limits, lean = self.settings, {}
        upright = np.array(q)
        upright[3 : len(BASE_NAMES)] = matrix_rpy(rotation)[::-1]
        pin.forwardKinematics(self._model, self._data, upright)
        over: dict[str, tuple[float, float, str]] = {}
        for contact in planted:
            foot = contact.link
            if foot not in self._feet or foot not in forces or forces[foot][2] < limits.loaded_n:
                continue
            place = pin.updateFramePlacement(self._model, self._data, self._model.getFrameId(foot))
            error = np.cross(contact.pose_world_link[:3, 2], place.rotation[:, 2])
            lean[foot] = low_pass(state.lean.get(foot), error, self._share)
            angle = float(np.linalg.norm(lean[foot]))
            if angle > limits.lean_rad:
                words = (
                    f"by joints and inertial unit {foot} stands {np.rad2deg(angle):.1f} deg off the ground, at most "
                    f"{np.rad2deg(limits.lean_rad):.1f}: an encoder is off or has slipped, or the foot tips"
                )
                over[f"lean of {foot}"] = angle, limits.lean_rad, words
        off = low_pass(state.off, q[:3] - commanded[:3], self._share)
        size = float(np.linalg.norm(off))
        if size > limits.place_m:
            words = f"the pelvis is {1e3 * size:.0f} mm off its command, at most {1e3 * limits.place_m:.0f} mm"
            over["pelvis"] = size, limits.place_m, words
        exceeded = {name: state.exceeded_s.get(name, 0.0) + self.period_s for name in over}
        findings = tuple(
            Finding(Severity.HOLD, name, value, limit, words, name="encoder or foot" if "lean" in name else "pelvis")
            for name, (value, limit, words) in over.items()
            if exceeded[name] > limits.hold_s
        )
        return findings, replace(state, lean=lean, off=off, exceeded_s=exceeded)
