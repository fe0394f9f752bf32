"""Cordless drill, standing on its battery or lying on its side; origin under the grip on the battery's sole."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Box, Capsule
from perception.detect.engine.template import Looseness, Part, Size, Starts, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_CATALOGUE = "catalogue pictures of 12 and 18 V drills: 170 to 260 mm high, 150 to 240 mm long, body 50 to 68 mm wide"
SOLE = 0.05  # height of the battery [m]
LYING = 0.035  # height of the body's axis over a support that it lies on [m]


def _build(s: Sizes) -> tuple[Part, ...]:
    top = SOLE + s["grip"] + s["body_radius"]
    r, front = s["body_radius"], s["body"] - s["back"]
    grip = 0.019
    return (
        Part("motor", Capsule(columns(-s["back"] + r, 0.0, top), columns(front - 0.075, 0.0, top), r)),
        Part("chuck", Capsule(columns(front - 0.075, 0.0, top), columns(front - 0.015, 0.0, top), 0.68 * r)),
        Part(
            "grip",
            Capsule(columns(s["lean"], 0.0, SOLE - 0.01), columns(0.0, 0.0, top), np.full(len(r), grip)),
        ),
        Part(
            "battery",
            Box(
                columns(s["foot"], 0.0, 0.5 * SOLE),
                columns(0.06, s["foot_half"], 0.5 * SOLE + np.zeros(len(r))),
                0.012,
            ),
        ),
    )


def _hollows(s: Sizes) -> tuple[Box, ...]:
    middle = SOLE + 0.5 * s["grip"]
    half = np.maximum(0.5 * s["grip"] - 0.015, 0.01)
    return (
        Box(columns(0.06, 0.0, middle), columns(0.025, 0.02, half)),
        Box(columns(-0.055, 0.0, middle), columns(0.02, 0.02, half)),
    )


def lie(side: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a drill that lies on its left (1) or right (-1) side, its chuck along x."""
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -side], [0.0, side, 0.0]])


def _start_sizes() -> Float[np.ndarray, "2 7"]:
    """Return a short and a long grip: rough scores need the height of the body within about 2 cm."""
    return np.array([[grip, 0.185, 0.055, 0.029, 0.0, 0.003, 0.038] for grip in (0.09, 0.125)])


DRILL = Template(
    kind="drill",
    sizes=(
        Size("grip", 0.06, 0.16, 0.095, 0.03, _CATALOGUE),
        Size("body", 0.14, 0.27, 0.185, 0.022, _CATALOGUE),
        Size("back", 0.03, 0.09, 0.055, 0.015, _CATALOGUE),
        Size("body_radius", 0.023, 0.035, 0.029, 0.003, _CATALOGUE),
        Size("lean", -0.025, 0.025, 0.0, 0.012, _CATALOGUE),
        Size("foot", -0.02, 0.03, 0.003, 0.012, _CATALOGUE),
        Size("foot_half", 0.028, 0.048, 0.038, 0.005, _CATALOGUE),
    ),
    build=_build,
    hollows=_hollows,
    mount="support",
    looseness=Looseness(tilt=0.06, height=0.008),
    reach=0.17,
    middle=lambda s: columns(0.02, 0.0, 0.5 * (SOLE + s["grip"] + 2.0 * s["body_radius"])),
    model_sigma=0.005,
    starts=Starts(
        sizes=_start_sizes(),
        over=(0.02, 0.3),
        postures=np.stack([np.eye(3), lie(1.0), lie(-1.0)]),
        lifts=np.array([0.0, LYING, LYING]),
        n_turns=16,
    ),
    origin=lambda s: columns(0.0 * s["grip"], 0.0, SOLE + 0.5 * s["grip"]),
    show=lambda s: {"grip_length": s["grip"], "body_length": s["body"]},
)
