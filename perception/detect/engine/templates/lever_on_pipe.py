"""Lever of a valve with the pipe that it is on; origin the pivot, x along the lever, z the spindle, from the pipe."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Box, Capsule, Cylinder
from perception.detect.engine.template import Looseness, Part, Size, Starts, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_VALVES = "makers' lists of ball and butterfly valves, DN 15 to DN 200: levers 80 to 400 mm long, 12 to 65 mm wide"
_PIPES = "EN 10220: pipes of DN 15 to DN 200, 21 to 219 mm across"
_GRIPS = "the same lists: flat bars of 4 mm to grips with a latch under them, 60 mm along the spindle"
_HALF_PIPE, _NECK, _ROUNDING = 0.25, 0.02, 0.002  # [m]


def _build(s: Sizes) -> tuple[Part, ...]:
    nothing = 0.0 * s["lever_length"]
    half = 0.5 * s["lever_length"]
    along = columns(_HALF_PIPE * np.cos(s["pipe_rad"]), _HALF_PIPE * np.sin(s["pipe_rad"]), 0.0)
    thick = s["lever_thickness"]
    under = columns(nothing, 0.0, -s["stand_off"])
    return (
        Part("lever", Box(columns(half, 0.0, 0.0), columns(half, s["lever_radius"], thick), _ROUNDING)),
        Part("neck", Capsule(under, columns(nothing, 0.0, -thick), nothing + _NECK), False),
        Part("pipe", Cylinder(under - along, under + along, s["pipe_radius"])),
    )


LEVER_ON_PIPE = Template(
    kind="valve",
    sizes=(
        Size("lever_length", 0.08, 0.45, 0.22, 0.08, _VALVES),
        Size("lever_radius", 0.006, 0.035, 0.016, 0.008, _VALVES),
        Size("lever_thickness", 0.003, 0.035, 0.01, 0.01, _GRIPS),
        Size("stand_off", 0.03, 0.3, 0.1, 0.05, _VALVES),
        Size("pipe_radius", 0.01, 0.11, 0.05, 0.03, _PIPES),
        Size("pipe_rad", -1.75, 1.75, 0.0, 1.5, "across or along the lever [rad]"),
    ),
    build=_build,
    hollows=lambda s: (),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.12,
    extent="lever_length",
    middle=lambda s: columns(0.5 * s["lever_length"], 0.0, -0.3 * s["stand_off"]),
    model_sigma=0.004,
    starts=Starts(
        sizes=np.array(
            [
                [0.22, 0.016, 0.01, off, r, turn]
                for off, r in ((0.07, 0.03), (0.14, 0.06), (0.22, 0.09))
                for turn in (0.0, 1.57)
            ]
        ),
        n_turns=24,
        spread=0,
        n_spins=8,
        near=0.08,
        is_slender=True,
    ),
    show=lambda s: {name: s[name] for name in ("lever_length", "lever_radius")},
)
