"""What position servos without feed-forward are commanded."""

import csv

import numpy as np
import pytest
from small_plan import small_plan

from costs.robot.servo import default_stiffness
from service.errors import ResultError
from service.execution.reference import PlannedReference
from service.execution.servo_reference import lead_servos, write_servo_reference
from service.result.output import write_result


def test_a_servo_that_follows_the_reference_makes_the_planned_torque_at_the_planned_position():
    q, qd, tau = np.array([[0.1], [0.2], [0.3]]), np.full((3, 1), 10.0), np.array([[4.0], [8.0], [12.0]])
    commanded, speed = lead_servos(q, qd, tau, np.array([100.0]), 0.01, 0.25)
    np.testing.assert_allclose(100.0 * (commanded - q) + 0.25 * tau, tau)
    np.testing.assert_allclose(speed, 10.0 + 0.75 * 4.0)


def test_the_table_of_a_result_leads_every_joint_by_its_sag(tmp_path):
    folder = write_result(small_plan(), tmp_path / "plan").folder
    path = write_servo_reference(folder, tmp_path / "servo.csv")
    rows = list(csv.reader(path.read_text().splitlines()))
    reference = PlannedReference.read(folder)
    assert tuple(rows[0]) == ("time_s", *reference.joint_names)
    row = np.array(rows[251], dtype=float)
    state, table = reference.at(row[0]), default_stiffness(reference.robot)
    sag = np.array([state.tau[k] / table[name] for k, name in enumerate(reference.joint_names)])
    assert np.abs(sag).max() > 1e-3
    np.testing.assert_allclose(row[1:], state.q + sag, atol=1e-8)


def test_a_folder_without_a_result_is_refused(tmp_path):
    with pytest.raises(ResultError):
        write_servo_reference(tmp_path, tmp_path / "servo.csv")
    assert not (tmp_path / "servo.csv").exists()
