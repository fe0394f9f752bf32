"""Scenes for the simulator: the robot at the origin, objects to detect, and surroundings."""

from __future__ import annotations

from collections.abc import Mapping

from perception.errors import PerceptionError
from perception.simulate.scenes import cars, clutter, debris, doors, fixtures, shelves, valves
from perception.simulate.scenes.scene import VARIANTS, Recipe, SimulatedScene, Truth

SCENES: Mapping[str, Recipe] = {
    **valves.SCENES,
    **doors.SCENES,
    **fixtures.SCENES,
    **shelves.SCENES,
    **debris.SCENES,
    **cars.SCENES,
    **clutter.SCENES,
}

__all__ = ["SCENES", "VARIANTS", "SimulatedScene", "Truth", "make_scene"]


def make_scene(name: str, seed: int = 0) -> SimulatedScene:
    """Return a scene by name.

    Args:
        seed: seed of its random details: positions, tilts, surroundings.

    Raises:
        PerceptionError: the name is unknown.
    """
    if name not in SCENES:
        raise PerceptionError(f"unknown scene '{name}'; expected one of {', '.join(SCENES)}")
    return SCENES[name].make(name, seed)
