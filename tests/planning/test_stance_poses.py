"""Reserves of a single pose: torque against virtual work, the arm's length, and what hands hold on a turned leaf."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel, load_robot, with_mechanism
from costs.scene import Scene
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.demands.door.demand import make_door, measure_peg, read_given_door
from service.demands.door.door import Door
from service.demands.door.phases import DoorChoice, make_door_phases
from service.demands.hands import HANDS
from service.demands.phase import TaskPhase
from service.demands.scene import make_floor
from service.request.tasks.door import DoorRequest, HandleRequest, LeafRequest
from service.tasks.stances.poses import (
    find_shoulder,
    list_arm_joints,
    measure_arm,
    measure_torque,
    place_on_joint,
)

ROBOT = load_robot("atlas")
LEAF = LeafRequest(hinge=(0.75, -0.45, 0.01), edge=(0.75, 0.45, 0.01))
REQUEST = DoorRequest(opens="push", leaf=LEAF, handle=HandleRequest(kind="lever", centre=(0.65, 0.38, 1.02)))


def make_opening() -> tuple[Door, TaskPhase]:
    """Return a push door and the phase in which the right hand opens it by its lever."""
    geometry = read_given_door(REQUEST, np.zeros(3))
    assert geometry is not None
    door = make_door(REQUEST, geometry)
    hand = HANDS["right"]
    choice = DoorChoice(hand, measure_peg(ROBOT, hand), 0.1, 1.0, 0.5)
    return door, next(spec for spec in make_door_phases(door, choice) if 0 in spec.moving)


def measure_energy(robot: RobotModel, q: Float[np.ndarray, "n"]) -> float:
    """Return the potential energy [J]."""
    return float(pin.computePotentialEnergy(robot.model, robot.model.createData(), q))


def test_torque_is_the_work_of_weight_and_loads_per_angle() -> None:
    door, spec = make_opening()
    robot = with_mechanism(ROBOT, door.mechanism.joints)
    start = ROBOT.postures["reach_ready"]
    plain = WholeBody.standing(ROBOT, Scene((make_floor(0.0, np.zeros(2)),)), start, ("l_foot", "r_foot"), Aims())
    q = np.concatenate([start, door.mechanism.start])
    body = plain.with_robot(robot, q)
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    points = []
    for load in spec.loads:
        link, tool = (data.oMf[model.getFrameId(frame)] for frame in (load.link, load.tool))
        points.append((load.tool, tool.actInv(link.act(load.place)), -link.rotation @ load.force))

    def measure_work(at: Float[np.ndarray, "n"]) -> float:
        placed = model.createData()
        pin.framesForwardKinematics(model, placed, at)
        return float(sum(placed.oMf[model.getFrameId(tool)].act(point) @ force for tool, point, force in points))

    largest, step = 0.0, 1e-5
    legs = {name for name in robot.joint_names if "_leg_" in name}
    for column, name in enumerate(robot.joint_names):
        if name in legs or not np.isfinite(robot.effort[column]):
            continue
        ahead, back = q.copy(), q.copy()
        ahead[column] += step
        back[column] -= step
        weight = (measure_energy(robot, ahead) - measure_energy(robot, back)) / (2.0 * step)
        work = (measure_work(ahead) - measure_work(back)) / (2.0 * step)
        largest = max(largest, abs(weight) / robot.effort[column], abs(weight - work) / robot.effort[column])
    np.testing.assert_allclose(measure_torque(body, spec, q), largest, rtol=1e-5)
    doubled = replace(spec, loads=tuple(replace(load, force=20.0 * load.force) for load in spec.loads))
    assert measure_torque(body, doubled, q) > largest


def test_arm_begins_at_the_shoulder_and_is_never_longer_than_measured() -> None:
    hand = HANDS["left"]
    names = [ROBOT.model.names[joint] for joint in list_arm_joints(ROBOT, hand.tool)]
    assert names[0] == "l_arm_shz"
    assert len(names) == 7
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = ROBOT.postures["stand"].copy()
        q[6:] = rng.uniform(ROBOT.lower[6:], ROBOT.upper[6:])
        data = ROBOT.model.createData()
        pin.framesForwardKinematics(ROBOT.model, data, q)
        tool = data.oMf[ROBOT.model.getFrameId(hand.tool)].translation
        assert np.linalg.norm(tool - find_shoulder(ROBOT, q, hand)) <= measure_arm(ROBOT, hand, hand.tool) + 1e-9


def test_held_place_turns_with_the_leaf() -> None:
    door, spec = make_opening()
    shut, opened = place_on_joint(door.mechanism, spec, [0.0, np.pi / 2.0])
    hinge = door.geometry.hinge
    assert opened[2] == shut[2]
    np.testing.assert_allclose(np.linalg.norm(opened - hinge), np.linalg.norm(shut - hinge))
    assert opened[0] > shut[0] + 0.5  # away from the robot
