"""The shipped request of an egress: its robot, its car as a scene, and its stages."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.demands.contacts.surfaces import make_surfaces
from service.demands.egress.demand import load_phases
from service.request.file import load_request
from service.request.tasks.egress import EgressRequest, PhaseRequest
from service.setup.world import build_obstacles
from service.start.robot import load_requested_robot
from service.tasks.egress.poses import PoseSolver
from service.tasks.egress.stages import EgressStage, make_stages

REQUEST = Path(__file__).resolve().parents[3] / "examples" / "requests" / "egress_model.yaml"


@cache
def car() -> tuple[RobotModel, Scene]:
    """The robot with the request's contact patches, and the pieces of the car, the platform and the ground."""
    request = load_request(REQUEST)
    pieces, _ = build_obstacles(request)
    corners = np.array([[x, y, z] for x in (-3.0, 3.0) for y in (-3.0, 3.0) for z in (-0.1, 0.0)])
    return load_requested_robot(request), Scene((*pieces, ConvexPiece("ground", corners, "floor")))


@cache
def task() -> EgressRequest:
    """The request's task."""
    given = load_request(REQUEST).task
    assert given is not None
    assert given.egress is not None
    return given.egress


@cache
def phases() -> tuple[PhaseRequest, ...]:
    """The phases that ship with the package."""
    return load_phases(task(), car()[0])


@cache
def stages() -> tuple[EgressStage, ...]:
    """The stages for the middle of the region."""
    robot, scene = car()
    return make_stages(robot, make_surfaces(task().surfaces, scene, "surfaces"), phases())


@cache
def solver() -> PoseSolver:
    """A solver of poses in the car."""
    return PoseSolver.of(*car())
