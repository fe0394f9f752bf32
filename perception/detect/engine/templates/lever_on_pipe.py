"""Lever of a valve with the pipe that it is on; origin the pivot, x along the lever, z the spindle, from the pipe."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Box, Cylinder
from perception.detect.engine.template import Looseness, Part, Size, Starts, Template, columns

Sizes = dict[str, Float[np.ndarray, "B"]]
_VALVES = "makers' lists of ball and butterfly valves, DN 15 to DN 200: levers 80 to 400 mm long, 12 to 65 mm wide"
_PIPES = "EN 10220: pipes of DN 15 to DN 200, 21 to 219 mm across"
_GRIPS = "the same lists: flat bars of 4 mm to grips with a latch under them, 60 mm along the spindle"
_NECKS = "ISO 5211: flanges F03 to F12 under levers, 36 to 125 mm across; spindles from 16 mm"
_TAILS = "the same lists: spindles 10 to 70 mm before a lever's end"
_HALF_PIPE, _ROUNDING = 0.25, 0.002  # [m]
_GAP, _EMPTY = 0.012, 0.025  # from a lever to what must be empty, and half its length beyond the end [m]


def _build(s: Sizes) -> tuple[Part, ...]:
    spindle, across = _spindle(s), columns(0.0 * s["bend_rad"], 1.0, 0.0)
    ahead = columns(np.cos(s["bend_rad"]), 0.0, -np.sin(s["bend_rad"]))
    along = _HALF_PIPE * (np.cos(s["pipe_rad"])[:, None] * ahead + np.sin(s["pipe_rad"])[:, None] * across)
    under = -s["stand_off"][:, None] * spindle
    neck = Cylinder(under, -s["lever_thickness"][:, None] * spindle, s["neck_radius"])
    return (
        Part("lever", _lever(s)),
        Part("neck", neck, False),
        Part("pipe", Cylinder(under - along, under + along, s["pipe_radius"])),
    )


def _lever(s: Sizes) -> Box:
    half = 0.5 * (s["lever_length"] + s["tail"])
    return Box(columns(half - s["tail"], 0.0, 0.0), columns(half, s["lever_radius"], s["lever_thickness"]), _ROUNDING)


def _beyond(s: Sizes) -> Box:
    """Return what is empty beyond a lever's free end."""
    side = 0.7 * np.minimum(s["lever_radius"], s["lever_thickness"])
    return Box(columns(s["lever_length"] + _GAP + _EMPTY, 0.0, 0.0), columns(_EMPTY + 0.0 * side, side, side))


def _under(s: Sizes) -> Box:
    """Return what is empty between a lever's outer half and its pipe."""
    top, bottom = -s["lever_thickness"] - _GAP, s["pipe_radius"] - s["stand_off"] + _GAP
    half = np.maximum(0.5 * (top - bottom), 0.0)
    reach = 0.25 * s["lever_length"]
    return Box(columns(3.0 * reach, 0.0, 0.5 * (top + bottom)), columns(reach, 0.7 * s["lever_radius"], half))


def _spindle(s: Sizes) -> Float[np.ndarray, "B 3"]:
    """Return the direction of the spindle, from the pipe."""
    return columns(np.sin(s["bend_rad"]), 0.0, np.cos(s["bend_rad"]))


def _axes(s: Sizes) -> Float[np.ndarray, "B 3 3"]:
    """Return the frame that users see: its z is the spindle, while the template's x follows a bent lever."""
    z, y = _spindle(s), columns(0.0 * s["bend_rad"], 1.0, 0.0)
    return np.stack([np.cross(y, z), y, z], axis=2)


_LEVER_SIZES = (
    Size("lever_length", 0.08, 0.45, 0.22, 0.08, _VALVES),
    Size("lever_radius", 0.006, 0.035, 0.016, 0.008, _VALVES),
    Size("lever_thickness", 0.003, 0.035, 0.01, 0.01, _GRIPS),
    Size("tail", 0.0, 0.07, 0.02, 0.02, _TAILS),
)

LEVER_ALONE = Template(
    kind="valve",
    sizes=_LEVER_SIZES[:3],
    build=lambda s: (Part("lever", _lever({**s, "tail": 0.0 * s["lever_length"]})),),
    hollows=lambda s: (_beyond(s),),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.08,
    extent="lever_length",
    middle=lambda s: columns(0.5 * s["lever_length"], 0.0, 0.0),
    model_sigma=0.004,
    starts=Starts(
        sizes=np.array([[0.2, 0.016, 0.01], [0.28, 0.025, 0.02]]),
        n_turns=8,
        n_spins=2,
        near=0.08,
        is_slender=True,
    ),
)
"""The lever alone: its fit is where fits with a pipe begin."""


LEVER_ON_PIPE = Template(
    kind="valve",
    sizes=(
        *_LEVER_SIZES,
        Size("bend_rad", -0.2, 0.2, 0.0, 0.05, "cranked levers lead up to 10 deg away from their pipe [rad]"),
        Size("stand_off", 0.03, 0.3, 0.1, 0.05, _VALVES),
        Size("pipe_radius", 0.01, 0.11, 0.05, 0.03, _PIPES),
        Size("pipe_rad", -1.75, 1.75, 0.0, 1.5, "across or along the lever [rad]"),
        Size("neck_radius", 0.008, 0.0625, 0.02, 0.012, _NECKS),
    ),
    build=_build,
    hollows=lambda s: (_beyond(s), _under(s)),
    mount="none",
    looseness=Looseness(tilt=1.0, height=1.0),
    reach=0.12,
    extent="lever_length",
    middle=lambda s: columns(0.5 * s["lever_length"], 0.0, -0.3 * s["stand_off"]),
    model_sigma=0.004,
    starts=Starts(
        sizes=np.array(
            [
                [0.22, 0.016, 0.01, 0.02, 0.0, off, r, turn, 0.02]
                for off, r in ((0.07, 0.03), (0.11, 0.04), (0.16, 0.06), (0.22, 0.09))
                for turn in (0.0, 1.57)
            ]
        ),
        n_spins=8,
        part=LEVER_ALONE,
    ),
    axes=_axes,
    show=lambda s: {name: s[name] for name in ("lever_length", "lever_radius")},
)
