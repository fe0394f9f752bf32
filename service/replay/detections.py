"""Detected valves and doors of a result, from which the demands of its request are rebuilt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.detect.door.geometry import DoorGeometry, HandleGeometry
from service.demands.door.demand import SeenDoor
from service.errors import shown

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection

VECTORS = ("centre", "axis", "direction")  # of detected valves


def read_valves(data: dict[str, Any]) -> tuple[ValveDetection | LeverDetection, ...]:
    """Read the valves of ``detections``; those with a ``direction`` are levers."""
    hits = [hit for hit in data["detections"] if hit["kind"] == "valve"]
    if not hits:
        return ()
    from perception import LeverDetection, ValveDetection  # slow to import

    valves: list[ValveDetection | LeverDetection] = []
    for hit in hits:
        kind = LeverDetection if "direction" in hit else ValveDetection
        values = {field.name: hit[field.name] for field in fields(kind)}
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        _check_numbers(kind, values)
        vectors = {name: _read_vector(values[name]) for name in VECTORS if name in values}
        valves.append(kind(**{**values, **vectors}))
    return tuple(valves)


def read_doors(data: dict[str, Any]) -> tuple[SeenDoor, ...]:
    """Read the doors of ``detections``."""
    doors = []
    for hit in data["detections"]:
        if hit["kind"] == "door":
            geometry, handle = dict(hit["geometry"]), hit["geometry"]["handle"]
            if handle is not None:
                vectors = {name: _read_vector(handle[name]) for name in ("centre", "direction")}
                _check_numbers(HandleGeometry, handle)
                handle = HandleGeometry(**{**handle, **vectors})
            vectors = {name: _read_vector(geometry[name]) for name in ("hinge", "along", "normal")}
            _check_numbers(DoorGeometry, geometry)
            door = DoorGeometry(**{**geometry, **vectors, "handle": handle})
            doors.append(SeenDoor(door, float(hit["confidence"]), bool(hit.get("knows_hinge", True))))
    return tuple(doors)


def _read_vector(value: object) -> np.ndarray:
    """Return three numbers of ``detections`` (ValueError for anything else)."""
    vector = np.array(value, dtype=float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"detections: expected three numbers, got {shown(value)}")
    return vector


def _check_numbers(kind: type[Any], values: Mapping[str, object]) -> None:
    """Refuse values of fields that hold a number and are none (ValueError)."""
    for field in fields(kind):
        value = values.get(field.name)
        if field.type == "float" and (
            isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value)
        ):
            raise ValueError(f"detections: expected a number for {field.name}, got {shown(value)}")


def read_seen_parts(data: dict[str, Any]) -> tuple[SeenPart, ...]:
    """Read the parts of the task's valve or door that the scan shows; none where an earlier release wrote none."""
    parts = data["detections"][0].get("parts", ()) if data["detections"] else ()
    if not parts:
        return ()
    from perception import SeenPart  # slow to import

    return tuple(SeenPart.from_json(part) for part in parts)
