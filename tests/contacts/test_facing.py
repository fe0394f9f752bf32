"""Links that turn about a contact point do not reach behind what they touch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from egress_car import car
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel
from costs.state import MotionState
from service.body.facing import keep_facing
from service.verify.ground import MOST_LEAN_RAD, TURNING_DEPTH_M, measure_behind

PATCHES = ("chest", "left_forearm", "right_wrist")


def measure(robot: RobotModel, q: np.ndarray, name: str) -> tuple[float, float]:
    """Return the largest row of the constraint, and the same measured with all vertices of the link's bodies."""
    patch = robot.contacts[name]
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    place = data.oMf[robot.model.getFrameId(patch.link)].act(patch.points[0])
    normal = np.array([0.0, 0.0, 1.0])
    state = MotionState(KinematicsEngine(robot)(q[None]), Contacts.none())
    (constraint,) = keep_facing(robot, name, normal, place, np.zeros(1, dtype=int))
    rows = constraint.residual.value(state)
    offsets = [
        np.array([data.oMi[body.joint].act(vertex) for vertex in body.vertices]) - place
        for body in robot.bodies
        if body.link == patch.link
    ]
    return float(rows.max()), max(measure_behind(o, normal) for o in offsets) - TURNING_DEPTH_M


def turn_to_face(robot: RobotModel, name: str, axis: float, lean: float) -> np.ndarray:
    """Return a configuration whose patch faces a floor, then leans about a horizontal axis."""
    patch = robot.contacts[name]
    q = np.array(robot.postures["stand"])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    normal = data.oMf[robot.model.getFrameId(patch.link)].rotation @ patch.normals.mean(axis=0)
    up = np.array([0.0, 0.0, 1.0])
    across = np.cross(normal, up)
    angle = np.arctan2(np.linalg.norm(across), normal @ up)
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else np.array([1.0, 0.0, 0.0])
    faced = pin.exp3(lean * np.array([np.cos(axis), np.sin(axis), 0.0])) @ pin.exp3(angle * across)
    turned = faced @ pin.rpy.rpyToMatrix(q[5], q[4], q[3])
    roll, pitch, yaw = pin.rpy.matrixToRpy(turned)
    q[3:6] = yaw, pitch, roll
    return q


@pytest.mark.parametrize("name", PATCHES)
@settings(max_examples=25, deadline=None)
@given(axis=st.floats(0.0, 6.28), lean=st.floats(0.0, 0.75))
def test_the_chosen_vertices_say_the_same_as_all_of_them(name: str, axis: float, lean: float) -> None:
    robot, _ = car()
    rows, everything = measure(robot, turn_to_face(robot, name, axis, lean), name)
    if lean <= MOST_LEAN_RAD:
        assert rows <= 0.0  # what leans no more than the verifier allows is never behind
    if name != "chest":  # of one body that the patch touches
        assert rows == pytest.approx(everything, abs=1e-3) if everything > 0.0 else rows <= 1e-9


def test_a_sole_needs_no_such_constraint() -> None:
    robot, _ = car()
    up = np.array([0.0, 0.0, 1.0])
    assert keep_facing(robot, "left_foot", up, np.zeros(3), np.zeros(1, dtype=int)) == []
