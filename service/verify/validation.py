"""Validation of a motion before any proof: finite values, rigid poses, a consistent time law."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pinocchio as pin

from costs.curve import Curve, PolynomialCurve, TimeLaw
from service.request.paces import PACES
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    HoleTarget,
    JointTarget,
    JointWayTarget,
    Motion,
    Phase,
    PoseTarget,
    RelativePoseTarget,
    Target,
    VerifyError,
    WayTarget,
)
from service.verify.regions.region import RegionTarget

# Errors of directions and rotations written as decimal numbers.
_UNIT_TOLERANCE = 1e-6
# How far a target's path parameter may lie outside its phase, relative to the parameter.
_BORDER_TOLERANCE = 1e-9
# Nearest that two points of a contact may be, each of which has a force cap of its own.
_SAME_POINT_M = 1e-6
# Largest jump of a position between two polynomials, from rounding [rad, m].
_GAP_M = 1e-9
# Farthest that a kept contact may be stated to move from one phase to the next [m].
_CREEP_M = 1e-5


def validate_motion(motion: Motion) -> None:
    """Reject a malformed motion.

    Raises:
        VerifyError: for wrong shapes, values that are not finite, samples out of order, rotations that are none, axes
            that are not of unit length, contacts with negative numbers or that creep, two contacts of a link, targets
            outside their phase, names that two bodies or pieces have, releases of unknown joints.
    """
    _validate_curve(motion)
    _validate_names(motion)
    for body in motion.robot.bodies:
        _points(f"vertices of body '{body.name}'", body.vertices, 3)
    for piece in motion.scene.pieces:
        _points(f"vertices of piece '{piece.name}'", piece.vertices, 3)
    for phase in motion.phases:
        _validate_phase(phase)
        moved = [contact.link for contact in phase.contacts if contact.link in motion.mechanism_links]
        if moved:
            raise VerifyError(f"'{moved[0]}' in phase '{phase.name}' is moved by the task, so that it carries nothing")
    for before, after in pairwise(motion.phases):
        _validate_kept_contacts(before, after)
    _validate_releases(motion)
    _validate_speeds(motion)
    if motion.law is not None:
        check_law(motion.curve, motion.law)


def _validate_speeds(motion: Motion) -> None:
    """Reject a limit of the tools' speed that is not positive, unknown paces, and rates of unknown joints."""
    most = motion.tool_speed_m_s
    if most is not None and not 0.0 < most < np.inf:
        raise VerifyError(f"tool_speed_m_s: expected a positive speed, got {most}")
    if motion.pace is not None and motion.pace not in PACES:
        raise VerifyError(f"pace: expected {', '.join(PACES)}, got '{motion.pace}'")
    approach = motion.approach
    if not 0.0 < approach.stiffness_n_m * approach.reaction_s < np.inf or not 0.0 <= approach.noise_n < np.inf:
        raise VerifyError(f"approach: expected a positive stiffness and time and a noise of 0 or more, got {approach}")
    for what, rates in (("start_rates", motion.start_rates), ("end_rates", motion.end_rates)):
        _finite(what, *rates.values())
        strange = sorted(set(rates) - set(motion.robot.joint_names))
        if strange:
            raise VerifyError(f"{what}: '{strange[0]}' is no joint of the motion")


def _validate_releases(motion: Motion) -> None:
    """Reject release rules of unknown joints, two rules of a joint, and values that are not finite."""
    for release in motion.releases:
        what = f"release of '{release.joint}'"
        unknown = [name for name in (release.joint, release.latch) if name not in motion.robot.joint_names]
        if unknown or release.joint == release.latch:
            raise VerifyError(f"the {what} by '{release.latch}' needs two joints of the motion")
        _finite(what, release.latch_at, release.free_beyond)
        if release.latch_at == 0.0 or release.free_beyond < 0.0:
            raise VerifyError(
                f"the {what} needs a latch_at other than 0 and a free_beyond >= 0, got {release.latch_at} and "
                f"{release.free_beyond}"
            )
    if len({release.joint for release in motion.releases}) < len(motion.releases):
        raise VerifyError("two releases are of the same joint; one is expected")


