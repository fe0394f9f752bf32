"""Parameters of a task file that a detected object gives: where it is, where its axes point, and its sizes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.errors import RequestError, would_do
from service.request.task_files import TaskFile
from service.scan.cloud import CloudInput
from service.scan.detect import detect_file

LEAST_CONFIDENCE = 0.5
AXES = {"x_axis": 0, "y_axis": 1, "z_axis": 2}


def bind_parameters(file: TaskFile, given: Mapping[str, Any], cloud: Path) -> dict[str, Any]:
    """Return the given values with those that detected objects give, as far as none is given.

    Raises:
        RequestError: the scan does not show such an object, or it has no such value.
    """
    values = dict(given)
    hits: dict[str, Mapping[str, Any]] = {}
    for name, parameter in file.data.parameters.items():
        if parameter.detect is None or parameter.value is None or name in values:
            continue
        if parameter.detect not in hits:
            found = detect_file(CloudInput((cloud,)), parameter.detect, None, lambda step: None)["hits"]
            if not found or found[0]["confidence"] < LEAST_CONFIDENCE:
                if parameter.default is not None:
                    continue
                raise RequestError(
                    f"task.with.{name}: {cloud.name} shows no {parameter.detect} that gives it; set it, or scan again"
                )
            hits[parameter.detect] = found[0]
        values[name] = read_hit(hits[parameter.detect], parameter.value, f"task.with.{name}")
    return values


def read_hit(hit: Mapping[str, Any], value: str, field: str) -> Any:
    """Return a value of a detected object: ``centre``, ``x_axis``, ``y_axis``, ``z_axis``, or one of its sizes.

    ``button`` of a panel is the middle of a button's front: of the one next to where the operator clicked, else of its
    only one.

    Raises:
        RequestError: it has no such value, or has several buttons and nobody clicked.
    """
    pose = np.array(hit["pose_world_object"], dtype=float)
    if value == "centre":
        return [float(own) for own in pose[:3, 3]]
    if value in AXES:
        return [float(own) for own in pose[:3, AXES[value]]]
    sizes = hit["sizes"]
    if value == "button" and sizes.get("n_buttons"):
        return _find_button(hit, field)
    if value not in sizes:
        known = would_do(value, ["centre", *AXES, *sizes])
        raise RequestError(f"{field}: a detected {hit['kind']} has no '{value}'; expected {known}")
    return float(sizes[value])


def _find_button(hit: Mapping[str, Any], field: str) -> list[float]:
    """Return the middle of the front of a panel's button [m]."""
    sizes, pose = hit["sizes"], np.array(hit["pose_world_object"], dtype=float)
    places = np.array(
        [
            [sizes[f"button_{k}_x"], sizes[f"button_{k}_y"], sizes[f"button_{k}_height"]]
            for k in range(int(sizes["n_buttons"]))
        ]
    )
    fronts = places @ pose[:3, :3].T + pose[:3, 3]
    clicked = hit.get("clicked")
    if clicked is None and len(fronts) > 1:
        listed = "; ".join(", ".join(f"{own:.3f}" for own in front) for front in fronts)
        raise RequestError(f"{field}: the panel has {len(fronts)} buttons, at {listed}; set it to one of them")
    off = fronts - np.asarray(fronts[0] if clicked is None else clicked, dtype=float)
    return [float(own) for own in fronts[int(np.linalg.norm(off, axis=1).argmin())]]
