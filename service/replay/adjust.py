"""Targets of a request, displaced by what an operator or a new measurement says."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown
from service.request.schema import PlanRequest
from service.setup.world import Surroundings
from service.start.robot import load_requested_robot
from service.tasks.kind import find_plan_part

LARGEST_M = 0.3  # of a displacement
OBJECTS = ("valve", "door")  # targets that a hand reaches for


def read_adjustment(text: str) -> tuple[str, Float[np.ndarray, "3"]]:
    """Return target and displacement [m] of a text ``TARGET:X,Y,Z``.

    Raises:
        RequestError: it is none.
    """
    target, _, numbers = text.rpartition(":")
    try:
        offset = np.array([float(number) for number in numbers.split(",")])
        if not target or offset.shape != (3,) or not np.isfinite(offset).all():
            raise ValueError
    except ValueError:
        words = f"--adjust: {shown(text)}; expected TARGET:X,Y,Z in metres, such as right_foot:0.02,0,0"
        raise RequestError(words) from None
    return target, offset


def adjust_request(
    request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
) -> tuple[PlanRequest, Surroundings | None]:
    """Return a request, and what its scan shows, with a target displaced.

    Args:
        request: the request for the rest.
        around: what its scan shows, if it has one.
        target: link of a goal's pose, ``valve``, ``door`` (leaf and handle together), or, where contacts change, a
            patch that is set down anew, or an obstacle of the request with all contacts on it.
        offset: displacement in world axes [m].

    Raises:
        RequestError: the request has no such target, or the displacement makes no sense.
    """
    if offset.shape != (3,) or not np.all(np.isfinite(offset)) or np.linalg.norm(offset) > LARGEST_M:
        raise RequestError(f"adjust: {offset.tolist()}; expected three numbers, at most {LARGEST_M:g} m in all")
    return find_plan_part(request).displace(request, around, target, offset)


def adjust_shifted(request: PlanRequest, link: str, offset: Float[np.ndarray, "3"]) -> PlanRequest:
    """Return a request without a scan, with what a link reaches for displaced as an operator shifted the link.

    This is a pose of a goal, else the next place of a patch, each of the body of the link, else the valve or door.

    Raises:
        RequestError: there is nothing of this kind, or the displacement makes no sense.
    """
    robot = load_requested_robot(request)
    joints = {frame.name: frame.parentJoint for frame in robot.model.frames}
    goals = [] if request.goal is None else [pose.link for pose in request.goal.poses]
    placed = [*((name, name) for name in goals), *((name, patch.link) for name, patch in robot.contacts.items())]
    own = [name for name, frame in placed if link in joints and joints.get(frame) == joints[link]]
    problems = []
    for target in dict.fromkeys((link, *own, *OBJECTS)):
        try:
            return adjust_request(request, None, target, offset)[0]
        except RequestError as error:
            problems.append(error.problems[0])
    raise RequestError(f"{link} was shifted: {problems[0]}")
