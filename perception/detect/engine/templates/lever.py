"""Lever on a face: a bar with a neck at one end; origin the pivot, x along the bar, z out of the face."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Capsule
from perception.detect.engine.template import Looseness, Part, Size, Starts, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_DOORS = "DIN 18255 door levers: 100 to 145 mm long, 16 to 25 mm thick, 45 to 75 mm from the leaf"


def _build(s: Sizes) -> tuple[Part, ...]:
    bar = s["length"] - s["radius"]
    return (
        Part("bar", Capsule(columns(0.0 * bar, 0.0, 0.0), columns(bar, 0.0, 0.0), s["radius"])),
        Part(
            "neck", Capsule(columns(0.0 * bar, 0.0, -s["stand_off"]), columns(0.0 * bar, 0.0, 0.0), s["radius"]), False
        ),
    )


LEVER = Template(
    kind="lever",
    sizes=(
        Size("length", 0.07, 0.4, 0.13, 0.03, _DOORS),
        Size("radius", 0.006, 0.02, 0.01, 0.002, _DOORS),
        Size("stand_off", 0.03, 0.11, 0.055, 0.012, _DOORS),
    ),
    build=_build,
    hollows=lambda s: (),
    mount="face",
    looseness=Looseness(tilt=0.04, height=0.02, level=0.04),
    reach=0.05,
    extent="length",
    middle=lambda s: columns(0.5 * s["length"], 0.0, -0.3 * s["stand_off"]),
    model_sigma=0.003,
    starts=Starts(
        sizes=np.array([[0.13, 0.01, 0.055], [0.2, 0.012, 0.06]]),
        over=(0.02, 0.13),
        n_turns=24,
        near=0.07,
        is_slender=True,
    ),
    show=lambda s: {name: s[name] for name in ("length", "radius")},
)
