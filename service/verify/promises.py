"""What the phases promise: balance, planted feet, and paths of frames, bounded along the whole curve."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from service.verify.bisect import Evaluate, Extreme, largest
from service.verify.certificate import Basis, Check, Where
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Phase,
    PlantedContact,
    PoseTarget,
    RelativePoseTarget,
    SupportPolygon,
    Target,
)
from service.verify.paths import FramePath, MassPath
from service.verify.settings import VerifySettings
from service.verify.timeline import phase_edges, time_of
from service.verify.track import Track

# How far a support polygon may reach beyond the planted soles, which may themselves drift by about as much [m].
_SUPPORT_TOLERANCE_M = 1e-3


class PhaseChecks:
    """Checks of one motion's phases."""

    def __init__(self, track: Track, edges: Float[np.ndarray, "E"], settings: VerifySettings) -> None:
        """Prepare; ``edges`` hold all knots and phase boundaries."""
        self._motion, self._track, self._edges, self._settings = track.motion, track, edges, settings

    def run(self, phase: Phase) -> Iterator[Check]:
        """All checks of one phase."""
        edges = phase_edges(self._edges, phase)
        if phase.support is not None:
            yield self._balance(phase, phase.support, edges)
            if phase.contacts:
                yield _support_check(phase, phase.support)
        for contact in phase.contacts:
            yield from self._planted(phase, contact, edges)
        for target in phase.targets:
            yield from self._target(phase, target, edges)

    def _balance(self, phase: Phase, support: SupportPolygon, edges: Float[np.ndarray, "E"]) -> Check:
        path = MassPath(self._track, self._settings.rounding)

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            ends = _at_both(lambda s: outside_polygon(support.polygon, path.at(s)[:, :2]), first, last)
            # Each edge's distance is linear along the chord, so its largest value is at an end.
            return np.maximum(*ends) + path.deviation(first, last), *ends

        extreme = self._largest(edges, evaluate, -support.margin_m)
        point = path.at(np.array([extreme.s]))[0]
        name = f"balance.{phase.name}"
        text = f"the centre of mass stays {-1e3 * extreme.bound:.1f} mm inside the support polygon during {phase.name}"
        failure = f"the centre of mass is {in_or_out(-extreme.sampled)} the support polygon during {phase.name}"
        return self._check(name, extreme, -support.margin_m, "m", text, point, negate=True, failure=failure)

    def _planted(self, phase: Phase, contact: PlantedContact, edges: Float[np.ndarray, "E"]) -> Iterator[Check]:
        path = FramePath.of(self._track, contact.link, contact.sole, self._settings.rounding)
        pose = contact.pose_world_link
        planted = contact.sole @ pose[:3, :3].T + pose[:3, 3]

        def drift(s: np.ndarray) -> np.ndarray:
            return np.asarray(np.linalg.norm(path.at(s)[0] - planted, axis=2).max(axis=1))

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            # The distance from a fixed point is convex along the chord, so its largest value is at an end.
            ends = _at_both(drift, first, last)
            return np.maximum(*ends) + path.point_deviation(path.stretches(first, last)), *ends

        extreme = self._largest(edges, evaluate, contact.tolerance_m, contact.tolerance_m / 20.0)
        at = path.at(np.array([extreme.s]))[0][0].mean(axis=0)
        text = f"{contact.link} drifts at most {1e3 * extreme.bound:.2f} mm during {phase.name}"
        name = f"planted.{phase.name}.{contact.link}"
        yield self._check(name, extreme, contact.tolerance_m, "m", text, at, names=(contact.link,))
        knots = phase_edges(self._motion.curve.knots, phase)
        if len(knots):
            drifts = drift(knots)
            worst = int(drifts.argmax())
            found = Extreme(float(drifts[worst]), float(drifts[worst]), float(knots[worst]), True, 0)
            text = f"{contact.link} is off by at most {1e3 * found.bound:.3f} mm at the waypoints of {phase.name}"
            limit = contact.knot_tolerance_m
            yield self._check(f"{name}.waypoints", found, limit, "m", text, at, names=(contact.link,))

    def _target(self, phase: Phase, target: Target, edges: Float[np.ndarray, "E"]) -> Iterator[Check]:
        if isinstance(target, JointTarget):
            yield self._joint(phase, target)
        elif isinstance(target, PoseTarget):
            yield from self._pose(phase, target, edges)
        elif isinstance(target, RelativePoseTarget):
            yield from self._kept(phase, target, edges)
        elif isinstance(target, CircleTarget):
            yield self._circle(phase, target, edges)
            if target.frame_axis is not None:
                tolerance = target.axis_tolerance_rad
                yield self._axis(phase, AxisTarget(target.frame, target.frame_axis, target.axis, tolerance), edges)
        else:
            yield self._axis(phase, target, edges)

    def _joint(self, phase: Phase, target: JointTarget) -> Check:
        column = self._motion.robot.joint_names.index(target.joint)
        value = float(self._motion.curve(np.array([target.at]))[0, column])
        error = abs(value - target.value)
        found = Extreme(error, error, target.at, bool(error <= target.tolerance), 0)
        text = f"{target.joint} is at {value:.4f}, wanted {target.value:.4f}"
        return self._check(f"target.{phase.name}.{target.joint}", found, target.tolerance, "rad", text, None)

    def _pose(self, phase: Phase, target: PoseTarget, edges: Float[np.ndarray, "E"]) -> Iterator[Check]:
        path = self._origin(target.frame)
        wanted = np.eye(3) if target.rotation is None else target.rotation

        def shift(s: np.ndarray) -> np.ndarray:
            offset = np.abs((path.at(s)[0][:, 0] - target.position) @ wanted)
            return np.asarray(offset[:, np.isfinite(target.position_tolerance_m)])

        tolerance = target.position_tolerance_m[np.isfinite(target.position_tolerance_m)]
        name = f"target.{phase.name}.{target.frame}"
        if len(tolerance):
            yield self._components(phase, target, path, edges, shift, tolerance, name, "m")
        if target.rotation is None or not np.any(np.isfinite(target.rotation_tolerance)):
            return

        def turn(s: np.ndarray) -> np.ndarray:
            return np.asarray(np.abs(_sine_vector(wanted.T @ path.at(s)[1]))[:, np.isfinite(target.rotation_tolerance)])

        # The sine vector is linear in the rotation matrix, hence along the chord.
        sines = np.sin(np.minimum(target.rotation_tolerance[np.isfinite(target.rotation_tolerance)], 0.5 * np.pi))
        yield self._components(phase, target, path, edges, turn, sines, f"{name}.rotation", "rad")

    def _components(
        self,
        phase: Phase,
        target: PoseTarget,
        path: FramePath,
        edges: Float[np.ndarray, "E"],
        errors: Callable[[np.ndarray], np.ndarray],
        tolerance: Float[np.ndarray, "k"],
        name: str,
        unit: str,
    ) -> Check:
        """The largest error in units of its tolerance, at one pose or along the phase."""
        scale = float(tolerance.min())

        def relative(s: np.ndarray) -> np.ndarray:
            return np.asarray((errors(s) / tolerance).max(axis=1) * scale)

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            over = path.stretches(first, last)
            deviation = path.point_deviation(over) if unit == "m" else path.direction_deviation(over)
            ends = _at_both(relative, first, last)
            return np.maximum(*ends) + deviation, *ends

        if target.at is None:
            extreme = self._largest(edges, evaluate, scale, scale / 20.0)
        else:
            value = float(relative(np.array([target.at]))[0])
            extreme = Extreme(value, value, target.at, bool(value <= scale), 0)
        at = path.at(np.array([extreme.s]))[0][0, 0]
        shown = f"{1e3 * extreme.bound:.2f} mm" if unit == "m" else f"{np.rad2deg(extreme.bound):.3f} deg"
        text = f"{target.frame} is within {shown} of its target in {phase.name}"
        return self._check(name, extreme, scale, unit, text, at, names=(target.frame,))

    def _circle(self, phase: Phase, target: CircleTarget, edges: Float[np.ndarray, "E"]) -> Check:
        path = self._origin(target.frame)

        def split(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            offset = path.at(s)[0][:, 0] - target.centre
            height = offset @ target.axis
            return height, offset - height[:, None] * target.axis

        def error(height: np.ndarray, flat: np.ndarray) -> np.ndarray:
            return np.asarray(np.hypot(height, np.linalg.norm(flat, axis=1) - target.radius))

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            (h0, f0), (h1, f1) = split(first), split(last)
            # Along the chord the height is largest at an end, the radius largest at an end and smallest at its foot.
            outer = np.maximum(np.linalg.norm(f0, axis=1), np.linalg.norm(f1, axis=1)) - target.radius
            inner = target.radius - _segment_distance(f0, f1)
            upper = np.hypot(np.maximum(np.abs(h0), np.abs(h1)), np.maximum(outer, inner))
            upper = upper + path.point_deviation(path.stretches(first, last))
            return upper, error(h0, f0), error(h1, f1)

        extreme = self._largest(edges, evaluate, target.tolerance_m, target.tolerance_m / 20.0)
        at = path.at(np.array([extreme.s]))[0][0, 0]
        text = f"{target.frame} stays within {1e3 * extreme.bound:.2f} mm of its circle during {phase.name}"
        name = f"circle.{phase.name}.{target.frame}"
        return self._check(name, extreme, target.tolerance_m, "m", text, at, names=(target.frame,))

    def _kept(self, phase: Phase, target: RelativePoseTarget, edges: Float[np.ndarray, "E"]) -> Iterator[Check]:
        """How far a frame leaves its place relative to another, and how far it turns there."""
        path = self._origin(target.frame, target.reference)
        to = "the world" if target.reference is None else target.reference
        during = f"relative to {to} during {phase.name}"
        name = f"keep.{phase.name}.{target.frame}.{target.reference or 'world'}"
        names = (target.frame,) if target.reference is None else (target.frame, target.reference)
        kept = target.rotation if target.free_axis is None else target.rotation @ target.free_axis[:, None]

        def shift(s: np.ndarray) -> np.ndarray:
            return np.asarray(np.linalg.norm(path.at(s)[0][:, 0] - target.position, axis=1))

        def chord(s: np.ndarray) -> np.ndarray:
            """Largest distance of the tip of a kept unit vector from its place: 2 sin(half the angle) [-]."""
            rotation = path.at(s)[1]
            if target.free_axis is None:
                return np.asarray(np.linalg.norm(rotation - kept, axis=(1, 2)) / np.sqrt(2.0))
            return np.asarray(np.linalg.norm(rotation @ target.free_axis[:, None] - kept, axis=(1, 2)))

        def shifts(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            # The distance from a fixed place is convex along the chord, so its largest value is at an end.
            ends = _at_both(shift, first, last)
            return np.maximum(*ends) + path.point_deviation(path.stretches(first, last)), *ends

        def turns(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            # So is the distance of every unit vector's tip.
            ends = _at_both(chord, first, last)
            largest_chord = np.maximum(*ends) + path.direction_deviation(path.stretches(first, last))
            return _angle(largest_chord), _angle(ends[0]), _angle(ends[1])

        limit, angle = target.position_tolerance_m, target.rotation_tolerance_rad
        off = self._largest(edges, shifts, limit, limit / 20.0)
        turned = self._largest(edges, turns, angle, angle / 20.0)
        origin = self._origin(target.frame)
        text = f"{target.frame} stays within {1e3 * off.bound:.2f} mm of its place {during}"
        failure = f"{target.frame} is {1e3 * off.sampled:.2f} mm off its place {during}"
        at = origin.at(np.array([off.s]))[0][0, 0]
        yield self._check(name, off, limit, "m", text, at, names=names, failure=failure)
        what = target.frame if target.free_axis is None else f"the axis of {target.frame}"
        text = f"{what} turns at most {np.rad2deg(turned.bound):.3f} deg {during}"
        failure = f"{what} turns by {np.rad2deg(turned.sampled):.3f} deg {during}"
        at = origin.at(np.array([turned.s]))[0][0, 0]
        yield self._check(f"{name}.rotation", turned, angle, "rad", text, at, names=names, failure=failure)

    def _axis(self, phase: Phase, target: AxisTarget, edges: Float[np.ndarray, "E"]) -> Check:
        path = self._origin(target.frame)

        def split(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            direction = path.at(s)[1] @ target.frame_axis
            along = direction @ target.axis
            return along, np.linalg.norm(direction - along[:, None] * target.axis, axis=1)

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            (a0, p0), (a1, p1) = split(first), split(last)
            deviation = path.direction_deviation(path.stretches(first, last))
            # Across the axis the chord is farthest at an end, along it least at an end; the path is near the chord.
            upper = np.arctan2(np.maximum(p0, p1) + deviation, np.minimum(a0, a1) - deviation)
            return upper, np.arctan2(p0, a0), np.arctan2(p1, a1)

        if target.at is None:
            extreme = self._largest(edges, evaluate, target.tolerance_rad, target.tolerance_rad / 20.0)
        else:
            along, across = split(np.array([target.at]))
            value = float(np.arctan2(across, along)[0])
            extreme = Extreme(value, value, target.at, bool(value <= target.tolerance_rad), 0)
        at = path.at(np.array([extreme.s]))[0][0, 0]
        text = f"the axis of {target.frame} leans at most {np.rad2deg(extreme.bound):.2f} deg during {phase.name}"
        name = f"axis.{phase.name}.{target.frame}"
        return self._check(name, extreme, target.tolerance_rad, "rad", text, at, names=(target.frame,))

    def _origin(self, frame: str, reference: str | None = None) -> FramePath:
        return FramePath.of(self._track, frame, np.zeros((1, 3)), self._settings.rounding, reference)

    def _largest(
        self, edges: Float[np.ndarray, "E"], evaluate: Evaluate, limit: float, resolution: float | None = None
    ) -> Extreme:
        settings = self._settings
        fine = settings.resolution_m if resolution is None else resolution
        return largest(edges, evaluate, limit, fine, settings.max_halvings, settings.max_sharpenings)

    def _check(
        self,
        name: str,
        extreme: Extreme,
        limit: float,
        unit: str,
        text: str,
        position: np.ndarray | None,
        *,
        names: tuple[str, ...] = (),
        negate: bool = False,
        failure: str = "",
    ) -> Check:
        """``negate`` turns "at most -limit" into "at least limit"; ``failure`` is the text where a sample refutes."""
        sign = -1.0 if negate else 1.0
        point = None if position is None else (float(position[0]), float(position[1]), float(position[2]))
        where = Where(extreme.s, time_of(self._motion.law, extreme.s), point, names)
        is_ok = bool(extreme.sampled <= limit)
        value = sign * float(extreme.bound if extreme.is_proven else extreme.sampled)
        basis = Basis.PROOF if extreme.is_proven else Basis.UNPROVEN if is_ok else Basis.SAMPLES
        if not extreme.is_proven:
            text = f"not shown that {text}" if is_ok else failure or f"not so: {text}"
        return Check(name, is_ok, value, sign * float(limit), unit, text, where, basis)


def _at_both(
    values: Callable[[np.ndarray], np.ndarray], first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]
) -> tuple[Float[np.ndarray, "I"], Float[np.ndarray, "I"]]:
    """Values at both ends of stretches."""
    found = values(np.concatenate([first, last]))
    return found[: len(first)], found[len(first) :]


def _support_check(phase: Phase, support: SupportPolygon) -> Check:
    """Whether the polygon is no wider than the hull of what is planted: a wider one would promise no balance."""
    corners = [c.sole @ c.pose_world_link[:3, :3].T + c.pose_world_link[:3, 3] for c in phase.contacts]
    ground = np.concatenate(corners)[:, :2]
    try:
        value = float(outside_polygon(ground[ConvexHull(ground).vertices], support.polygon).max())
    except QhullError:  # soles on one line hold up nothing
        value = np.inf
    is_ok = value <= _SUPPORT_TOLERANCE_M
    text = f"the support polygon of {phase.name} reaches {1e3 * value:.1f} mm beyond the planted soles"
    return Check(f"support.{phase.name}", is_ok, value, _SUPPORT_TOLERANCE_M, "m", text, None, Basis.PROOF)


def in_or_out(inside_m: float) -> str:
    """How far inside or outside, in words, ready for what it is inside of."""
    return f"{1e3 * inside_m:.1f} mm inside" if inside_m >= 0.0 else f"{-1e3 * inside_m:.1f} mm outside"


def outside_polygon(polygon: Float[np.ndarray, "E 2"], points: Float[np.ndarray, "S 2"]) -> Float[np.ndarray, "S"]:
    """Largest signed distance of points outside the polygon's edges [m]; negative inside."""
    along = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(along, axis=1)
    keep = length > 1e-12
    normal = np.stack([along[keep, 1], -along[keep, 0]], axis=1) / length[keep, None]
    return np.asarray(((points[:, None] - polygon[keep]) * normal).sum(axis=2).max(axis=1))


def _sine_vector(rotation: Float[np.ndarray, "S 3 3"]) -> Float[np.ndarray, "S 3"]:
    """sin(angle) times the rotation's axis; beyond a quarter turn a vector longer than any sine."""
    sine = 0.5 * np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    is_far = np.trace(rotation, axis1=1, axis2=2) <= 1.0
    return np.where(is_far[:, None], 2.0, sine)


def _angle(chord: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """The angle between two unit vectors whose tips are ``chord`` apart [rad]; half a turn beyond the diameter."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def _segment_distance(a: Float[np.ndarray, "I 3"], b: Float[np.ndarray, "I 3"]) -> Float[np.ndarray, "I"]:
    """Distance of the origin from segments."""
    step = b - a
    along = np.clip(-(a * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + along[:, None] * step, axis=1))
