"""Balance on the feet: capture-point feedback through the torques of the ankles.

The capture point ``xi = c + c' / omega`` is where a robot would come to rest (Pratt et al., Humanoids 2006).  It moves
by ``xi' = omega (xi - z)`` away from the ZMP ``z``; ``z = z_d + K (xi - xi_d)`` with ``K > 1`` brings it back to the
plan's (Englsberger et al., IROS 2011).  Each ankle makes the torque that puts the pressure of its foot there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot import RobotModel
from service.errors import ExecutionError
from service.execution.offset import OffsetFilter
from service.execution.reference import ReferenceState
from service.verify import PlantedContact, outside_polygon

GRAVITY = 9.81
LEAST_N = 20.0  # upright force from which a centre of pressure is known [N]
LEAST_HEIGHT_M = 0.1  # of the centre of mass over the soles, for omega
WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True)
class BalanceSettings:
    """How the ankles keep the balance while the feet alone touch anything.

    Attributes:
        gain: ``K``, displacement of the ZMP per displacement of the capture point from the plan.
        edge_m: border of the soles where no ankle puts the pressure, unless the plan does [m].
        trim_gain: speed at which the body is moved against the error while others than the feet still hold it, in the
            phase after which they let go [1/s].
        trim_m: largest displacement by that [m].
        trim_fade_s: in which it goes back [s].
        release_m: how far the capture point must be inside the feet before other contacts let go; more than the border,
            or no ankle could stop it [m].
        least_m: balance margin of the plan below which the ankles follow it instead: they could not do more [m].
    """

    gain: float = 3.0
    edge_m: float = 0.012
    trim_gain: float = 1.5
    trim_m: float = 0.05
    trim_fade_s: float = 10.0
    release_m: float = 0.015
    least_m: float = 0.02

    def __post_init__(self) -> None:
        least = min(self.edge_m, self.trim_gain, self.trim_m, self.least_m)
        if not (self.gain > 1.0 and least >= 0.0 and self.trim_fade_s > 0.0):
            raise ExecutionError(
                f"balance: gain {self.gain:g}, edge_m {self.edge_m:g}, trim_gain {self.trim_gain:g}, trim_m "
                f"{self.trim_m:g}, trim_fade_s {self.trim_fade_s:g}, least_m {self.least_m:g}; expected a gain above "
                "1, a positive time, and 0 or more"
            )

    @property
    def trim(self) -> OffsetFilter:
        """Limit of the body's displacement, and its way back."""
        return OffsetFilter(self.trim_m, self.trim_fade_s)


@dataclass(frozen=True)
class Balance:
    """What the balance wants of the feet in one cycle.

    Attributes:
        error: (2,) capture point relative to the feet, less that of the plan [m].
        torques: by foot (2,) of its ankle's joints [N m].
        pressures: by foot (2,) wanted centre of pressure from the foot's origin, world axes [m].
    """

    error: Float[np.ndarray, "2"]
    torques: Mapping[str, Float[np.ndarray, "2"]]
    pressures: Mapping[str, Float[np.ndarray, "2"]]


