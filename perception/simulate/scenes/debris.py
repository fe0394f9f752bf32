"""Beams on the ground: strewn and in heaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from perception.simulate.objects.placed import Placed
from perception.simulate.scenes.heap import heap
from perception.simulate.scenes.scene import Recipe, SimulatedScene, assembled, generator
from perception.simulate.scenes.surroundings import cartons, floor, wall


@dataclass(frozen=True)
class Debris:
    """A heap before the robot.

    Attributes:
        n_beams: in it.
        middle: x, y [m].
        spread: of the beams' middles before they fall, each way [m].
        n_boxes: beside it.
    """

    n_beams: int
    middle: tuple[float, float] = (1.0, 0.0)
    spread: float = 0.3
    n_boxes: int = 0

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        parts: list[Placed] = [floor(), wall(2.1), *heap(rng, self.n_beams, self.middle, self.spread)]
        parts += cartons(rng, self.n_boxes, (1.2, 1.3), 0.3)
        return assembled(name, seed, parts, (*self.middle, 0.2))


SCENES: Mapping[str, Recipe] = {
    "debris_one": Debris(1, (0.9, 0.1), 0.1),
    "debris_strewn": Debris(4, (1.0, 0.0), 0.5),
    "debris_heap": Debris(8),
    "debris_large_heap": Debris(14, (1.2, 0.0), 0.35, 2),
}
