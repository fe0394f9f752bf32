"""Lever of a valve: a bar over a pipe, turned about a spindle at one end; origin the pivot, x along, z the spindle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Capsule
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_BALL_VALVES = "makers' lists of ball and butterfly valves, DN 15 to DN 200: levers 80 to 400 mm long, 15 to 60 mm wide"

LEVER_VALVE = Template(
    kind="valve",
    sizes=(
        Size("lever_length", 0.08, 0.45, 0.2, 0.08, _BALL_VALVES),
        Size("lever_radius", 0.006, 0.03, 0.012, 0.005, _BALL_VALVES),
    ),
    build=lambda s: (
        Part(
            "lever",
            Capsule(
                columns(0.0 * s["lever_radius"], 0.0, 0.0),
                columns(s["lever_length"] - s["lever_radius"], 0.0, 0.0),
                s["lever_radius"],
            ),
        ),
    ),
    hollows=lambda s: (),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.06,
    extent="lever_length",
    middle=lambda s: columns(0.5 * s["lever_length"], 0.0, 0.0),
    model_sigma=0.004,
)