def _validate_curve(motion: Motion) -> None:
    n, model, curve = motion.robot.n, motion.robot.model, motion.curve
    if not curve.positions.shape[1] == curve.tangents.shape[1] == model.nq == model.nv == n:
        raise VerifyError(
            f"curve, robot and model must have the same number of coordinates, got {curve.positions.shape[1]}, "
            f"{n} and {model.nq}"
        )
    _finite("curve", curve.knots, curve.positions, curve.tangents)
    if isinstance(curve, PolynomialCurve):
        _validate_polynomials(curve, motion)
    if motion.law is not None:
        _finite("time law", motion.law.times, motion.law.path, motion.law.speed)
    if motion.samples is not None:
        _finite("samples", motion.samples)
        if np.any(np.diff(motion.samples) <= 0.0):
            raise VerifyError("samples must increase strictly")


def _validate_polynomials(curve: PolynomialCurve, motion: Motion) -> None:
    """Reject polynomials that miss the positions at the knots, a law that does not run evenly, and mechanisms."""
    law = motion.law
    if motion.mechanism_links or motion.releases:
        raise VerifyError("a curve of given polynomials moves no mechanism; give a cubic Hermite curve")
    _finite("curve", curve.pieces)
    error = curve.measure_position_error()
    if not error <= _GAP_M:
        raise VerifyError(f"the polynomials of the curve miss the positions at its knots by {error:.3g}")
    if law is not None and np.any(law.speed != law.speed[0]):
        raise VerifyError("a curve of given polynomials needs a time law of constant speed")


def _validate_names(motion: Motion) -> None:
    """Reject a name used twice: no body or link of robot, mechanism and scene shares a name with another."""
    bodies, pieces, model = motion.robot.bodies, motion.scene.pieces, motion.robot.model
    for what, names in (("bodies", [body.name for body in bodies]), ("pieces", [piece.name for piece in pieces])):
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            raise VerifyError(f"two {what} are named '{repeated[0]}'; names must be unique")
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    owners: dict[str, str] = dict.fromkeys(links - motion.mechanism_links, "robot")
    owned = [("mechanism", link) for link in motion.mechanism_links]
    for body in bodies:
        owner = "mechanism" if body.link in motion.mechanism_links else "robot"
        owned += [(owner, body.link), (owner, body.name)]
    for owner, name in (*owned, *(("scene", piece.name) for piece in pieces)):
        if owners.setdefault(name, owner) != owner:
            raise VerifyError(f"'{name}' is a name in the {owners[name]} and in the {owner}; names must be unique")


def _validate_phase(phase: Phase) -> None:
    if phase.support is not None:
        _points(f"support polygon of phase '{phase.name}'", phase.support.polygon, 2)
        _finite(f"support of phase '{phase.name}'", phase.support.margin_m, phase.support.height)
    if phase.region_margin_m is not None:
        _not_negative(f"region margin of phase '{phase.name}'", phase.region_margin_m)
    _validate_contacts(phase)
    for target in phase.targets:
        what = f"target of '{_name_subject(target)}' in phase '{phase.name}'"
        at = target.at if isinstance(target, JointTarget | PoseTarget | AxisTarget | RegionTarget) else None
        slack = _BORDER_TOLERANCE * max(1.0, abs(phase.last))
        if at is not None and not phase.first - slack <= at <= phase.last + slack:
            raise VerifyError(f"the {what} is at {at}, outside the phase ({phase.first} to {phase.last})")
        _finite(what, *_places(target))
        for tolerance in _tolerances(target):
            # An infinite tolerance frees; NaN must not.
            if not np.all(np.asarray(tolerance) >= 0.0):
                raise VerifyError(f"the {what} needs tolerances that are not negative, got {tolerance}")
        if (
            isinstance(target, PoseTarget | RelativePoseTarget | RegionTarget | WayTarget)
            and target.rotation is not None
        ):
            _rigid(what, target.rotation)


def _name_subject(target: Target) -> str:
    """Return the joint, the joints or the frame that a target is about."""
    if isinstance(target, JointTarget):
        return target.joint
    return ", ".join(target.joints) if isinstance(target, JointWayTarget) else target.frame


