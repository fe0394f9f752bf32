"""Beam: a sawn timber; origin its centre, x along its length, z along its smallest side."""

from __future__ import annotations

from perception.detect.engine.primitives import Box
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

_TIMBER = "dressed timber, EN 1313-1 and PS 20: 19 to 140 mm thick, 38 to 290 mm wide"

BEAM = Template(
    kind="beam",
    sizes=(
        Size("length", 0.2, 3.0, 1.2, 0.6, _TIMBER),
        Size("width", 0.03, 0.3, 0.09, 0.03, _TIMBER),
        Size("thickness", 0.015, 0.15, 0.04, 0.015, _TIMBER),
    ),
    build=lambda s: (
        Part(
            "timber",
            Box(
                columns(0.0 * s["width"], 0.0, 0.0), columns(0.5 * s["length"], 0.5 * s["width"], 0.5 * s["thickness"])
            ),
        ),
    ),
    hollows=lambda s: (),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=1.6,
    middle=lambda s: columns(0.0 * s["width"], 0.0, 0.0),
    model_sigma=0.003,
)
