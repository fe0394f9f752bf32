"""Record request hashes and the schema of an earlier release; README.md says how to run it."""

from __future__ import annotations

import dataclasses
import inspect
import json
import sys
import typing
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

try:
    from service.request.file import parse_request, request_hash
    from service.request.schema import PlanRequest
except ImportError:  # before 0.3.0
    from service.request import PlanRequest  # isort: skip
    from service.request_file import parse_request, request_hash

ARM = {"urdf": "arm.urdf"}
REQUESTS: list[dict[str, Any]] = [
    {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}},
    {"robot": ARM, "start": {"joints": {"b": 1, "a": 0.5}}, "goal": {"joints": {"a": -0.5}}, "options": {"seed": 3}},
    {
        "robot": ARM,
        "scene": {
            "floor": False,
            "obstacles": [
                {"name": "ball", "type": "sphere", "radius": 0.1, "position": [1, 2, 3]},
                {"name": "block", "type": "box", "size": [0.1, 0.2, 0.3], "quaternion_wxyz": [0.8, 0.6, 0, 0]},
                {"name": "frame", "type": "mesh", "file": "frame.obj"},
            ],
        },
        "goal": {"poses": [{"link": "tip", "position": [0.5, 0, 0.5], "quaternion_wxyz": [1, 0, 0, 0]}]},
        "keep": [{"link": "tip", "relative_to": "base"}],
        "attached": [{"name": "tool", "type": "cylinder", "radius": 0.1, "height": 1.0, "link": "tip"}],
    },
    {"robot": {"name": "atlas"}, "scene": {"cloud": "scan.pcd"}, "task": {"valve": {"turn_deg": 90}}},
    {"robot": {"name": "atlas"}, "scene": {"cloud": "scan.pcd"}, "task": {"door": {"hand": "left"}}},
    {"robot": {"name": "atlas"}, "scene": {"cloud": "scan.pcd"}, "task": {"door": {"open_deg": 70}}},
    {"robot": {"name": "atlas"}, "scene": {"cloud": "car.pcd"}, "task": {"egress": {"side": "right"}}},
    {"robot": {"name": "atlas"}, "task": {"trajopt": {"basic_info": {"n_steps": 5}}}},
]
"""Requests that 0.2.0 reads, too."""
LATER: list[dict[str, Any]] = [
    {
        "robot": {**ARM, "locked": {"b": 0.5}, "servo": {"stiffness": {"a": 100.0}}, "torque": {"check": False}},
        "scene": {
            "cloud": "scan.pcd",
            "obstacles": [{"name": "ball", "type": "sphere", "radius": 0.1, "in_scan": True}],
            "cuts": [{"name": "hole", "type": "sphere", "radius": 0.2}],
        },
        "task": {
            "mechanism": {
                "urdf": "<robot name='m'/>",
                "handle": {"link": "bar", "place": [0, 0, 0], "axis": [0, 0, 1]},
                "moves": [{"joint": "j", "to": 0.2}],
            }
        },
    },
    {
        "robot": {"name": "atlas", "hand": "gripper"},
        "task": {
            "valve": {
                "centre": [0.7, 0, 1.1],
                "axis": [-1, 0, 0],
                "lever": {"direction": [0, 1, 0], "length_m": 0.3, "radius_m": 0.01},
                "turn_deg": 80,
            }
        },
    },
    {
        "robot": {"name": "atlas"},
        "task": {
            "contacts": {
                "surfaces": {"step": {"piece": "step"}},
                "stances": [{"name": "one", "make": {"l_foot": {"surface": "step", "at": [0.3, 0.1, 0.2]}}}],
            }
        },
    },
]
"""Requests that 0.3.0 reads."""


def list_fields(kind: object, known: dict[str, Any], seen: set[object]) -> dict[str, Any]:
    """Collect the default of every field of a class and of those it leads to, by ``CLASS.FIELD``."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind.__module__.startswith("service."):
        if kind not in seen:
            seen.add(kind)
            declared = {name: cls.__name__ for cls in reversed(kind.__mro__) for name in inspect.get_annotations(cls)}
            hints = typing.get_type_hints(kind, include_extras=True)
            for field in dataclasses.fields(kind):
                known[f"{declared[field.name]}.{field.name}"] = read_default(field)
                list_fields(hints[field.name], known, seen)
    else:
        for part in typing.get_args(kind):
            list_fields(part, known, seen)
    return known


def read_default(field: dataclasses.Field[Any]) -> Any:
    """Return a field's default as JSON data: ``required`` without one, of a section the name of its class."""
    if field.default is field.default_factory is dataclasses.MISSING:
        return "required"
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    return type(default).__name__ if dataclasses.is_dataclass(default) else to_jsonable_python(default)


def main() -> None:
    """Write ``requests.json`` and ``schema.json`` into the folder that is named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    requests = REQUESTS + (LATER if "resume" in {field.name for field in dataclasses.fields(PlanRequest)} else [])
    hashed = [{"request": data, "request_hash": request_hash(parse_request(data))} for data in requests]
    (folder / "requests.json").write_text(json.dumps(hashed, indent=1) + "\n")
    schema = list_fields(PlanRequest, {}, set())
    (folder / "schema.json").write_text(json.dumps(schema, indent=0, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
