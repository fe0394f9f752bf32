"""JSON-ready data shared by result and scene files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from costs.scene import ConvexPiece


def piece_json(piece: ConvexPiece) -> dict[str, Any]:
    """A piece of the world."""
    return {"name": piece.name, "kind": piece.kind, "vertices": piece.vertices.tolist()}


def plain(value: Any) -> Any:
    """``value`` as JSON data: arrays as lists, numbers that JSON lacks as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{type(value).__name__} has no place in a result")
