"""Expected sag of the centre of mass on position servos, and what it leaves of the balance margin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.stopping import poll
from costs.work_space import borrow_data
from service.verify import (
    Motion,
    Phase,
    PlantedContact,
    find_mechanism_joints,
    find_time,
    list_load_cases,
    map_axes,
    outside_polygon,
    split_motion,
)

SAMPLES = 12  # in each phase
GRAVITY = 9.81
STIFFNESS_ERROR = 0.2  # of servos, by which they may be softer or stiffer than the plan has them
_SMALL = 1e-9  # of a stiffness, so that the base is free [N/m, N m/rad]
_GIVES = 1e-9  # by which contacts give, relative to the stiffest servo: their rows may depend on each other


@dataclass(frozen=True)
class ServoSag:
    """Sag of the centre of mass along a motion, at samples.

    Attributes:
        stiffness: of the servos by joint [N m/rad, N/m].
        sag_m: largest horizontal sag of the centre of mass [m].
        at_s: when; None without a time law.
        margin_m: least balance margin [m]; None where no phase has one.
        margin_after_m: least of balance margin minus sag [m].
        tight_phase: phase with the latter.
        led_m: least of balance margin minus the sag that is left where servos follow the servo reference
            ``q + tau / K``, and are softer than it has them by ``STIFFNESS_ERROR`` [m].
    """

    stiffness: Mapping[str, float]
    sag_m: float
    at_s: float | None
    margin_m: float | None
    margin_after_m: float | None
    tight_phase: str
    led_m: float | None

    def to_json(self) -> dict[str, Any]:
        """Return the key ``servo`` of ``result.json``."""
        return {
            "stiffness": dict(self.stiffness),
            "sag_m": self.sag_m,
            "at_s": self.at_s,
            "margin_after_sag_m": self.margin_after_m,
        }

    def list_notes(self) -> tuple[str, ...]:
        """Return a sentence if the sag is larger than the balance margin, with what position servos then need."""
        if self.margin_m is None or self.margin_after_m is None or self.margin_after_m >= 0.0:
            return ()
        sag = (
            f"in phase '{self.tight_phase}': the centre of mass sags by up to {1e3 * self.sag_m:.1f} mm, and the "
            f"balance margin is {1e3 * self.margin_m:.1f} mm"
        )
        if self.led_m is not None and self.led_m < 0.0:
            return (f"needs torque feed-forward or stiffer servos {sag}",)
        return (
            f"servos that only hold the planned positions may let the robot fall {sag}; let them follow the servo "
            "reference (scopt export --to servo), or feed torques forward",
        )


def measure_sag(motion: Motion, stiffness: Mapping[str, float], proven_m: float | None = None) -> ServoSag | None:
    """Return the sag of a motion's centre of mass; None for a fixed base, or without masses or planted links.

    Args:
        motion: as executed.
        stiffness: of every servo by joint [N m/rad, N/m].
        proven_m: balance margin of the motion's certificate, which is at most that of the samples; None or NaN without.
    """
    robot = motion.robot
    if not robot.is_floating or not sum(float(inertia.mass) for inertia in robot.model.inertias[1:]) > 0.0:
        return None
    largest, at, margin, after, tight, led = 0.0, None, np.inf, np.inf, "", np.inf
    for phase, part in zip(motion.phases, split_motion(motion), strict=True):
        if not phase.contacts:
            return None
        s = np.linspace(phase.first, phase.last, SAMPLES)
        q = motion.curve(s)
        plain, softer = compute_sags(part, phase, q, stiffness)
        sag = np.linalg.norm(plain[..., :2], axis=2).max(axis=0)
        worst = int(sag.argmax())
        if float(sag[worst]) > largest:
            largest, at = float(sag[worst]), find_time(motion.law, float(s[worst]))
        inside = _measure_margins(part, phase, s, q)
        if inside is None:
            continue
        margin = min(margin, float(inside.min()))
        left = inside - sag
        led = min(led, float((inside - np.linalg.norm(softer[..., :2], axis=2).max(axis=0)).min()))
        if float(left.min()) < after:
            after, tight = float(left.min()), phase.name
    has_margin = bool(np.isfinite(margin))
    if has_margin and proven_m is not None and proven_m < margin:
        margin, after, led = proven_m, after - (margin - proven_m), led - (margin - proven_m)
    left_m = (margin, after, led) if has_margin else (None, None, None)
    return ServoSag(stiffness, largest, at, left_m[0], left_m[1], tight, left_m[2])


def compute_sags(
    motion: Motion, phase: Phase, q: Float[np.ndarray, "S n"], stiffness: Mapping[str, float]
) -> tuple[Float[np.ndarray, "K S 3"], Float[np.ndarray, "K S 3"]]:
    """Return the sag of the centre of mass [m] at configurations, without loads of the hands and with all of them.

    The second sag is that of servos which are softer than planned by the share ``e = -STIFFNESS_ERROR`` and follow
    ``q + tau / K``: they turn by ``tau / K - tau / ((1 + e) K)``, so that ``e / (1 + e)`` of the sag is left, on servos
    that give ``1 / (1 + e)`` as much.

    Servos at rest turn by ``d`` until ``K d + g + J_c' f = 0`` with ``J_c d = 0``: gravity and loads ``g`` are carried
    by the servos and by the forces ``f`` of contacts that stay where they are.  The sag is ``x = J_com d``.  A centre
    of mass of weight ``w`` and height ``h`` that has moved by ``x`` pushes like a horizontal force ``w x / h``, as on
    an inverted pendulum, so that ``x`` grows to ``(1 - C w / h)^-1 x`` with the compliance ``C`` of the centre of mass.
    Where that is unstable, the sag is ``h``.
    """
    weight = GRAVITY * sum(float(inertia.mass) for inertia in motion.robot.model.inertias[1:])
    ground = float(np.mean(np.concatenate([contact.points[:, 2] for contact in phase.contacts])))
    sags: list[np.ndarray] = []
    led: list[np.ndarray] = []
    softness = 1.0 / (1.0 - STIFFNESS_ERROR)
    for data, com, turned in list_deflections(motion, phase, q, stiffness):
        moved_com = com @ turned
        height = max(float(data.com[0][2]) - ground, 1e-3)
        share = moved_com[:2, :2] * weight / height
        for made, left, soft in ((sags, 1.0, 1.0), (led, STIFFNESS_ERROR * softness, softness)):
            sag = left * moved_com[:, 2:].T
            sag[:, :2] = _tip(soft * share, sag[:, :2].T, height).T
            made.append(sag)
    return np.stack(sags, axis=1), np.stack(led, axis=1)


def list_deflections(
    motion: Motion, phase: Phase, q: Float[np.ndarray, "S n"], stiffness: Mapping[str, float]
) -> Iterator[tuple[pin.Data, Float[np.ndarray, "3 n"], Float[np.ndarray, "n K+2"]]]:
    """Yield per configuration kinematic data, the centre of mass's Jacobian, and how far servos at rest turn [rad, m].

    The columns are those of a unit force on the centre of mass along x and along y, of gravity alone, and of gravity
    with all loads of the hands where the phase has any.  The mechanism's joints and the contacts stay where they are.
    """
    robot, model = motion.robot, motion.robot.model
    moved = [int(model.joints[joint].idx_v) for joint in find_mechanism_joints(motion)]
    n = robot.n
    diagonal = np.full(n, _SMALL)
    for name, value in stiffness.items():
        diagonal[robot.joint_names.index(name)] = value
    cases = list_load_cases(robot, q, phase.loads)
    cases = (cases[0], cases[-1]) if len(cases) > 1 else cases
    data = borrow_data(model)
    for i, row in enumerate(q):
        poll()
        gravity = pin.rnea(model, data, row, np.zeros(n), np.zeros(n))
        jacobians = np.asarray(pin.computeJointJacobians(model, data, row)).reshape(6, model.nvExtended)
        pin.updateFramePlacements(model, data)
        com = np.asarray(pin.jacobianCenterOfMass(model, data, row))
        held = np.concatenate([np.eye(n)[moved], *(_hold_contact(robot, data, contact) for contact in phase.contacts)])
        torques = [com[0], com[1]]
        for case in cases:
            torque = -gravity
            for joint, wrench in case.parts:
                torque += (jacobians.T @ wrench[i]) @ map_axes(model, joint)
            torques.append(torque)
        yield data, com, _deflect(diagonal, held, np.stack(torques, axis=1))


def _tip(share: Float[np.ndarray, "2 2"], sag: Float[np.ndarray, "2 K"], height: float) -> Float[np.ndarray, "2 K"]:
    """Return horizontal sags [m] as the weight makes them grow; the height of the centre of mass where it tips over."""
    if float(np.linalg.eigvalsh(0.5 * (share + share.T)).max()) >= 1.0:
        return np.full_like(sag, height / np.sqrt(2.0))
    return np.asarray(np.linalg.solve(np.eye(2) - share, sag))


def _deflect(
    stiffness: Float[np.ndarray, "n"], held: Float[np.ndarray, "m n"], torques: Float[np.ndarray, "n K"]
) -> Float[np.ndarray, "n K"]:
    """Return the elastic deflection under torques with ``held @ d = 0``; rows of ``held`` may depend on each other."""
    n, m = len(stiffness), len(held)
    scale = float(stiffness.max())
    table = np.zeros((n + m, n + m))
    table[:n, :n] = np.diag(stiffness)
    table[:n, n:] = scale * held.T
    table[n:, :n] = scale * held
    table[n:, n:] = -_GIVES * scale * np.eye(m)
    return np.asarray(np.linalg.solve(table, np.concatenate([torques, np.zeros((m, torques.shape[1]))]))[:n])


def _hold_contact(robot: RobotModel, data: pin.Data, contact: PlantedContact) -> Float[np.ndarray, "m n"]:
    """Return the rows that keep a contact where it is: its frame, or its points where they are fewer than three."""
    model = robot.model
    frame = model.getFrameId(contact.link)
    jacobian = np.asarray(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
    if len(contact.sole) >= 3:
        return jacobian
    rows = []
    for point in contact.sole:
        arm = data.oMf[frame].rotation @ point
        rows.append(jacobian[:3] - pin.skew(arm) @ jacobian[3:])
    return np.concatenate(rows)


def _measure_margins(
    motion: Motion, phase: Phase, s: Float[np.ndarray, "S"], q: Float[np.ndarray, "S n"]
) -> Float[np.ndarray, "S"] | None:
    """Return the distance of the centre of mass inside the feet or the phase's regions [m]; None without either."""
    if phase.support is None and not phase.regions:
        return None
    data = borrow_data(motion.robot.model)
    com = np.array([pin.centerOfMass(motion.robot.model, data, row)[:2] for row in q])
    inside = np.full(len(s), np.inf)
    if phase.support is not None:
        inside = np.minimum(inside, -outside_polygon(phase.support.polygon, com))
    for region in phase.regions:
        rows = np.flatnonzero((s >= region.first - 1e-9) & (s <= region.last + 1e-9))
        if len(rows):
            inside[rows] = np.minimum(inside[rows], -outside_polygon(region.vertices, com[rows]))
    return inside
