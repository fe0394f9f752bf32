"""Solids of objects that a user gives by parameters: wheels, levers and simple shapes, alone or together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from perception.errors import MeshError
from perception.solids.mesh import Mesh, Solid, make_solid, unite_solids
from perception.solids.primitives import box, capsule, cylinder, torus

_SPOKE_PER_RIM = 0.6  # radius of a spoke by that of the rim's section, if it is not given
_HUB_PER_RADIUS = 0.2
_GRIP_PER_LEVER = 1.2
_ROUND = 8  # sides of a spoke


def make_box(size: Sequence[float]) -> list[Mesh]:
    """Return a box with edge lengths ``size`` [m], its centre at the origin."""
    half = 0.5 * np.asarray(size, dtype=float)
    return [box(-half, half)]  # type: ignore[arg-type]


def make_cylinder(radius: float, height: float) -> list[Mesh]:
    """Return a cylinder along z, its centre at the origin [m]."""
    return [cylinder((0.0, 0.0, -0.5 * height), (0.0, 0.0, 0.5 * height), radius)]


def make_capsule(radius: float, height: float) -> list[Mesh]:
    """Return a cylinder of length ``height`` along z with a half sphere on either end, its centre at the origin [m]."""
    return [capsule((0.0, 0.0, -0.5 * height), (0.0, 0.0, 0.5 * height), radius)]


def make_wheel(
    radius: float,
    rim_radius: float,
    n_spokes: int,
    spoke_radius: float | None = None,
    hub_radius: float | None = None,
) -> list[Mesh]:
    """Return a wheel about z, its centre at the origin; the first spoke lies along x.

    Args:
        radius: of the rim's centre line [m].
        rim_radius: of the rim's section [m].
        n_spokes: 0 for a ring without hub.
        spoke_radius: by default 0.6 of the rim's [m].
        hub_radius: by default a fifth of the wheel's radius [m].

    Raises:
        MeshError: the rim would cover the centre.
    """
    if rim_radius >= radius:
        raise MeshError(f"wheel: rim_radius {rim_radius:g} m is not smaller than radius {radius:g} m")
    parts = [torus((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), radius, rim_radius, 64, 12)]
    if not n_spokes:
        return parts
    spoke = _SPOKE_PER_RIM * rim_radius if spoke_radius is None else spoke_radius
    hub = _HUB_PER_RADIUS * radius if hub_radius is None else hub_radius
    for angle in 2.0 * np.pi * np.arange(n_spokes) / n_spokes:
        parts.append(cylinder((0.0, 0.0, 0.0), (radius * np.cos(angle), radius * np.sin(angle), 0.0), spoke, _ROUND))
    return [*parts, cylinder((0.0, 0.0, -rim_radius), (0.0, 0.0, rim_radius), hub, 24)]


def make_lever(length: float, radius: float, grip_length: float = 0.0, grip_radius: float | None = None) -> list[Mesh]:
    """Return a round lever along x from its pivot at the origin; with a grip, a crank, whose grip points along z.

    Args:
        length: from the pivot to the end, or to the axis of the grip [m].
        radius: of the lever's section [m].
        grip_length: 0 for a lever without grip [m].
        grip_radius: by default 1.2 of the lever's [m].
    """
    parts = [capsule((0.0, 0.0, 0.0), (length, 0.0, 0.0), radius)]
    if grip_length > 0.0:
        thick = _GRIP_PER_LEVER * radius if grip_radius is None else grip_radius
        parts.append(cylinder((length, 0.0, 0.0), (length, 0.0, grip_length), thick, 24))
    return parts


def unite_meshes(meshes: Sequence[Mesh], name: str = "object") -> Solid:
    """Return the solid that consists of several closed meshes, which may overlap.

    Raises:
        MeshError: a mesh has no volume, or there are too many triangles.
    """
    # The triangles of simple shapes are wound in any way, which is no defect of the user's.
    return replace(unite_solids([make_solid(mesh, name) for mesh in meshes], name), notes=())
