"""Detected lever valve or crank: its dimensions, the bodies that turn, and its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.bars import Bar, SurroundingRays, cross_bar, sort_rays
from perception.detect.valve.ring import wheel_basis
from perception.sightlines import SightIndex

_CUT, _CUT_BEFORE = 0.03, 0.035  # around bar and grip, and on the sensor's side of the bar: noise lies along rays [m]
_BEYOND_STEM = 0.004  # of the stem's end before the bar [m]
_ROUND = 12
_AT_GRIP, _LEAST_GRIP, _MOST_GRIP = 0.028, 0.04, 0.25  # from the grip's axis; length of a grip [m]
_LIFTED = 3.0  # standard deviations by which noise lifts points
_LAYER, _FEWEST_IN_LAYER = 0.02, 2  # in which a grip shows points
_ABOUT_GRIP = 0.045  # from a grip that is roughly known [m]
_USUAL_GRIP_RADIUS = 0.014
_MOST_HIDDEN = 4  # layers of a grip that points at the sensor
_CORE, _FEWEST_PASSES = 0.007, 2  # radius that no ray passes within a grip [m]; rays that show that there is none


@dataclass(frozen=True)
class LeverDetection:
    """Lever valve, or crank: a bar from its spindle, and at the end of a crank's bar a grip parallel to the spindle.

    Attributes:
        centre: (3,) where the spindle's axis meets the bar's centre line [m].
        axis: (3,) unit, towards the sensor.
        direction: (3,) unit, perpendicular to the axis: from the spindle along the bar.
        length: of the bar from the spindle's axis to its end; of a crank to the grip's axis [m].
        radius: half the bar's thickness [m].
        confidence: 0 to 1.
        rms: root mean square of the depth residuals [m].
        n_inliers: number of rays that ended on the bar.
        hub_radius: of the stem's end about the axis [m].
        grip_length: from the bar's centre line to the grip's end; 0 for a lever [m].
        grip_radius: half the grip's thickness [m].
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    length: float
    radius: float
    confidence: float
    rms: float
    n_inliers: int
    hub_radius: float = 0.016
    grip_length: float = 0.0
    grip_radius: float = _USUAL_GRIP_RADIUS

    @property
    def rim_radius(self) -> float:
        """Radius of the circle on which the bar's end moves [m]."""
        return self.length

    @property
    def angle(self) -> float:
        """Angle of the bar about the axis, from ``wheel_basis(axis)[0]``, right-handed [rad]."""
        first, second, _ = wheel_basis(self.axis)
        return float(np.arctan2(self.direction @ second, self.direction @ first))

    @property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Rows: along the bar, across it, the axis."""
        return np.stack([self.direction, cross(self.axis, self.direction), self.axis])

    def split_off(self, points: Float[np.ndarray, "N 3"], /) -> tuple[Bool[np.ndarray, "N"], tuple[ConvexPiece, ...]]:
        """Return (N,) points on bar or grip; the stem stays with what carries it."""
        local = (points - self.centre) @ self.frame.T
        along = np.clip(local[:, 0], 0.0, self.length)
        own = np.hypot(np.hypot(local[:, 1], local[:, 2]), local[:, 0] - along) <= self.radius + np.where(
            local[:, 2] > 0.0, _CUT_BEFORE, _CUT
        )
        if self.grip_length > 0.0:
            up = np.clip(local[:, 2], 0.0, self.grip_length)
            aside = np.hypot(local[:, 0] - self.length, local[:, 1])
            own |= np.hypot(aside, local[:, 2] - up) <= self.grip_radius + _CUT_BEFORE
        return np.asarray(own), ()

    def see_past(
        self, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], /
    ) -> Float[np.ndarray, "R 3"]:
        """Return the ends as they are: a lever hides nothing that matters."""
        return ends

    def list_sides(self) -> Float[np.ndarray, "F 4"]:
        """Return no half-spaces: a lever fills no opening."""
        return np.zeros((0, 4))


def lever_bodies(lever: LeverDetection, margin: float = 0.004) -> dict[str, Float[np.ndarray, "V 3"]]:
    """Return what turns as convex vertex sets, world coordinates [m]: ``bar``, ``hub``, and a crank's ``grip``.

    Args:
        margin: added on all sides [m].
    """
    half = lever.radius + margin
    end = lever.length + (lever.radius if lever.grip_length > 0.0 else 0.0) + margin
    bar = np.array([[x, y, z] for x in (0.0, end) for y in (-half, half) for z in (-half, half)])
    bodies = {"bar": bar, "hub": _stack(0.0, lever.hub_radius + margin, -half, half + _BEYOND_STEM)}
    if lever.grip_length > 0.0:
        bodies["grip"] = _stack(lever.length, lever.grip_radius + margin, -half, lever.grip_length + margin)
    return {name: np.asarray(lever.centre + local @ lever.frame) for name, local in bodies.items()}


def _stack(along: float, radius: float, low: float, high: float) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of a prism about an axis parallel to the spindle that contains a cylinder."""
    angle = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    rim = radius / np.cos(np.pi / _ROUND) * np.column_stack([np.cos(angle), np.sin(angle)]) + [along, 0.0]
    return np.concatenate([np.column_stack([rim, np.full(_ROUND, height)]) for height in (low, high)])


