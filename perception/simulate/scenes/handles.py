"""Handles of simulated doors, on a face with its outward direction along y."""

from __future__ import annotations

from collections.abc import Mapping

from perception.solids.primitives import Mesh, bent_bar, box, cylinder, lathe

STANDOFFS: Mapping[str, float] = {"lever": 0.052, "knob": 0.048, "bar": 0.055, "pull": 0.06}
"""Usual distance of a handle's centre line, or a knob's middle, from the face [m]."""
BAR_INSET = 0.09  # from the leaf's edge to the middle of a push bar's housing
BAR_HALF_DEPTH, BAR_HALF_HEIGHT = 0.012, 0.02
KNOB_RADIUS, KNOB_DEPTH = 0.027, 0.04
_POST_INSET = 0.04
Place = tuple[float, float, float]


def lever(place: Place, out: float, standoff: float, length: float, radius: float) -> tuple[Mesh, Mesh]:
    """Return the rose, and the level bar with its neck, which reaches ``length`` from the spindle towards -x [m].

    Args:
        place: intersection of the spindle with the face [m].
        out: outward direction along y, -1 or 1.
    """
    x, face, z = place
    depth = face + out * standoff
    rose = lathe([(0.0, 0.01), (0.026, 0.009), (0.027, 0.0)], place, (0.0, out, 0.0))
    return rose, bent_bar([(x, face, z), (x, depth, z), (x - length + radius, depth, z)], radius)


def knob(place: Place, out: float) -> Mesh:
    """Return a knob with its rose."""
    profile = [
        (0.0, 0.068),
        (0.016, 0.066),
        (0.026, 0.056),
        (0.027, 0.046),
        (0.02, 0.036),
        (0.011, 0.028),
        (0.011, 0.008),
        (0.029, 0.006),
        (0.029, 0.0),
    ]
    return lathe(profile, place, (0.0, out, 0.0))


def pull(place: Place, out: float, standoff: float, length: float, radius: float) -> list[Mesh]:
    """Return an upright bar on two posts, its middle before ``place``."""
    x, face, z = place
    depth, half = face + out * standoff, 0.5 * length
    posts = [
        cylinder((x, face, z + aside), (x, depth, z + aside), radius)
        for aside in (-half + _POST_INSET, half - _POST_INSET)
    ]
    return [cylinder((x, depth, z - half), (x, depth, z + half), radius), *posts]


def push_bar(width: float, face: float, z: float, standoff: float) -> list[Mesh]:
    """Return a flat bar across a leaf of that width, and the housings at its ends; outward is +y."""
    y = face + standoff
    ends = [
        box((end - 0.04, face, z - 0.03), (end + 0.04, y + 0.015, z + 0.03)) for end in (BAR_INSET, width - BAR_INSET)
    ]
    low = (BAR_INSET, y - BAR_HALF_DEPTH, z - BAR_HALF_HEIGHT)
    return [*ends, box(low, (width - BAR_INSET, y + BAR_HALF_DEPTH, z + BAR_HALF_HEIGHT))]


def push_plate(place: Place, out: float) -> Mesh:
    """Return a thin plate to push against."""
    x, face, z = place
    outer = face + out * 0.002
    return box((x - 0.05, min(face, outer), z - 0.15), (x + 0.05, max(face, outer), z + 0.15))