def _validate_contacts(phase: Phase) -> None:
    """Reject two contacts of one link, points given twice, and numbers that no contact has."""
    links = Counter(contact.link for contact in phase.contacts)
    twice = [link for link, count in links.items() if count > 1]
    if twice:
        raise VerifyError(f"'{twice[0]}' has two contacts in phase '{phase.name}'; one per link is expected")
    for contact in phase.contacts:
        what = f"contact of '{contact.link}' in phase '{phase.name}'"
        _points(f"sole of the {what}", contact.sole, 3)
        apart = np.linalg.norm(contact.sole[:, None] - contact.sole, axis=2) + np.eye(len(contact.sole))
        if apart.min() < _SAME_POINT_M:
            raise VerifyError(f"the {what} has a point twice")
        _finite(what, contact.pose_world_link)
        _rigid(what, contact.pose_world_link[:3, :3])
        for name in ("tolerance_m", "knot_tolerance_m", "friction", "force_cap_n", "tilt_rad"):
            _not_negative(f"{name} of the {what}", getattr(contact, name))
        normal = contact.normal
        if normal is not None and not (normal.shape == (3,) and abs(np.linalg.norm(normal) - 1.0) <= _UNIT_TOLERANCE):
            raise VerifyError(f"the normal of the {what} must be a unit vector, got {normal.tolist()}")


def _validate_kept_contacts(before: Phase, after: Phase) -> None:
    """Reject contact points that creep: they keep their place on the link, and have another one in the world."""
    earlier = {contact.link: contact for contact in before.contacts}
    for contact in after.contacts:
        if contact.link not in earlier:
            continue
        first = earlier[contact.link]
        is_same = np.linalg.norm(contact.sole[:, None] - first.sole, axis=2) < _SAME_POINT_M
        apart = np.linalg.norm(contact.points[:, None] - first.points, axis=2)
        crept = float(apart[is_same].max(initial=0.0))
        if crept > _CREEP_M:
            raise VerifyError(
                f"the contact of '{contact.link}' moves by {1e3 * crept:.2f} mm between the phases '{before.name}' and "
                f"'{after.name}'; a contact that is kept stays where it is"
            )


def _places(target: Target) -> Iterator[np.ndarray | float]:
    """Yield the numbers of a target that must be finite; reject axes that are not unit vectors."""
    if isinstance(target, JointTarget):
        yield target.value
        return
    if isinstance(target, PoseTarget):
        if not np.all(target.rotation_tolerance == target.rotation_tolerance[0]):
            raise VerifyError(
                f"the rotation tolerance of the target of '{target.frame}' is one angle, three times the same, got "
                f"{target.rotation_tolerance}; a free axis is a target of kind axis"
            )
        yield target.position
        return
    if isinstance(target, RegionTarget):
        yield from _region_places(target)
        return
    if isinstance(target, JointWayTarget):
        if not len(target.joints) == len(target.first) == len(target.last):
            raise VerifyError(f"the way of the joints {', '.join(target.joints)} needs two values for each joint")
        yield target.first
        yield target.last
        yield 1.0 if target.duration_s is None else target.duration_s
        return
    if isinstance(target, CircleTarget):
        yield target.centre
        yield target.radius
    if isinstance(target, HoleTarget):
        yield target.position
        for name in ("depth_m", "radius_m", "play_m", "friction", "stiffness_n_m", "turn_stiffness_n_m_rad"):
            if not 0.0 < getattr(target, name) < np.inf:
                raise VerifyError(
                    f"{name} of the hole of '{target.frame}' must be above 0, got {getattr(target, name)}"
                )
    if isinstance(target, WayTarget):
        yield target.position
        yield target.centre
        yield target.angle
        yield target.shift
        yield target.turn
        yield 1.0 if target.speed_m_s is None else target.speed_m_s
    if isinstance(target, RelativePoseTarget):
        yield target.position
        yield target.position_tolerance_m  # what is kept is not free
        yield 0.0 if target.slide is None else target.slide
        yield target.rotation_tolerance_rad
    for axis in _list_axes(target):
        if axis is not None:
            if not abs(np.linalg.norm(axis) - 1.0) <= _UNIT_TOLERANCE:
                raise VerifyError(f"axes of the target of '{target.frame}' must be unit vectors, got {axis}")
            yield axis


def _region_places(target: RegionTarget) -> Iterator[np.ndarray | float]:
    """Yield the numbers of a region that must be finite; reject bounds and parts of the motion that are empty."""
    if not np.all(target.lower <= target.upper) or np.any(target.lower == np.inf) or np.any(target.upper == -np.inf):
        raise VerifyError(f"the region of '{target.frame}' is empty: {target.lower} to {target.upper}")
    if not 0.0 <= target.during[0] <= target.during[1] <= 1.0:
        raise VerifyError(f"the region of '{target.frame}' holds between shares of the path, got {target.during}")
    if target.axis is not None and not abs(np.linalg.norm(target.axis) - 1.0) <= _UNIT_TOLERANCE:
        raise VerifyError(f"axes of the target of '{target.frame}' must be unit vectors, got {target.axis}")
    yield target.position
    yield 0.0 if target.look is None else target.look