def is_about_grip(
    points: Float[np.ndarray, "N 3"], pose: Float[np.ndarray, "4 4"], grip: tuple[float, float], radius: float
) -> Bool[np.ndarray, "N"]:
    """Return (N,) points on or about a grip of ``find_grip``, before the bar at whose end it stands."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    aside = np.hypot(local[:, 0] - grip[1], local[:, 1])
    return np.asarray((aside < _ABOUT_GRIP) & (local[:, 2] > 1.3 * radius) & (local[:, 2] < grip[0] + _ABOUT_GRIP))


def find_grip(
    points: Float[np.ndarray, "N 3"],
    pose: Float[np.ndarray, "4 4"],
    length: float,
    radius: float,
    noise: float,
    index: SightIndex,
) -> tuple[float, float]:
    """Return length of the grip at the end of a bar, and the distance of its axis from the spindle; 0 without one [m].

    A grip shows points in every layer from the bar to its end.  Of one that points at the sensor little more than the
    end is seen: layers without points belong to it where no ray passes through them.

    Args:
        points: (N, 3) of the scan [m].
        pose: (4, 4) of the bar: origin at the spindle, x along it, z the spindle's axis towards the sensor.
        length: of the bar [m].
        radius: half its thickness [m].
        noise: standard deviation of the returns along their rays; it alone lifts points off the bar [m].
        index: of the scan's rays.
    """
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    near = (np.abs(local[:, 1]) < _AT_GRIP) & (np.abs(local[:, 0] - length) < 2.0 * _AT_GRIP)
    near &= (local[:, 2] > radius) & (local[:, 2] < _MOST_GRIP)
    local = local[near]
    lows = radius + _LAYER * np.arange(int(_MOST_GRIP / _LAYER))
    has_points = [
        np.count_nonzero((local[:, 2] >= low) & (local[:, 2] < low + _LAYER)) >= _FEWEST_IN_LAYER for low in lows
    ]
    filled = np.flatnonzero(has_points)
    empty = np.flatnonzero(~np.array(has_points))
    n_layers = int(empty[0]) if len(empty) else len(lows)
    hidden = filled[(filled > n_layers) & (filled <= n_layers + _MOST_HIDDEN)]
    if len(hidden):
        end = local[(local[:, 2] >= lows[hidden[0]]) & (local[:, 2] < lows[hidden[0]] + 2.0 * _LAYER), :2].mean(axis=0)
        frame = pose[:3, [2, 0, 1]].T
        foot = pose[:3, 3] + pose[:3, :2] @ end
        core = Bar(frame, foot, (_CORE, _CORE), float(lows[n_layers]), float(lows[hidden[0]]), "round")
        if not _is_passed(core, index):
            beyond = empty[empty > hidden[0]]
            n_layers = int(beyond[0]) if len(beyond) else len(lows)
    within = local[local[:, 2] < radius + n_layers * _LAYER]
    tall = float(np.percentile(within[:, 2], 93)) if len(within) else 0.0
    if tall < max(_LEAST_GRIP, radius + _LIFTED * noise):
        return 0.0, length
    return tall, float(np.median(within[within[:, 2] > 0.4 * tall, 0]))


def _is_passed(core: Bar, index: SightIndex) -> bool:
    """Return whether rays went on through the core of a part of a grip."""
    near = index.passing(core.places(0.5 * _LAYER), _CORE)
    rays = SurroundingRays(near.start, near.direction, near.length, np.zeros(len(near), dtype=bool))
    crossing = cross_bar(rays, core)
    within = (crossing.outside < 0.0) & (crossing.along > core.first) & (crossing.along < core.last)
    return int(np.count_nonzero(within & sort_rays(rays, crossing).passed)) >= _FEWEST_PASSES
