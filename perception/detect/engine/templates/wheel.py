"""Wheel of a valve: a rim and its hub; origin the rim's centre, z its axis."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Torus
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_HANDWHEELS = "EN 12570 and makers' lists of handwheels: 80 to 600 mm across, rims 10 to 40 mm thick"

WHEEL = Template(
    kind="valve",
    sizes=(
        Size("rim_radius", 0.035, 0.32, 0.13, 0.05, _HANDWHEELS),
        Size("tube_radius", 0.004, 0.025, 0.011, 0.004, _HANDWHEELS),
    ),
    build=lambda s: (Part("rim", Torus(0.0 * s["rim_radius"], s["rim_radius"], s["tube_radius"])),),
    hollows=lambda s: (),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.35,
    middle=lambda s: columns(0.0 * s["rim_radius"], 0.0, 0.0),
    model_sigma=0.003,
)
