"""Required checks of a motion: a check that is required and was not made rules out a certificate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot.model import BASE_NAMES
from service.verify.carrying.checks import list_carrier_checks
from service.verify.certificate import Basis, Check
from service.verify.forces.frame_speeds import list_frame_speeds
from service.verify.forces.hand_contacts import list_moving_joints
from service.verify.ground import find_standing_contacts
from service.verify.motion import Motion, Phase
from service.verify.rolling import NAME as ROLLING
from service.verify.targets.swaying import list_swayed_targets

TIMING, BALANCE = "timing", "balance"
INERTIA_ROUNDING = 0.05  # by which a principal moment may exceed the sum of the others in a robot's file


def list_waived_checks(*, is_timed: bool, is_balanced: bool) -> frozenset[str]:
    """Return the waived checks: ``timing`` of an untimed motion, ``balance`` where the request does not demand it."""
    return frozenset(([] if is_timed else [TIMING]) + ([] if is_balanced else [BALANCE]))


@dataclass(frozen=True)
class RequiredChecks:
    """Required and waived checks of a motion.

    Attributes:
        names: names of the checks without which there is no certificate.
        waived: sentences about checks that the request waives, or for which the robot's file lacks data.
    """

    names: tuple[str, ...]
    waived: tuple[str, ...]


def list_required_checks(motion: Motion, phases: Sequence[Phase]) -> RequiredChecks:
    """List the checks that a motion requires, phase by phase."""
    names, waived = ["limits.position", "clearance"], []
    names += [ROLLING] if motion.robot.rolls else []
    names += [f"release.{release.joint}" for release in motion.releases]
    if motion.law is not None:
        names += ["limits.speed", "limits.acceleration", "limits.rest"]
        names += ["limits.jerk"] if motion.jerk_scale is not None else []
        names += [speed.name for speed in list_frame_speeds(motion, phases)]
    elif _is_waived(motion, TIMING):
        waived.append("speeds, accelerations and forces (the motion is untimed)")
    else:
        names.append("limits.speed")
    unlimited = find_joints_without_torque_limit(motion)
    is_limited = len(unlimited) < len(list_own_joints(motion)) and _has_mass(motion)
    if motion.law is not None and not is_limited:
        waived.append("torques (no joint names a limit)" if _has_mass(motion) else "torques (no link names a mass)")
    if motion.law is not None and is_limited:
        waived += _doubtful_weights(motion)
    for phase in phases:
        moving = list_moving_joints(motion, phase)
        if motion.waived is None:
            waived += [f"what moves {joint} in '{phase.name}'" for joint in moving if not _is_pushed(phase, joint)]
        elif not any(part.source == "assumed" for part in phase.pressed or ()):  # a check of its own says so
            names += [f"{check}.{phase.name}.{joint}" for joint in moving for check in ("hand_touch", "hand_contact")]
        names += [f"swayed.{phase.name}.{target.frame}" for target in list_swayed_targets(phase) if motion.sway]
        names += [f"torque.{phase.name}"] if motion.law is not None and is_limited else []
        names += list_carrier_checks(phase, is_timed=motion.law is not None)
        if not motion.robot.is_floating:
            continue
        names += [f"planted.{phase.name}.{contact.link}" for contact in phase.contacts]
        names += [f"ground.{phase.name}.{contact.link}" for contact in find_standing_contacts(motion, phase)]
        if phase.support is None and phase.region_margin_m is None and _is_waived(motion, BALANCE):
            waived.append(f"balance in '{phase.name}'")
            continue
        at_samples = "zmp" if phase.region_margin_m is None else "forces"
        names += [f"balance.{phase.name}", *([f"{at_samples}.{phase.name}"] if motion.law is not None else [])]
        names += [f"equilibrium.{phase.name}"] if phase.loads or phase.region_margin_m is not None else []
        names += [f"planted.{phase.name}"] if motion.waived is not None and not phase.contacts else []
    return RequiredChecks(tuple(names), tuple(waived))


def _is_waived(motion: Motion, what: str) -> bool:
    return motion.waived is None or what in motion.waived


def _is_pushed(phase: Phase, joint: str) -> bool:
    return any(push.joint == joint for push in phase.pushes)


def list_own_joints(motion: Motion) -> tuple[int, ...]:
    """Return the coordinates of the robot's own joints: neither the base's nor a mechanism's."""
    model, robot = motion.robot.model, motion.robot
    moved = {body.joint for body in robot.bodies if body.link in motion.mechanism_links}
    columns = {int(model.joints[joint].idx_q) for joint in moved}
    return tuple(k for k in range(len(BASE_NAMES) if robot.is_floating else 0, robot.n) if k not in columns)


def find_joints_without_torque_limit(motion: Motion) -> tuple[str, ...]:
    """Return the robot's own joints without a torque limit; a limit of 0 means unknown."""
    effort = motion.robot.effort
    return tuple(motion.robot.joint_names[k] for k in list_own_joints(motion) if not 0.0 < effort[k] < np.inf)


def _has_mass(motion: Motion) -> bool:
    return any(float(inertia.mass) > 0.0 for inertia in motion.robot.model.inertias[1:])


def _doubtful_weights(motion: Motion) -> Iterator[str]:
    """Yield a phrase for links whose mass is missing, and for links whose inertia no rigid body has."""
    inertias = motion.robot.model.inertias
    links: dict[int, list[str]] = {}
    for body in motion.robot.bodies:
        if body.joint > 0 and body.link not in motion.mechanism_links and body.link not in links.get(body.joint, ()):
            links.setdefault(body.joint, []).append(body.link)
    light = [name for joint, names in links.items() if not inertias[joint].mass > 0.0 for name in names]
    if light:
        yield f"the weight of {', '.join(light)} (no mass)"
    odd = [name for joint, names in links.items() if not _is_possible(inertias[joint].inertia) for name in names]
    if odd:
        yield f"the inertia of {', '.join(odd)} (no body has it)"


def _is_possible(inertia: Float[np.ndarray, "3 3"]) -> bool:
    """Return whether no principal moment exceeds the sum of the two others by more than rounding in a file."""
    moments = np.linalg.eigvalsh(np.asarray(inertia))
    return bool(moments[2] <= (1.0 + INERTIA_ROUNDING) * (moments[0] + moments[1]) + 1e-9)


def report_missing_checks(required: RequiredChecks, checks: Sequence[Check]) -> Iterator[Check]:
    """Yield an unproven check for each required check that was not made."""
    made = {check.name for check in checks}
    for name in required.names:
        if name not in made:
            text = f"check {name} is missing: nothing says whether the motion would pass it"
            nan = float("nan")
            yield Check(f"coverage.missing.{name}", True, nan, nan, "1", text, None, Basis.UNPROVEN)
