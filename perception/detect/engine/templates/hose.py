"""Open end of a hose or standpipe: a tube of two radii's length behind its opening; origin there, z out of it."""

from __future__ import annotations

from perception.detect.engine.primitives import Box, Cylinder
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

_HOSES = "hose couplings of 25 to 110 mm (Storz D to A, NST 1.5 to 4 inch)"

HOSE = Template(
    kind="hose",
    sizes=(Size("radius", 0.012, 0.08, 0.035, 0.012, _HOSES),),
    build=lambda s: (
        Part(
            "tube", Cylinder(columns(0.0 * s["radius"], 0.0, -0.12), columns(0.0 * s["radius"], 0.0, 0.0), s["radius"])
        ),
    ),
    hollows=lambda s: (Box(columns(0.0 * s["radius"], 0.0, 0.03), columns(s["radius"], s["radius"], 0.02)),),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.16,
    middle=lambda s: columns(0.0 * s["radius"], 0.0, -0.06),
    model_sigma=0.004,
)