def _list_axes(
    target: CircleTarget | AxisTarget | RelativePoseTarget | WayTarget | HoleTarget,
) -> tuple[np.ndarray | None, ...]:
    """Return the directions of a target, which are unit vectors."""
    if isinstance(target, RelativePoseTarget):
        return (target.free_axis,)
    if isinstance(target, WayTarget):
        return target.axis, target.free_axis
    return target.axis, target.frame_axis


def _tolerances(target: Target) -> tuple[np.ndarray | float, ...]:
    if isinstance(target, JointTarget | JointWayTarget):
        return (target.tolerance,)
    if isinstance(target, WayTarget):
        return target.tolerance_m, target.rotation_tolerance_rad, target.speed_share, target.ramp_m
    if isinstance(target, PoseTarget):
        return target.position_tolerance_m, target.rotation_tolerance
    if isinstance(target, RelativePoseTarget):
        return target.position_tolerance_m, target.rotation_tolerance_rad
    if isinstance(target, RegionTarget):
        return target.radius_m, target.distance_m, target.turn_rad, target.turns_rad, target.lean_rad
    if isinstance(target, AxisTarget):
        return (target.tolerance_rad,)
    if isinstance(target, HoleTarget):
        return target.length_m, target.force_n
    return target.tolerance_m, target.axis_tolerance_rad


def _points(what: str, points: np.ndarray, columns: int) -> None:
    if points.ndim != 2 or points.shape[1] != columns or len(points) == 0:
        raise VerifyError(f"{what} must be at least one row of {columns} numbers, got shape {points.shape}")
    _finite(what, points)


def _finite(what: str, *values: np.ndarray | float) -> None:
    if not all(np.all(np.isfinite(value)) for value in values):
        raise VerifyError(f"the {what} has values that are not finite")


def _not_negative(what: str, value: float) -> None:
    if not 0.0 <= value < np.inf:
        raise VerifyError(f"the {what} must be finite and not negative, got {value}")


def _rigid(what: str, rotation: np.ndarray) -> None:
    is_orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=_UNIT_TOLERANCE)
    if not is_orthonormal or np.linalg.det(rotation) < 0.0:
        raise VerifyError(f"the {what} needs a rotation matrix, got {rotation.tolist()}")


# A step of the time law may be this much longer or shorter than its speeds and times come to, relative to its length.
_STEP_TOLERANCE = 1e-6
# How far the law's ends may lie from the curve's, relative to the curve's length.
_END_TOLERANCE = 1e-9


def check_law(curve: Curve, law: TimeLaw) -> None:
    """
    Raises:
        VerifyError: the law runs back, does not run along the whole curve, or contradicts itself.
    """
    if not len(law.times) == len(law.path) == len(law.speed) >= 2:
        counts = f"{len(law.times)}, {len(law.path)} and {len(law.speed)}"
        raise VerifyError(f"the time law needs as many times, path parameters and speeds, at least 2, got {counts}")
    if not np.all(np.diff(law.times) > 0.0) or not np.all(np.diff(law.path) >= 0.0) or not np.all(law.speed >= 0.0):
        raise VerifyError("the time law needs increasing times, a path that does not run back and speeds >= 0")
    scale = float(curve.knots[-1] - curve.knots[0])
    if not max(abs(law.path[0] - curve.knots[0]), abs(law.path[-1] - curve.knots[-1])) <= _END_TOLERANCE * scale:
        raise VerifyError(f"the time law runs from {law.path[0]} to {law.path[-1]}, not along the whole curve")
    # Relative to the step: errors that are small beside the whole curve would add up over many steps.
    error = np.abs(law.shares - 1.0)
    step = int(np.argmax(error))
    if not error[step] <= _STEP_TOLERANCE:
        raise VerifyError(
            f"the time law's path does not follow from its speeds and times: step {step} (at {law.times[step]} s) is "
            f"{law.shares[step]:.9g} times as long as they come to, expected 1 within {_STEP_TOLERANCE:g}"
        )
