"""Check of a request's unit: positions over a hundred metres from the robot are refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.errors import RequestError
from service.request.fields import LARGEST_M
from service.request.scene import (
    BoxRequest,
    CapsuleRequest,
    ConvexRequest,
    CylinderRequest,
    ObstacleRequest,
    SphereRequest,
)
from service.request.schema import PlanRequest
from service.start.standing import place_bodies

FAR_M = 100.0  # a larger distance from the robot is in another unit or frame
IDLE_M = 30.0  # an obstacle at this distance has no influence on the motion
MOST_NAMED = 3
_MM = 1e-3


@dataclass(frozen=True)
class _Box:
    """An axis-aligned box in the world [m]."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    @staticmethod
    def around(points: Float[np.ndarray, "V 3"]) -> _Box:
        return _Box(points.min(axis=0), points.max(axis=0))

    def gap(self, other: _Box) -> float:
        """Return the distance between two boxes [m], 0 if they meet."""
        return float(np.linalg.norm(np.maximum(np.maximum(self.low - other.high, other.low - self.high), 0.0)))


def check_units(request: PlanRequest, robot: RobotModel, start: Float[np.ndarray, "n"]) -> tuple[str, ...]:
    """Return a note about obstacles too far away to influence the motion, if there are any.

    Raises:
        RequestError: one line per position so far away that its unit or frame must be wrong; the schema checks sizes.
    """
    here, boxes = _robot_box(robot, start), _extents(request.scene.obstacles)
    problems = _find_problems(request, here, boxes)
    if problems:
        raise RequestError(problems)
    gaps = [(here.gap(box), obstacle.name) for obstacle, box in zip(request.scene.obstacles, boxes, strict=True)]
    far = [f"{name} ({gap:.0f} m)" for gap, name in gaps if gap > IDLE_M]
    if not far:
        return ()
    named = ", ".join(far[:MOST_NAMED]) + (f" and {len(far) - MOST_NAMED} more" if len(far) > MOST_NAMED else "")
    return (f"scene.obstacles: out of the robot's reach by far: {named}; are they given in metres?",)


def _find_problems(request: PlanRequest, here: _Box, boxes: Sequence[_Box]) -> tuple[str, ...]:
    """Return the lines of ``check_units``, given the boxes around robot and obstacles."""
    base = None if request.start.base is None else np.array(request.start.base.position)
    problems: list[str] = []
    for field, point, box in _places(request, boxes):
        gap = here.gap(box)
        if gap <= FAR_M:
            continue
        if base is not None and np.linalg.norm(base) > FAR_M >= np.linalg.norm(point):
            line = f"start.base.position: {_row(base)} is {gap:.0f} m from {field.rpartition('.')[0] or field}"
            problems.append(f"{line}, farther than {FAR_M:g} m; is it in millimetres? Use {_row(_MM * base)}.")
        else:
            line = f"{field}: {_row(point)} is {gap:.0f} m from the robot, farther than {FAR_M:g} m"
            problems.append(f"{line}; are these millimetres? Use {_row(_MM * point)}.")
    problems += _convex_problems(request)
    problems += _floor_problems(request, here)
    problems += _relative_problems(request)
    return tuple(dict.fromkeys(problems))


def _robot_box(robot: RobotModel, start: Float[np.ndarray, "n"]) -> _Box:
    """Return the bounding box of the robot's bodies at its start; without bodies, its base or the world's origin."""
    placed = [vertices for _, vertices in place_bodies(robot, start)]
    base = start[:3] if robot.is_floating else np.zeros(3)
    return _Box.around(np.vstack(placed) if placed else base[None])


