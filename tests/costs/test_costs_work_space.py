"""Pinocchio's work space: one per thread and model, and results that another borrower does not change."""

import threading

import numpy as np
import pinocchio as pin
from tiny_robots import PLANAR, SPATIAL, atlas, chain, random_configurations

from costs.kinematics import KinematicsEngine
from costs.work_space import MOST_KEPT, borrow_data, borrow_work_space


def test_a_model_has_one_work_space_in_a_thread_and_another_in_the_next():
    model = atlas().model
    first, others = borrow_data(model), []
    thread = threading.Thread(target=lambda: others.append(borrow_data(model)))
    thread.start()
    thread.join()
    assert borrow_data(model) is first
    assert others[0] is not first
    assert borrow_data(chain(PLANAR).model) is not first


def test_placements_are_those_of_the_last_configuration():
    robot = chain(SPATIAL)
    space = borrow_work_space(robot.model)
    for q in random_configurations(robot, np.random.default_rng(1), 3):
        pin.forwardKinematics(robot.model, space.data, q)
        for joint in range(robot.model.njoints):
            placed = space.data.oMi[joint]
            np.testing.assert_array_equal(space.placements[joint, :9].reshape(3, 3).T, placed.rotation)
            np.testing.assert_array_equal(space.placements[joint, 9:], placed.translation)


def test_two_engines_of_one_model_do_not_change_each_other_s_results():
    robot = atlas()
    q = random_configurations(robot, np.random.default_rng(2), 2)
    expected = KinematicsEngine(robot)(q[:1]).position.copy()
    kinematics = KinematicsEngine(robot)(q[:1])
    KinematicsEngine(robot)(q[1:])
    np.testing.assert_array_equal(kinematics.position, expected)


def test_a_work_space_that_was_dropped_is_made_again():
    models = [chain(PLANAR).model.copy() for _ in range(MOST_KEPT + 1)]
    first = borrow_data(models[0])
    for model in models[1:MOST_KEPT]:
        borrow_data(model)
    assert borrow_data(models[0]) is first
    for model in models[1:]:
        borrow_data(model)
    assert borrow_data(models[0]) is not first
