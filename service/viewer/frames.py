"""Which samples a viewer keeps, and how they are packed into few bytes."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped


def kept_samples(times: Float[np.ndarray, "S"], always: Iterable[int], rate_hz: float = 30.0) -> Int[np.ndarray, "F"]:
    """Samples to animate: at most ``rate_hz`` of them per second, and ``always`` (waypoints, phase borders) [-]."""
    if len(times) == 0:
        return np.empty(0, dtype=int)
    slots = np.floor((times - times[0]) * rate_hz + 1e-9)
    regular = np.flatnonzero(np.diff(slots, prepend=-1.0) > 0.0)
    forced = [index for index in always if 0 <= index < len(times)]
    return np.unique(np.concatenate([regular, np.asarray([0, len(times) - 1, *forced], dtype=int)]))


def pack(values: Shaped[np.ndarray, "..."], dtype: str) -> dict[str, Any]:
    """A typed array as the page reads it: numpy type code, shape, little-endian bytes in base64."""
    array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
    return {"dtype": dtype, "shape": list(array.shape), "data": base64.b64encode(array.tobytes()).decode("ascii")}


def quantize(values: Float[np.ndarray, "... 3"]) -> dict[str, Any]:
    """Points on a 16-bit grid over their bounding box (5 m: steps of 0.08 mm), with the box [m]."""
    if values.size == 0:
        return {**pack(values, "u2"), "lower": [0.0, 0.0, 0.0], "upper": [1.0, 1.0, 1.0]}
    flat = values.reshape(-1, values.shape[-1])
    lower, upper = flat.min(axis=0), flat.max(axis=0)
    span = np.where(upper > lower, upper - lower, 1.0)
    grid = np.round((values - lower) / span * 65535.0)
    return {**pack(grid, "u2"), "lower": lower.tolist(), "upper": (lower + span).tolist()}
