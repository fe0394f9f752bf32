"""Detected wheel valve: its dimensions, the turning bodies (rim, hub, spokes), the fixed stem, and its points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.valve.lever_valve import LeverDetection
from perception.detect.valve.ring import Ring, wheel_basis

_SECTION = 8
_ROUND = 12
_CUT = 0.03
_STEM_BEHIND = 0.6
_USUAL_STEM_RADIUS = 0.02
_FEWEST_POINTS = 20
_EXPLAINED = 0.85


@dataclass(frozen=True)
class ValveDetection:
    """Detected wheel valve.

    Attributes:
        centre: (3,) of the rim [m].
        axis: (3,) unit, towards the sensor.
        rim_radius: of the rim's centre line [m].
        tube_radius: half width of the rim along the radius [m].
        half_depth: half thickness of the rim along the axis [m].
        spoke_angles: about the axis, from ``wheel_basis(axis)[0]`` (horizontal), right-handed [rad].
        hub_radius: radius within which almost all rays ended on the wheel [m].
        inner_depth: lowest and highest axial position of the returns inside the rim [m].
        rms: root mean square of the rim's depth residuals [m].
        n_inliers: number of rays that ended on the rim.
        spoke_half_width: half width of the spokes [m].
        spoke_share: share of the returns between hub and rim that lie on the spokes, 0 to 1.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    rim_radius: float
    outer_radius: float
    tube_radius: float
    half_depth: float
    spoke_angles: tuple[float, ...]
    hub_radius: float
    inner_depth: tuple[float, float]
    confidence: float
    rms: float
    n_inliers: int
    spoke_half_width: float = 0.0
    spoke_share: float = 0.0

    @property
    def ring(self) -> Ring:
        """The rim as a ring."""
        return Ring(self.centre, self.axis, self.rim_radius, self.tube_radius, self.half_depth)

    def as_detection(self) -> Detection:
        """Return the valve in its frame: z the axis, x horizontal, origin at the rim's centre."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = wheel_basis(self.axis).T, self.centre
        sizes = {"outer_radius": self.outer_radius, "rim_radius": self.rim_radius, "tube_radius": self.tube_radius}
        angle = 2.0 * np.pi * np.arange(36) / 36
        rim = self.rim_radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(36)])
        points = rim @ pose[:3, :3].T + self.centre
        return Detection("valve", pose, sizes, self.confidence, {"rms": self.rms}, points, self)

    def split_off(self, points: Float[np.ndarray, "N 3"], /) -> tuple[Bool[np.ndarray, "N"], tuple[ConvexPiece, ...]]:
        """Return (N,) points on wheel or stem, and the stem; no stem when none was seen."""
        own = wheel_points(self, points)
        stem = stem_of(self, points[~own])
        if stem is None:
            return own, ()
        own[~own] = stem_points(self, stem, points[~own])
        return own, (stem,)

    def see_past(
        self, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], /
    ) -> Float[np.ndarray, "R 3"]:
        """Return the ends as they are: a wheel hides nothing that matters."""
        return ends

    def list_sides(self) -> Float[np.ndarray, "F 4"]:
        """Return no half-spaces: a wheel fills no opening."""
        return np.zeros((0, 4))


def select_turnable(detections: Iterable[Detection]) -> tuple[ValveDetection | LeverDetection, ...]:
    """Return the wheels and levers of valves among detections, in their order."""
    return tuple(hit.model for hit in detections if isinstance(hit.model, ValveDetection | LeverDetection))


def select_wheels(detections: Iterable[Detection]) -> tuple[ValveDetection, ...]:
    """Return the wheel valves among detections, in their order."""
    return tuple(hit.model for hit in detections if isinstance(hit.model, ValveDetection))


def valve_bodies(
    detection: ValveDetection, n_segments: int = 20, margin: float = 0.004
) -> dict[str, Float[np.ndarray, "V 3"]]:
    """Return the turning wheel as convex vertex sets, world coordinates [m].

    ``rim/0`` ... circumscribe the rim.  Its inside is ``hub`` and ``spoke/0`` ... when the spokes were clearly seen,
    otherwise only ``hub``, a disc out to the rim.

    Args:
        n_segments: number of rim segments, at least 3.
        margin: added on all sides [m].
    """
    bodies = rim_bodies(detection, n_segments, margin)
    inner = max(detection.rim_radius - detection.tube_radius, 0.0)
    if not has_clear_spokes(detection):
        return bodies | {"hub": _disc(detection, max(inner, 0.01) + margin, margin)}
    bodies["hub"] = _disc(detection, max(detection.hub_radius, 0.01) + margin, margin)
    for i, angle in enumerate(detection.spoke_angles):
        bodies[f"spoke/{i}"] = _spoke(detection, angle, margin)
    return bodies


def rim_bodies(
    detection: ValveDetection, n_segments: int = 20, margin: float = 0.004
) -> dict[str, Float[np.ndarray, "V 3"]]:
    """Return the rim's bodies of ``valve_bodies``, ``rim/0`` ..., world coordinates [m]."""
    return {f"rim/{i}": _segment(detection, i, n_segments, margin) for i in range(n_segments)}


