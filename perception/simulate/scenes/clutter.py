"""Scenes in which there is nothing to find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.mesh import box, torus
from perception.simulate.objects.loose import bucket, can, cart, pot, shelf
from perception.simulate.objects.placed import Placed, things
from perception.simulate.scenes.scene import Recipe, SimulatedScene, assembled, generator
from perception.simulate.scenes.surroundings import floor, wall


@dataclass(frozen=True)
class Kitchen:
    """A rack of pots, buckets and tins, a cart beside it, a picture and a round frame on the wall."""

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x = 0.75
        parts: list[Placed] = [floor(), wall(x + 0.5), shelf((x, -0.6, 0.0), 1.2, 0.42, (0.1, 0.45, 0.9, 1.35), 1.8)]
        for level in (0.1, 0.45, 0.9, 1.35):
            for y in (-0.42, -0.1, 0.22, 0.46):
                kind = (pot, bucket, can)[rng.integers(3)]
                parts.append(kind((x + 0.2 + rng.uniform(-0.03, 0.03), y, level), radius=rng.uniform(0.06, 0.12)))
        parts.append(cart((0.9, 1.5, 0.0), rng.uniform(0.0, np.pi)))
        parts.append(things(box((x + 0.47, -1.6, 1.2), (x + 0.5, -0.9, 1.7))))
        parts.append(things(torus((x + 0.49, -2.0, 1.6), (1.0, 0.0, 0.0), 0.14, 0.012)))
        return assembled(name, seed, parts, (x, 0.0, 0.9))


SCENES: Mapping[str, Recipe] = {
    "empty_kitchen": Kitchen(),
}
