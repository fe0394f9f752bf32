"""JSON-ready data shared by result and scene files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from costs.scene import ConvexPiece


def encode_piece(piece: ConvexPiece) -> dict[str, Any]:
    """Return a piece of a scene as JSON data."""
    return {"name": piece.name, "kind": piece.kind, "vertices": piece.vertices.tolist()}


def to_json_data(value: Any) -> Any:
    """Convert arrays to lists, and numbers that JSON lacks to null."""
    if isinstance(value, Mapping):
        return {str(key): to_json_data(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_data(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return to_json_data(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{type(value).__name__} has no place in a result")
