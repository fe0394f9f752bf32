"""Expected give of the hands on position servos, against the travel of what they move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.motion.servo_sag import STIFFNESS_ERROR, list_deflections
from service.verify import HandLoad, Motion, Phase, find_mechanism_joints, split_motion

MOST_SHARE = 0.05  # of a travel, by which a hand may fall short of it
LEAST_TRAVEL_M = 1e-3  # of what counts as moved [m]


@dataclass(frozen=True)
class HandSag:
    """What a hand on position servos loses of a travel, at the end of a phase in which it moves a mechanism.

    Attributes:
        phase, tool: names.
        travel_m: of the place where the hand presses [m].
        sag_m: by which the hand stays behind along its way, under gravity and its loads, without feed-forward [m].
    """

    phase: str
    tool: str
    travel_m: float
    sag_m: float

    @property
    def stiffer(self) -> float:
        """Factor on the stiffness of the servos with which the hand would lose 5 % of the travel."""
        return self.sag_m / (MOST_SHARE * self.travel_m)

    @property
    def led_m(self) -> float:
        """What is left of the sag on servos that follow the servo reference and are softer than planned [m]."""
        return find_led_sag(self.sag_m)

    def to_json(self) -> dict[str, Any]:
        """Return an entry of ``servo.hands`` of ``result.json``."""
        return {**asdict(self), "stiffer": self.stiffer}

    def describe(self) -> str:
        """Return a sentence on what position servos need."""
        way = f"of {1e3 * self.travel_m:.1f} mm in phase '{self.phase}'"
        if self.led_m > MOST_SHARE * self.travel_m:
            return (
                f"needs torque feed-forward: on position servos {self.tool} gives way by {1e3 * self.sag_m:.1f} {way}, "
                f"and by {1e3 * self.led_m:.1f} mm where these follow the servo reference; or make robot.servo "
                f"{self.stiffer:.1f} times as stiff"
            )
        return (
            f"on position servos {self.tool} gives way by {1e3 * self.sag_m:.1f} {way}; let them follow the servo "
            "reference (scopt export --to servo), or feed torques forward"
        )


def find_led_sag(sag_m: float) -> float:
    """Return what is left of a sag on servos that follow the servo reference and are softer than planned [m]."""
    return sag_m * STIFFNESS_ERROR / (1.0 - STIFFNESS_ERROR)


def list_short_hands(motion: Motion, stiffness: Mapping[str, float]) -> tuple[HandSag, ...]:
    """Return the hands that lose more than 5 % of a travel on position servos without feed-forward, the worst first.

    Args:
        motion: as executed.
        stiffness: of every servo by joint [N m/rad, N/m].
    """
    parts = zip(motion.phases, split_motion(motion), strict=True)
    found = [sag for phase, part in parts if phase.loads for sag in _measure_phase(part, phase, stiffness)]
    short = [sag for sag in found if sag.sag_m > MOST_SHARE * sag.travel_m]
    return tuple(sorted(short, key=lambda sag: -sag.stiffer))


def _measure_phase(motion: Motion, phase: Phase, stiffness: Mapping[str, float]) -> Iterator[HandSag]:
    ends = motion.curve(np.array([phase.first, phase.last]))
    model: pin.Model = motion.robot.model
    moved = np.zeros(motion.robot.n)
    for joint in find_mechanism_joints(motion):
        column = int(model.joints[joint].idx_q)
        moved[column] = ends[1, column] - ends[0, column]
    (data, _, turned), *_ = list_deflections(motion, phase, ends[1:], stiffness)
    for tool in dict.fromkeys(load.tool for load in phase.loads):
        way = _find_way(model, data, moved, [load for load in phase.loads if load.tool == tool])
        travel = float(np.linalg.norm(way))
        if travel < LEAST_TRAVEL_M:
            continue
        frame = pin.getFrameJacobian(model, data, model.getFrameId(tool), pin.LOCAL_WORLD_ALIGNED)[:3]
        yield HandSag(phase.name, tool, travel, max(-float(way @ frame @ turned[:, -1]) / travel, 0.0))


def _find_way(
    model: pin.Model, data: pin.Data, moved: Float[np.ndarray, "n"], loads: Sequence[HandLoad]
) -> Float[np.ndarray, "3"]:
    """Return the farthest travel of the places of some loads, along their direction at the end [m]."""
    ways = []
    for load in loads:
        frame = model.getFrameId(load.link)
        jacobian = np.asarray(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
        speed = jacobian @ moved
        ways.append(speed[:3] + np.cross(speed[3:], data.oMf[frame].rotation @ load.place))
    return max(ways, key=lambda way: float(np.linalg.norm(way)))
