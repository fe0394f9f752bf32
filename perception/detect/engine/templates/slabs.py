"""Flat objects: leaf of a door, front of a button panel, cushion of a seat, and the frame of a vehicle's opening."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Box
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_FREE = Looseness(tilt=1.0, height=1.0)


def _leaf(s: Sizes) -> tuple[Part, ...]:
    middle = columns(0.5 * s["width"], -0.02 * s["side"], 0.5 * s["height"])
    return (Part("leaf", Box(middle, columns(0.5 * s["width"], 0.02, 0.5 * s["height"]))),)


DOOR = Template(
    kind="door",
    sizes=(
        Size("width", 0.5, 1.3, 0.86, 0.12, "DIN 18101 and ANSI A250.8 leaves: 610 to 1236 mm wide"),
        Size("height", 1.7, 2.4, 2.03, 0.1, "DIN 18101 and ANSI A250.8 leaves: 1972 to 2134 mm high"),
        Size("side", -1.0, 1.0, 0.0, 1.0, "+1 where y points to the sensor"),
    ),
    build=_leaf,
    hollows=lambda s: (),
    mount="none",
    looseness=_FREE,
    reach=1.3,
    middle=lambda s: columns(0.5 * s["width"], 0.0, 0.5 * s["height"]),
    model_sigma=0.004,
)
PANEL = Template(
    kind="panel",
    sizes=(
        Size("width", 0.05, 0.6, 0.2, 0.1, "EN 62208 enclosures"),
        Size("height", 0.05, 0.8, 0.3, 0.15, "EN 62208 enclosures"),
    ),
    build=lambda s: (
        Part("front", Box(columns(0.0 * s["width"], 0.0, -0.02), columns(0.5 * s["width"], 0.5 * s["height"], 0.02))),
    ),
    hollows=lambda s: (),
    mount="none",
    looseness=_FREE,
    reach=0.5,
    middle=lambda s: columns(0.0 * s["width"], 0.0, 0.0),
    model_sigma=0.004,
)
SEAT = Template(
    kind="seat",
    sizes=(
        Size("width", 0.3, 1.4, 0.5, 0.1, "SAE J4004 and makers' lists of car seats"),
        Size("depth", 0.3, 0.7, 0.5, 0.06, "SAE J4004 and makers' lists of car seats"),
    ),
    build=lambda s: (
        Part(
            "cushion",
            Box(columns(0.0 * s["width"], 0.0, -0.04), columns(0.5 * s["depth"], 0.5 * s["width"], 0.04), 0.03),
        ),
    ),
    hollows=lambda s: (Box(columns(0.0 * s["width"], 0.0, 0.2), columns(0.3 * s["depth"], 0.4 * s["width"], 0.12)),),
    mount="none",
    looseness=_FREE,
    reach=0.5,
    middle=lambda s: columns(0.0 * s["width"], 0.0, 0.0),
    model_sigma=0.01,
)


def _frame(s: Sizes) -> tuple[Part, ...]:
    middle, half = 0.5 * s["height"], 0.5 * s["width"]
    posts = tuple(
        Part(name, Box(columns(0.0 * middle, sign * (half + 0.04), middle), columns(0.06, 0.04, middle)), False)
        for name, sign in (("rear post", -1.0), ("front post", 1.0))
    )
    return (*posts, Part("sill", Box(columns(0.0 * half, 0.0, -0.05), columns(0.06, half, 0.05)), False))


OPENING = Template(
    kind="opening",
    sizes=(
        Size("width", 0.4, 1.8, 0.8, 0.2, "FMVSS 206 doorways of cars"),
        Size("height", 0.5, 1.8, 1.0, 0.2, "FMVSS 206 doorways of cars"),
    ),
    build=_frame,
    hollows=lambda s: (
        Box(columns(0.0 * s["width"], 0.0, 0.55 * s["height"]), columns(0.1, 0.35 * s["width"], 0.3 * s["height"])),
    ),
    mount="none",
    looseness=_FREE,
    reach=1.0,
    middle=lambda s: columns(0.0 * s["width"], 0.0, 0.5 * s["height"]),
    model_sigma=0.01,
)
