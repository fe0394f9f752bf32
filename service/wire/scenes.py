"""Scenes and detections as messages."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from service.proto.planner.v1.planner_pb2 import BuiltScene, Detection, Piece


def scene_to_message(scene_id: str, text: bytes) -> BuiltScene:
    """Convert a scene's file to a message, which also holds the file."""
    data = json.loads(text)
    message = BuiltScene(
        scene_id=scene_id,
        pieces=[
            Piece(name=piece["name"], kind=piece["kind"], vertices=np.ravel(piece["vertices"]))
            for piece in data["pieces"]
        ],
        detections=detections_to_messages(data["detections"]),
        notes=data["notes"],
        json=text,
    )
    message.figures.update(data["figures"])
    return message


def detections_to_messages(hits: Iterable[Mapping[str, Any]]) -> list[Detection]:
    """Convert hits as ``scopt detect`` prints them; figures that are no numbers are left out."""
    return [
        Detection(
            kind=hit["kind"],
            confidence=hit["confidence"],
            pose_world_object=np.ravel(hit["pose_world_object"]),
            sizes=_numbers(hit["sizes"]),
            residuals=_numbers(hit["residuals"]),
            doubts=hit.get("doubts", ()),
        )
        for hit in hits
    ]


def _numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}
