"""Contacts that carry force: points with friction and a force cap on a link, and their places in the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Edges of the pyramid of forces at a contact point. They lie on the friction cone, so the pyramid is inside it: of the
# friction halfway between two edges 29 % is not used.
N_PYRAMID_EDGES = 4
GRAVITY = 9.81  # [m/s^2], down the world's z axis

_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Contact:
    """Points of one link that press on the surroundings, or are pressed by them.

    Attributes:
        link: frame of the robot's model that carries the points.
        points: (C, 3) in the link's frame [m]; at least one.
        normals: (C, 3) unit vectors in the link's frame: directions in which the surroundings push on the link.
        friction: coefficient mu, tangential over normal force; not negative.
        force_cap_n: largest normal force of each point [N]; positive and finite.
        reference: None where the surroundings are fixed in the world, otherwise the mechanism's link that is touched.
            A mechanism that moves freely carries only its stated load: such a contact must not hold the robot up.

    Raises:
        ValueError: a field has a wrong shape, is not finite, or is outside its range.
    """

    link: str
    points: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    friction: float
    force_cap_n: float
    reference: str | None = None

    def __post_init__(self) -> None:
        place = f"contact of {self.link}"
        object.__setattr__(self, "points", np.array(self.points, dtype=float))
        object.__setattr__(self, "normals", np.array(self.normals, dtype=float))
        _check_points(place, self.points, self.normals)
        _check_friction(place, np.array([self.friction], dtype=float))
        if not 0.0 < self.force_cap_n < np.inf:
            raise ValueError(f"{place}: force_cap_n must be positive and finite, got {self.force_cap_n:g}")

    def place(self, pose_world_link: Float[np.ndarray, "4 4"]) -> WorldContacts:
        """Return the points where the link's pose puts them."""
        rotation, count = pose_world_link[:3, :3], len(self.points)
        return WorldContacts(
            self.points @ rotation.T + pose_world_link[:3, 3],
            self.normals @ rotation.T,
            np.full(count, self.friction),
            np.full(count, self.force_cap_n),
        )


@dataclass(frozen=True)
class WorldContacts:
    """Contact points in the world.

    Attributes:
        points: (C, 3) [m].
        normals: (C, 3) unit vectors: directions in which the surroundings push on the robot.
        friction: (C,) coefficients mu.
        caps: (C,) largest normal forces [N].

    Raises:
        ValueError: shapes differ, a value is not finite, or a value is outside its range.
    """

    points: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    friction: Float[np.ndarray, "C"]
    caps: Float[np.ndarray, "C"]

    def __post_init__(self) -> None:
        for name in ("points", "normals", "friction", "caps"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
        _check_points("contacts", self.points, self.normals)
        for name, values in (("friction", self.friction), ("caps", self.caps)):
            if values.shape != (len(self.points),):
                raise ValueError(f"contacts: {name} must have shape ({len(self.points)},), got {values.shape}")
        _check_friction("contacts", self.friction)
        bad = ~((self.caps > 0.0) & np.isfinite(self.caps))
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(f"contacts: caps[{i}] must be positive and finite, got {self.caps[i]:g}")

    @staticmethod
    def join(parts: Iterable[WorldContacts]) -> WorldContacts:
        """Return the points of all parts in their sequence.

        Raises:
            ValueError: there is no part.
        """
        parts = tuple(parts)
        if not parts:
            raise ValueError("contacts: expected at least one contact, got none")
        return WorldContacts(
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.friction for part in parts]),
            np.concatenate([part.caps for part in parts]),
        )

    def tilt_normals(self, tilt_rad: Float[np.ndarray, "#C"] | float) -> WorldContacts:
        """Return contacts whose forces are allowed for every normal within ``tilt_rad``, one or (C,), of the given one.

        The cone shrinks to ``tan(atan(mu) - tilt)``. The cap shrinks because a force may press more along a tilted
        normal.

        Raises:
            ValueError: the angle is negative or not finite, or some friction cone is no wider than the angle.
        """
        tilts = np.broadcast_to(np.asarray(tilt_rad, dtype=float), self.friction.shape)
        bad = ~((tilts >= 0.0) & np.isfinite(tilts))
        if bad.any():
            raise ValueError(f"tilt_rad must be finite and not negative, got {tilts[int(bad.argmax())]:g}")
        if not tilts.any():
            return self
        angles = np.arctan(self.friction)
        if (angles <= tilts).any():
            i = int((angles - tilts).argmin())
            raise ValueError(
                f"tilt_rad {tilts[i]:g} leaves no friction at contact point {i}, "
                f"whose friction {self.friction[i]:g} is an angle of {angles[i]:.4f} rad"
            )
        friction = np.tan(angles - tilts)
        # A force on the smaller cone has the length sqrt(1 + mu'^2) per normal force. It presses most along the allowed
        # normal that is nearest to it.
        pressing = np.sqrt(1.0 + friction**2) * np.cos(np.maximum(angles - 2.0 * tilts, 0.0))
        return WorldContacts(self.points, self.normals, friction, self.caps / pressing)

    def list_pyramid_edges(self) -> Float[np.ndarray, "C K 3"]:
        """Return per point the ``N_PYRAMID_EDGES`` forces of unit normal force on the edges of its pyramid.

        One edge leans up as far as friction allows (on level ground: along the world's x axis), so that friction of a
        wall carries its full weight.
        """
        n = self.normals / np.linalg.norm(self.normals, axis=1, keepdims=True)
        helper = np.where(np.abs(n[:, 2:]) < 1.0 - 1e-6, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        u = helper - np.einsum("ci,ci->c", helper, n)[:, None] * n
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        v = np.cross(n, u)
        angles = 2.0 * np.pi * np.arange(N_PYRAMID_EDGES) / N_PYRAMID_EDGES
        sides = np.cos(angles)[:, None] * u[:, None] + np.sin(angles)[:, None] * v[:, None]
        return np.asarray(n[:, None] + self.friction[:, None, None] * sides)


def _check_points(place: str, points: Float[np.ndarray, "..."], normals: Float[np.ndarray, "..."]) -> None:
    """Check shapes, finite values and lengths of normals."""
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ValueError(f"{place}: points must have shape (C, 3) with C at least 1, got {points.shape}")
    if normals.shape != points.shape:
        raise ValueError(f"{place}: normals must have the shape of points, {points.shape}, got {normals.shape}")
    for name, values in (("points", points), ("normals", normals)):
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(f"{place}: {name}[{i}] must be finite, got {values[i].tolist()}")
    lengths = np.linalg.norm(normals, axis=1)
    off = np.abs(lengths - 1.0)
    if off.max() > _UNIT_TOLERANCE:
        i = int(off.argmax())
        raise ValueError(f"{place}: normals[{i}] must be a unit vector, its length is {lengths[i]:g}")


def _check_friction(place: str, friction: Float[np.ndarray, "C"]) -> None:
    """Check that coefficients are finite and not negative."""
    bad = ~((friction >= 0.0) & np.isfinite(friction))
    if bad.any():
        raise ValueError(f"{place}: friction must be finite and not negative, got {friction[bad.argmax()]:g}")
