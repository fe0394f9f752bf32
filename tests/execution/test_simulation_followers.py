"""A robot with a joint that follows another one (URDF's ``mimic``), in physics and under online pose control."""

import numpy as np
import pytest
from planar_arm import write_planar_arm
from shared_plans import write_undrawn

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")

from service import parse_request, plan
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.execution.tracking import KinematicRobot, track
from service.simulation.options import SimulationOptions
from service.simulation.run import execute_folder
from service.simulation.stand import read_recorded_request, stand_in_physics

RATIO, OFFSET = -0.7, 0.2
INERTIA = (
    '<inertial><mass value="1"/><origin xyz="0.15 0 0"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A planar arm whose last joint follows the second one."""
    path = tmp_path_factory.mktemp("follower")
    urdf = write_planar_arm(path, 3, 0.3, 0.05, 2.0)
    text = urdf.read_text().replace("<collision>", f"{INERTIA}<collision>")
    last = text.index('<joint name="j2"')
    end = text.index("</joint>", last)
    urdf.write_text(f'{text[:end]}<mimic joint="j1" multiplier="{RATIO}" offset="{OFFSET}"/>{text[end:]}')
    result = plan(parse_request({"robot": {"urdf": str(urdf)}, "goal": {"joints": {"j0": 0.6, "j1": 0.5}}}))
    assert result.verdict.value == "CERTIFIED", result.explanation
    return write_undrawn(result, path / "out")


def test_a_follower_moves_with_its_leader_in_physics(folder):
    (made,) = execute_folder(folder, SimulationOptions())
    model = made.model
    assert model.joint_names == ("j0", "j1")
    ((address, follower),) = model.followers
    assert (follower.joint, follower.leader) == ("j2", "j1")
    assert follower.ratio == pytest.approx(RATIO)
    assert made.record.fell_at_s is None
    assert np.abs(made.record.configuration[-1] - made.record.planned[-1]).max() < 5e-3
    robot = stand_in_physics(made.reference, read_recorded_request(folder), SimulationOptions(settle_s=0.2))
    value, leader = robot.data.qpos[address], robot.data.qpos[model.qpos[1]]
    assert value == pytest.approx(OFFSET + RATIO * leader, abs=2e-3)


@pytest.mark.parametrize("is_physical", [False, True])
def test_a_plan_with_a_follower_is_tracked(folder, is_physical):
    reference = PlannedReference.read(folder)
    if is_physical:
        robot = stand_in_physics(reference, read_recorded_request(folder), SimulationOptions(settle_s=0.2), 4)
    else:
        robot = KinematicRobot(reference.joint_names, reference.at(0.0).q, 4e-3)
    report = track(Execution(reference, robot))
    assert report.verdict == "TRACKED"
    np.testing.assert_allclose(robot.read().q, reference.at(reference.duration_s).q, atol=0.01)
