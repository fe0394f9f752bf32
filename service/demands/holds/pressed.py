"""Parts that a hand presses, with what the scan shows of them near the hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from service.demands.phase import TaskPhase
from service.verify import PressedPart

if TYPE_CHECKING:
    from perception import SeenPart

NEAR_M = 0.05
"""Distance from a hold within which a bar's points and rays are counted [m]."""
UNCOUNTED = "nothing counted the rays at it: read the scan again (scene.cloud, or `scopt scene` for a scene file)"


def find_pressed(
    seen: Sequence[SeenPart] | None, name: str, place: tuple[float, float], near: float = NEAR_M
) -> PressedPart:
    """Return a pressed part with the points and rays of the scan near the hold.

    Args:
        seen: parts of the object that the scan shows; None where the request gives the object.
        name: of the part.
        place: of the hold, in the coordinates of the part [m].
        near: distance from it within which points and rays are counted [m].
    """
    if seen is None:
        return PressedPart(name, "given")
    part = next((part for part in seen if part.name == name), None)
    if part is None:
        return PressedPart(name, "scan", near_m=near, remedy=UNCOUNTED)
    n_points, n_through = part.count_near(place, near)
    return PressedPart(name, "scan", n_points, n_through, near, part.within_m)


def add_pressed(specs: Sequence[TaskPhase], *parts: PressedPart) -> tuple[TaskPhase, ...]:
    """Return phases with the parts that are pressed while a hand moves the mechanism."""
    return tuple(replace(spec, pressed=parts) if spec.moving and spec.hand is not None else spec for spec in specs)
