"""Convex bodies of a door's moving parts: the leaf with what is fixed to it, and the lever or push bar."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry

LEAF_LINK = "door/leaf"
HANDLE_LINK = "door/handle"

# Parts that a geometry does not hold have their usual size [m].
POST_INSET = 0.04  # from a pull handle's end to the middle of its post
ROSE_RADIUS, ROSE_DEPTH = 0.027, 0.01
HOUSING_HALF_WIDTH, HOUSING_HALF_HEIGHT, HOUSING_BEYOND_BAR = 0.04, 0.03, 0.015

_SIDES = 8
_TIP = np.tan(np.pi / 8.0)


def door_bodies(geometry: DoorGeometry) -> dict[str, dict[str, Float[np.ndarray, "V 3"]]]:
    """Return the convex bodies of each link of a door, with the leaf shut and the lever at rest.

    ``door/leaf`` has ``leaf``, a slab; with a lever its ``rose``; with a pull handle ``bar``, ``post 1`` and
    ``post 2``; with a push bar ``housing 1`` and ``housing 2``; with a knob ``knob`` and ``rose``.  ``door/handle``
    has ``lever`` and ``neck``, or the push bar's ``bar``; other doors have no such link.  Round parts are
    circumscribed by octagons (1.08 times their radius at the corners) and otherwise not grown.

    Returns:
        vertices (V, 3) by link and body, in the world [m].
    """
    leaf = {"leaf": _slab(geometry)}
    handle = geometry.handle
    if handle is None:
        return {LEAF_LINK: leaf}
    foot = handle.centre - (handle.centre - geometry.hinge) @ geometry.normal * geometry.normal
    foot = foot + geometry.face * geometry.normal
    match handle.kind:
        case "lever":
            turning = {"lever": _lever(handle), "neck": _prism(foot, handle.centre, handle.radius)}
            return {LEAF_LINK: leaf | {"rose": _rose(geometry, foot)}, HANDLE_LINK: turning}
        case "push_bar":
            return {
                LEAF_LINK: leaf | _housings(geometry, handle, foot),
                HANDLE_LINK: {"bar": _flat_bar(geometry, handle)},
            }
        case "pull":
            return {LEAF_LINK: leaf | _pull(handle, foot)}
        case "knob":
            return {LEAF_LINK: leaf | {"rose": _rose(geometry, foot), "knob": _knob(geometry, handle, foot)}}


def _slab(geometry: DoorGeometry) -> Float[np.ndarray, "8 3"]:
    low = (0.0, geometry.face - geometry.thickness, 0.0)
    return _box(geometry, geometry.hinge, low, (geometry.width, geometry.face, geometry.height))


def _box(
    geometry: DoorGeometry,
    origin: Float[np.ndarray, "3"],
    low: tuple[float, float, float],
    high: tuple[float, float, float],
) -> Float[np.ndarray, "8 3"]:
    """Return the corners of a box, its borders given along the leaf, along its normal, and up, from ``origin`` [m]."""
    axes = np.stack([geometry.along, geometry.normal, UP])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return np.asarray(origin + corners @ axes)


def _lever(handle: HandleGeometry) -> Float[np.ndarray, "V 3"]:
    """Return a bar from the spindle to the free end, round at both ends."""
    end = handle.centre + max(handle.length - handle.radius, 0.0) * handle.direction
    tip = _TIP * handle.radius
    rings = [(handle.centre, -handle.radius, tip), (handle.centre, -tip, handle.radius)]
    rings += [(end, tip, handle.radius), (end, handle.radius, tip)]
    return np.concatenate([_ring(at + ahead * handle.direction, handle.direction, r) for at, ahead, r in rings])


def _rose(geometry: DoorGeometry, foot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "V 3"]:
    return _prism(foot, foot + ROSE_DEPTH * geometry.normal, ROSE_RADIUS, 2 * _SIDES)


def _flat_bar(geometry: DoorGeometry, handle: HandleGeometry) -> Float[np.ndarray, "8 3"]:
    """Return a push bar between the middles of its housings."""
    half = 0.5 * handle.length * abs(float(handle.direction @ geometry.along))
    up = 0.5 * handle.height if handle.height is not None else handle.radius
    return _box(geometry, handle.centre, (-half, -handle.radius, -up), (half, handle.radius, up))


def _housings(
    geometry: DoorGeometry, handle: HandleGeometry, foot: Float[np.ndarray, "3"]
) -> dict[str, Float[np.ndarray, "8 3"]]:
    out = float((handle.centre - foot) @ geometry.normal) + HOUSING_BEYOND_BAR
    bodies = {}
    for i, share in enumerate((-0.5, 0.5)):
        end = foot + share * handle.length * handle.direction
        low = (-HOUSING_HALF_WIDTH, 0.0, -HOUSING_HALF_HEIGHT)
        bodies[f"housing {i + 1}"] = _box(geometry, end, low, (HOUSING_HALF_WIDTH, out, HOUSING_HALF_HEIGHT))
    return bodies


def _pull(handle: HandleGeometry, foot: Float[np.ndarray, "3"]) -> dict[str, Float[np.ndarray, "V 3"]]:
    half = 0.5 * handle.length * handle.direction
    bodies = {"bar": _prism(handle.centre - half, handle.centre + half, handle.radius)}
    aside = max(0.5 * handle.length - POST_INSET, 0.0) * handle.direction
    for i, shift in enumerate((-aside, aside)):
        bodies[f"post {i + 1}"] = _prism(foot + shift, handle.centre + shift, handle.radius)
    return bodies


def _knob(geometry: DoorGeometry, handle: HandleGeometry, foot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "V 3"]:
    """Return the hull of a knob and its neck, both round about the normal."""
    half = 0.5 * handle.length
    shape = [(-0.3 * half, 1.0), (0.4 * half, 1.0), (half, 0.6)]
    rings = [_ring(foot, geometry.normal, 0.5 * handle.radius)]
    rings += [_ring(handle.centre + out * geometry.normal, geometry.normal, r * handle.radius) for out, r in shape]
    return np.concatenate(rings)


def _prism(
    start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], radius: float, n_sides: int = _SIDES
) -> Float[np.ndarray, "V 3"]:
    """Return a straight round bar with flat ends."""
    axis = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    return np.concatenate([_ring(at, axis, radius, n_sides) for at in (start, end)])


def _ring(
    centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], radius: float, n_sides: int = _SIDES
) -> Float[np.ndarray, "V 3"]:
    """Return the corners of the regular polygon around a circle."""
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    angle = 2.0 * np.pi * (np.arange(n_sides) + 0.5) / n_sides
    spread = radius / np.cos(np.pi / n_sides) * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(centre + spread @ np.stack([first, np.cross(axis, first)]))