def _places(request: PlanRequest, boxes: Sequence[_Box]) -> Iterator[tuple[str, Float[np.ndarray, "3"], _Box]]:
    """Yield the field, position and bounding box of each placed object in the world [m]."""
    for index, (obstacle, box) in enumerate(zip(request.scene.obstacles, boxes, strict=True)):
        field = f"scene.obstacles[{index}]"
        if isinstance(obstacle, ConvexRequest) and not any(obstacle.position):
            yield f"{field}.points", np.array(obstacle.points[0]), box
        else:
            yield f"{field}.position", np.array(obstacle.position), box
    points: list[tuple[str, tuple[float, float, float] | None]] = [("scene.hint", request.scene.hint)]
    points += [(f"scene.objects[{k}].position", item.position) for k, item in enumerate(request.scene.objects)]
    points += [(f"{request.kind.field}.{name}", point) for name, point in request.section.list_points()]
    points += [
        (f"keep[{k}].position", keep.position) for k, keep in enumerate(request.keep) if keep.relative_to is None
    ]
    for field, point in points:
        if point is not None:
            yield field, np.array(point), _Box.around(np.array([point]))


def _convex_problems(request: PlanRequest) -> Iterator[str]:
    for index, obstacle in enumerate(request.scene.obstacles):
        if isinstance(obstacle, ConvexRequest):
            span = float(np.ptp(np.array(obstacle.points), axis=0).max())
            if span > LARGEST_M:
                yield (
                    f"scene.obstacles[{index}].points: {span:g} m is larger than {LARGEST_M:g} m; "
                    f"are these millimetres? Use {_MM * span:g}."
                )


def _floor_problems(request: PlanRequest, here: _Box) -> Iterator[str]:
    floor = request.scene.floor
    if floor is None or isinstance(floor, bool):
        return
    gap = max(float(here.low[2]) - floor, floor - float(here.high[2]))
    if gap > FAR_M:
        yield (
            f"scene.floor: {floor:g} is {gap:.0f} m from the robot, farther than {FAR_M:g} m; "
            f"is it in millimetres? Use {_MM * floor:g}."
        )


def _relative_problems(request: PlanRequest) -> Iterator[str]:
    """Yield the problems of points in the frame of a link."""
    points = [(f"keep[{k}].position", keep.position) for k, keep in enumerate(request.keep) if keep.relative_to]
    points += [(f"attached[{k}].position", item.position) for k, item in enumerate(request.attached)]
    for field, position in points:
        if position is not None and np.linalg.norm(position) > FAR_M:
            point = np.array(position)
            line = f"{field}: {_row(point)} is {np.linalg.norm(point):.0f} m from its link, farther than {FAR_M:g} m"
            yield f"{line}; are these millimetres? Use {_row(_MM * point)}."


def _extents(obstacles: Sequence[ObstacleRequest]) -> tuple[_Box, ...]:
    """Return the axis-aligned boxes around obstacles; for meshes, which are not read yet, the largest box."""
    from scipy.spatial.transform import Rotation  # slow to import

    if not obstacles:
        return ()
    quaternions = np.array([obstacle.quaternion_wxyz for obstacle in obstacles])
    rotations = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    return tuple(_extent(*placed) for placed in zip(obstacles, rotations, strict=True))


def _extent(obstacle: ObstacleRequest, rotation: Float[np.ndarray, "3 3"]) -> _Box:
    """Return the axis-aligned box around a turned obstacle."""
    centre = np.array(obstacle.position)
    match obstacle:
        case ConvexRequest():
            return _Box.around(np.array(obstacle.points) @ rotation.T + centre)
        case BoxRequest():
            half = np.array(obstacle.size) / 2.0
        case SphereRequest():
            half = np.full(3, obstacle.radius)
        case CylinderRequest():
            half = np.array([obstacle.radius, obstacle.radius, obstacle.height / 2.0])
        case CapsuleRequest():
            half = np.array([obstacle.radius, obstacle.radius, obstacle.height / 2.0 + obstacle.radius])
        case _:
            return _Box(centre - LARGEST_M, centre + LARGEST_M)
    reach = np.abs(rotation) @ half
    return _Box(centre - reach, centre + reach)


def _row(point: Float[np.ndarray, "3"]) -> str:
    return f"[{', '.join(f'{value:g}' for value in point)}]"
