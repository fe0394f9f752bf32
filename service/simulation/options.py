"""Settings of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

from service.errors import RequestError


@dataclass(frozen=True)
class SimulationOptions:
    """Settings of a simulation; every random draw comes from ``seed``.

    Attributes:
        friction: coefficient between the robot and the world.
        hand_friction: coefficient between a hand and what it moves; None for the interval of the request, of which a
            single run takes the lower end.
        feed_forward: share Kf of the planned torques that the servos add, 0 to 1.
        stiffness_scale: factor on the stiffness and damping of every servo.
        noise: size of the sensors' noise; 1 is that of good encoders, inertial units and force sensors.
        delay_ms: time from a command to its servo.
        joint_friction: dry friction in every joint, as a share of its effort limit.
        perturb: size of random errors of the physics against the plan; at 1 surfaces are off by up to 1 cm along each
            axis, masses by 5 %, friction by 0.1, and joints at the beginning by 10 mrad.
        settle_s: time that the robot stands on the first pose before the plan begins.
        after_s: least time that it stands on the last pose after the plan; longer until it is at rest, up to 10 s.
        seed: of noise and errors.
    """

    friction: float = 0.8
    hand_friction: float | None = None
    feed_forward: float = 1.0
    stiffness_scale: float = 1.0
    noise: float = 0.0
    delay_ms: float = 0.0
    joint_friction: float = 0.0
    perturb: float = 0.0
    settle_s: float = 1.0
    after_s: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        limits = {
            "friction": (0.0, 5.0),
            "hand_friction": (0.0, 5.0),
            "feed_forward": (0.0, 1.0),
            "stiffness_scale": (0.01, 100.0),
            "noise": (0.0, 1000.0),
            "delay_ms": (0.0, 1000.0),
            "joint_friction": (0.0, 1.0),
            "perturb": (0.0, 5.0),
            "settle_s": (0.0, 60.0),
            "after_s": (0.0, 60.0),
            "seed": (0, 2**32 - 1),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:  # NaN too
                raise RequestError(f"{name}: {value:g}; expected {low:g} to {high:g}")