def has_clear_spokes(detection: ValveDetection) -> bool:
    """Return whether the spokes were seen clearly enough for a hand to enter the openings between them."""
    n_spokes = len(detection.spoke_angles)
    return bool(
        detection.confidence >= CONFIDENT
        and 2 <= n_spokes <= 8
        and detection.hub_radius < 0.7 * (detection.rim_radius - detection.tube_radius)
        and detection.spoke_share >= _EXPLAINED
        and 2.0 * detection.spoke_half_width * n_spokes < 0.5 * 2.0 * np.pi * 0.6 * detection.rim_radius
    )


def _segment(detection: ValveDetection, i: int, n_segments: int, margin: float) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of two circumscribed end sections, the outer ones extended to where the tangents meet."""
    corner = 2.0 * np.pi * (np.arange(_SECTION) + 0.5) / _SECTION
    grow = 1.0 / np.cos(np.pi / _SECTION)
    distance = detection.rim_radius + grow * (detection.tube_radius + margin) * np.cos(corner)
    height = grow * (detection.half_depth + margin) * np.sin(corner)
    distance = np.where(distance > detection.rim_radius, distance / np.cos(np.pi / n_segments), distance)
    ends = [2.0 * np.pi * (i + k) / n_segments for k in (0, 1)]
    local = [np.column_stack([distance * np.cos(a), distance * np.sin(a), height]) for a in ends]
    return _to_world(detection, np.concatenate(local))


def _disc(detection: ValveDetection, radius: float, margin: float) -> Float[np.ndarray, "V 3"]:
    low, high = _depth(detection, margin)
    angle = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    rim = radius / np.cos(np.pi / _ROUND) * np.column_stack([np.cos(angle), np.sin(angle)])
    return _to_world(detection, np.concatenate([np.column_stack([rim, np.full(_ROUND, h)]) for h in (low, high)]))


def _spoke(detection: ValveDetection, angle: float, margin: float) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of a bar from the hub into the rim, as wide as the detected spokes."""
    low, high = _depth(detection, margin)
    half = detection.spoke_half_width + margin
    start, end = 0.7 * detection.hub_radius, detection.rim_radius
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    flat = [r * along + s * half * across for r in (start, end) for s in (-1, 1)]
    return _to_world(detection, np.array([[*xy, h] for xy in flat for h in (low, high)]))


def _depth(detection: ValveDetection, margin: float) -> tuple[float, float]:
    """Return lowest and highest axial position of the wheel, at least its rim's, with the margin [m]."""
    low, high = detection.inner_depth
    return min(low, -detection.half_depth) - margin, max(high, detection.half_depth) + margin


def _to_world(detection: ValveDetection, local: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    return np.asarray(detection.centre + local @ detection.ring.basis)


def _in_wheel(
    detection: ValveDetection, points: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return (N,) distance from the axis and (N,) height along it of the points [m]."""
    local = (points - detection.centre) @ detection.ring.basis.T
    return np.hypot(local[:, 0], local[:, 1]), local[:, 2]


def wheel_points(detection: ValveDetection, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return (N,) points of the wheel: within 3 cm of the cylinder that encloses it."""
    distance, height = _in_wheel(detection, points)
    low, high = _depth(detection, 0.0)
    return np.asarray((distance <= detection.outer_radius + _CUT) & (height >= low - _CUT) & (height <= high + _CUT))


def stem_of(detection: ValveDetection, points: Float[np.ndarray, "N 3"]) -> ConvexPiece | None:
    """Return the prism ``stem`` from the wheel to the carrier behind it; None when too few points are behind it."""
    distance, height = _in_wheel(detection, points)
    back = -_depth(detection, 0.0)[0]
    behind = (height < -back - _CUT) & (height > -_STEM_BEHIND)
    carrier = behind & (distance < 2.0 * detection.outer_radius)
    if carrier.sum() < _FEWEST_POINTS:
        return None
    end = float(-np.median(height[carrier & (distance > 0.5 * detection.rim_radius)]))
    shaft = behind & (distance < 0.45 * detection.rim_radius) & (height > -end + _CUT)
    radius = _USUAL_STEM_RADIUS
    if shaft.sum() >= 5:
        radius = float(np.clip(np.percentile(distance[shaft], 85), 0.01, 0.05))
    angle = 2.0 * np.pi * np.arange(_SECTION) / _SECTION
    rim = radius / np.cos(np.pi / _SECTION) * np.column_stack([np.cos(angle), np.sin(angle)])
    local = [np.column_stack([rim, np.full(_SECTION, h)]) for h in (-back, -end)]
    return ConvexPiece("stem", _to_world(detection, np.concatenate(local)), kind="stem")


def stem_points(
    detection: ValveDetection, stem: ConvexPiece, points: Float[np.ndarray, "N 3"]
) -> Bool[np.ndarray, "N"]:
    """Return (N,) points within 1.5 cm of the stem, without the carrier's points."""
    distance, height = _in_wheel(detection, points)
    radius, ends = _in_wheel(detection, stem.vertices)
    return np.asarray((distance <= radius.max() + 0.015) & (height >= ends.min() + _CUT) & (height <= ends.max()))
