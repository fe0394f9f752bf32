"""Detections of a result: what is no number is refused before anything is computed with it."""

from __future__ import annotations

from typing import Any

import pytest

from service.replay.detections import read_doors

HANDLE = {"kind": "lever", "centre": [0.8, 0.3, 1.0], "direction": [0.0, 1.0, 0.0], "length": 0.12, "radius": 0.01}
FRAME = {"hinge": [0.8, -0.4, 0.0], "along": [0.0, 1.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
SIZES = {"face": 0.0, "width": 0.9, "height": 2.0, "thickness": 0.04, "ajar": 0.0, "handle_turn": 0.0}
GEOMETRY = {**FRAME, **SIZES, "opens": "push", "handle": HANDLE}


def _hit(**geometry: Any) -> dict[str, Any]:
    return {"detections": [{"kind": "door", "confidence": 0.9, "geometry": {**GEOMETRY, **geometry}}]}


def test_a_door_is_read_as_it_was_seen() -> None:
    (door,) = read_doors(_hit())
    assert (door.geometry.width, door.confidence, door.knows_hinge) == (0.9, 0.9, True)


@pytest.mark.parametrize(
    "geometry",
    [
        {"width": None},
        {"ajar": "0.1"},
        {"face": True},
        {"height": float("nan")},
        {"handle": {**HANDLE, "length": None}},
    ],
)
def test_a_measure_that_is_no_number_is_refused(geometry: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="detections: expected a number for"):
        read_doors(_hit(**geometry))