class BalanceControl:
    """Capture-point feedback of a robot that stands on one foot or two.

    It compares robot and plan relative to the planted feet, so that neither the drift of an estimate nor feet that
    stand beside their planned places matter.
    """

    def __init__(
        self, robot: RobotModel, ankles: Mapping[str, Sequence[int]], settings: BalanceSettings | None = None
    ) -> None:
        """Prepare the feet.

        Args:
            robot: of the plan.
            ankles: by foot, the columns of its ankle's joints in a configuration.
            settings: gain and border.
        """
        self.settings, self.robot = settings or BalanceSettings(), robot
        self._ankles = {foot: np.asarray(columns, dtype=int) for foot, columns in ankles.items()}
        self._frames = {foot: robot.model.getFrameId(foot) for foot in ankles}
        self._actual, self._planned = robot.model.createData(), robot.model.createData()

    def step(
        self,
        q: Float[np.ndarray, "n"],
        v: Float[np.ndarray, "n"],
        wanted: ReferenceState,
        rate: float,
        planted: Sequence[PlantedContact],
        forces: Mapping[str, Float[np.ndarray, "3"]],
    ) -> Balance:
        """Return what is wanted of the planted feet.

        Args:
            q, v: (n,) configuration and speeds as measured.
            wanted: by the plan now.
            rate: of the plan's clock.
            planted: one or two feet.
            forces: measured by foot (3,), world axes [N].
        """
        model, actual, planned = self.robot.model, self._actual, self._planned
        pin.centerOfMass(model, actual, q, v, False)
        pin.centerOfMass(model, planned, wanted.configuration, rate * wanted.velocity, False)
        places = [pin.updateFramePlacement(model, actual, self._frames[contact.link]) for contact in planted]
        goals = [pin.updateFramePlacement(model, planned, self._frames[contact.link]) for contact in planted]
        origins = np.array([place.translation for place in places])
        soles = [place.rotation @ contact.sole.mean(axis=0) for place, contact in zip(places, planted, strict=True)]
        upright = np.array([max(float(wanted.contact_wrenches[contact.link][2]), 0.0) for contact in planted])
        shares = upright / upright.sum() if upright.sum() > LEAST_N else np.full(len(planted), 1.0 / len(planted))
        middle = shares @ origins
        planned_com = planned.com[0] - shares @ np.array([goal.translation for goal in goals])
        height = float(actual.com[0][2] - middle[2] - shares @ np.array(soles)[:, 2])
        omega = np.sqrt(GRAVITY / max(height, LEAST_HEIGHT_M))
        error = (actual.com[0] - middle - planned_com + (actual.vcom[0] - planned.vcom[0]) / omega)[:2]

        # Accelerations along a path grow with the square of the clock's rate.
        pressures = np.array([_find_pressure(wanted.contact_wrenches[contact.link], contact) for contact in planted])
        own = pressures.copy()
        planned_zmp = shares @ own
        zmp = rate**2 * planned_zmp + (1.0 - rate**2) * planned_com[:2] + self.settings.gain * error
        measured = np.array([max(float(forces[contact.link][2]), 0.0) for contact in planted])
        if measured.sum() > LEAST_N:
            pressures += zmp - measured / measured.sum() @ (origins[:, :2] - middle[:2] + pressures)
        made, torques = {}, {}
        for k, contact in enumerate(planted):
            made[contact.link] = self._keep_inside(pressures[k], own[k], contact, places[k].rotation)
            arm = np.array([*made[contact.link], soles[k][2]])
            force = np.array([*forces[contact.link][:2], measured[k]])
            torques[contact.link] = self._find_torque(q, contact.link, arm, force)
        return Balance(error, torques, made)

    def find_margin(
        self, q: Float[np.ndarray, "n"], v: Float[np.ndarray, "n"], planted: Sequence[PlantedContact]
    ) -> float:
        """Return how far the capture point is inside the hull of planted feet [m]; negative outside."""
        model, actual = self.robot.model, self._actual
        pin.centerOfMass(model, actual, q, v, False)
        places = [pin.updateFramePlacement(model, actual, self._frames[contact.link]) for contact in planted]
        soles = [contact.sole @ at.rotation.T + at.translation for contact, at in zip(planted, places, strict=True)]
        points = np.vstack(soles)
        height = max(float(actual.com[0][2] - points[:, 2].mean()), LEAST_HEIGHT_M)
        capture = actual.com[0] + actual.vcom[0] / np.sqrt(GRAVITY / height)
        hull = points[ConvexHull(points[:, :2]).vertices, :2]
        return float(-outside_polygon(hull, capture[None, :2])[0])

    def _find_torque(
        self, q: Float[np.ndarray, "n"], foot: str, arm: Float[np.ndarray, "3"], force: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "2"]:
        """Return the torques of an ankle whose foot feels a force at ``arm`` from its origin, and weighs little."""
        jacobian = pin.computeFrameJacobian(self.robot.model, self._actual, q, self._frames[foot], WORLD_AXES)
        lever = jacobian[:, self._ankles[foot]]
        return np.asarray(-(lever[:3].T @ force + lever[3:].T @ (pin.skew(arm) @ force)))

    def _keep_inside(
        self,
        pressure: Float[np.ndarray, "2"],
        planned: Float[np.ndarray, "2"],
        contact: PlantedContact,
        rotation: Float[np.ndarray, "3 3"],
    ) -> Float[np.ndarray, "2"]:
        """Return a centre of pressure inside the box of the sole's points: in the border only where the plan is too."""
        turn = rotation[:2, :2]
        low, high = contact.sole[:, :2].min(axis=0), contact.sole[:, :2].max(axis=0)
        edge, wanted = np.minimum(self.settings.edge_m, 0.5 * (high - low)), np.clip(turn.T @ planned, low, high)
        inside = np.clip(turn.T @ pressure, np.minimum(low + edge, wanted), np.maximum(high - edge, wanted))
        return np.asarray(turn @ inside)


def find_turn_rates(angles: Float[np.ndarray, "3"], angular_velocity: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the rates of a base's yaw, pitch and roll from its angular velocity in world axes [rad/s]."""
    (cy, cp, _), (sy, sp, _) = np.cos(angles), np.sin(angles)
    wx, wy, wz = angular_velocity
    roll = (cy * wx + sy * wy) / cp
    return np.array([wz + sp * roll, cy * wy - sy * wx, roll])


def _find_pressure(wrench: Float[np.ndarray, "6"], contact: PlantedContact) -> Float[np.ndarray, "2"]:
    """Return the planned centre of pressure from the foot's origin, world axes [m]; of an unloaded foot its middle."""
    middle = contact.points.mean(axis=0) - contact.pose_world_link[:3, 3]
    fx, fy, fz, mx, my, _ = wrench
    if fz < LEAST_N:
        return np.asarray(middle[:2])
    return np.array([(middle[2] * fx - my) / fz, (middle[2] * fy + mx) / fz])
