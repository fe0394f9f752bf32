"""Sets of benchmark problems: one arm, boxes, cylinders and spheres, a start and a goal in joint positions."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown
from service.request.file import parse_request
from service.request.schema import PlanRequest

SHAPES = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "height")}


@dataclass(frozen=True)
class BenchProblem:
    """Benchmark problem.

    Attributes:
        name: its ``id`` in the file.
        scene: the family it belongs to.
        joints: order of the joints in start, goal and result paths.
        request: the same problem as a request.
    """

    name: str
    scene: str
    joints: tuple[str, ...]
    request: PlanRequest


@dataclass(frozen=True)
class BenchRobot:
    """Files of the robot that a problem set is judged with."""

    urdf: Path
    srdf: Path | None = None
    package_root: Path | None = None

    def to_request(self) -> dict[str, Any]:
        """Return the ``robot`` section of a request."""
        section: dict[str, Any] = {"urdf": str(self.urdf.resolve())}
        if self.srdf is not None:
            section["srdf"] = str(self.srdf.resolve())
        if self.package_root is not None:
            section["package_dirs"] = [str(self.package_root.resolve())]
        return section


def read_problems(
    path: Path, robot: BenchRobot, options: Mapping[str, Any], limit: int | None = None
) -> list[BenchProblem]:
    """Return the problems of a file or of the JSON files of a folder, at most ``limit`` of each scene.

    Raises:
        RequestError: a file is missing or not a problem file.
    """
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not files or not files[0].is_file():
        raise RequestError(f"{path} holds no problem files (*.json)")
    problems: list[BenchProblem] = []
    for file in files:
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            problems += _read_file(data, robot, options)
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise RequestError(f"{file}: cannot be read as JSON ({error})") from None
        except (KeyError, TypeError, ValueError) as error:
            raise RequestError(f"{file}: not a problem file: {type(error).__name__} {shown(str(error))}") from None
    if limit is not None:
        problems = [p for k, p in enumerate(problems) if sum(q.scene == p.scene for q in problems[:k]) < limit]
    return problems


def _read_file(data: Mapping[str, Any], robot: BenchRobot, options: Mapping[str, Any]) -> Iterator[BenchProblem]:
    joints = tuple(data["joints"])
    for problem in data["problems"]:
        request = {
            "robot": robot.to_request(),
            "start": {"joints": dict(zip(joints, problem["start"], strict=True))},
            "scene": {"obstacles": [_to_obstacle(index, o) for index, o in enumerate(problem["obstacles"])]},
            "goal": {"joints": dict(zip(joints, problem["goal"], strict=True))},
            "options": dict(options),
        }
        yield BenchProblem(str(problem["id"]), str(problem["scene"]), joints, parse_request(request))


def _to_obstacle(index: int, obstacle: Mapping[str, Any]) -> dict[str, Any]:
    """Convert an obstacle to that of a request; names get their index, since problem sets repeat them."""
    x, y, z, w = obstacle["quat_xyzw"]
    sizes = {
        ("height" if key == "length" else key): obstacle[key]
        for key in obstacle
        if key in ("size", "radius", "height", "length")
    }
    if set(sizes) != set(SHAPES[obstacle["type"]]):
        raise ValueError(f"obstacle {obstacle['name']} of type {obstacle['type']} has {sorted(sizes)}")
    return {
        "name": f"{obstacle['name']}#{index}",
        "type": obstacle["type"],
        "position": obstacle["position"],
        "quaternion_wxyz": [w, x, y, z],
        **sizes,
    }
