"""Detected valves and doors of a result, from which the demands of its request are rebuilt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import islice
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.detect.door.geometry import DoorGeometry, HandleGeometry
from service.demands.door.demand import SeenDoor
from service.errors import shown
from service.request.fields import find_repeated
from service.scan.json_data import to_json_data

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection

ROUNDING = 1e-6  # of a number, and of one
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


def compare_hits(recorded: object, shown_now: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a sentence on the first value of ``detections`` that is not what the scan shows, if there is one."""
    yield from islice(_compare("detections", recorded, to_json_data(shown_now)), 1)


def _compare(path: str, recorded: object, now: object) -> Iterator[str]:
    """Yield the values that differ by more than rounding, as sentences."""
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        if set(recorded) != set(now):
            yield f"{path} has {shown(sorted(set(recorded) ^ set(now))[0])} in one of the folder and the scan only"
        for key in now:
            if key in recorded:
                yield from _compare(f"{path}.{key}", recorded[key], now[key])
    elif isinstance(recorded, list) and isinstance(now, list):
        if len(recorded) != len(now):
            yield f"{path} has {len(recorded)} entries; the scan shows {len(now)}"
        for number, (own, other) in enumerate(zip(recorded, now, strict=False)):
            yield from _compare(f"{path}.{number}", own, other)
    elif _is_number(recorded) and _is_number(now):
        if abs(float(recorded) - float(now)) > ROUNDING * max(1.0, abs(float(now))):  # type: ignore[arg-type]
            yield f"{path} is {shown(recorded)}; the scan shows {shown(now)}"
    elif recorded != now:
        yield f"{path} is {shown(recorded)}; the scan shows {shown(now)}"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_seen_parts(data: dict[str, Any]) -> tuple[SeenPart, ...]:
    """Read the parts of the task's valve or door that the scan shows; none where an earlier release wrote none."""
    parts = data["detections"][0].get("parts", ()) if data["detections"] else ()
    if not parts:
        return ()
    from perception import SeenPart  # slow to import

    seen = tuple(SeenPart.from_json(part) for part in parts)
    twice = find_repeated([part.name for part in seen])
    if twice:
        raise ValueError(f"detections: part {shown(twice[0])} is there twice")
    return seen
