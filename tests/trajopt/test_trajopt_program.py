"""Holding problem files to robots: which coordinates move, where they start, what is fixed, what stands."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_robots import PLANAR, atlas, chain
from trajopt_problems import EXAMPLES, arm, document, findings_of, program_of, straight_rows, term

from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import load_robot
from service.request.schema import PoseRequest, StartRequest
from service.trajopt.problem import PoseTerm, ZmpTerm
from service.trajopt.program import Timeline
from service.trajopt.robot_checks import parse_manip

ARM_JOINTS = arm().joint_names
FEET = ("l_foot", "r_foot")


def names(robot, columns):
    return [robot.joint_names[column] for column in columns]


def foot_poses(robot=None, q=None):
    robot = robot or atlas()
    poses = locate_links(KinematicsEngine(robot), robot.postures["stand"] if q is None else q, FEET)
    return {
        foot: {
            "link": foot,
            "xyz": pose[:3, 3].tolist(),
            "wxyz": Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True).tolist(),
        }
        for foot, pose in poses.items()
    }


def standing_document(n_steps=4, feet=FEET, balanced=range(1, 4), manip="active", **more):
    poses = foot_poses()
    constraints = [term("pose", timestep=t, **poses[foot]) for t in range(1, n_steps) for foot in feet]
    constraints += [term("zmp", timestep=t, planted_links=list(FEET)) for t in balanced]
    return document(manip, n_steps, constraints=[*constraints, *more.pop("constraints", [])], **more)


def test_a_manip_is_groups_joints_and_base_in_the_order_they_are_named():
    robot = atlas()
    columns, problems = parse_manip(robot, "rightarm + back_bkz+base")
    assert problems == ()
    assert names(robot, columns) == [*robot.groups["right_arm"], "back_bkz", "base_x", "base_y", "base_yaw"]
    whole, _ = parse_manip(robot, "active")
    assert names(robot, whole) == [*robot.joint_names[6:], *robot.joint_names[:6]]
    assert names(arm(), parse_manip(arm(), "active")[0]) == list(ARM_JOINTS)


@pytest.mark.parametrize(
    ("robot", "manip", "line"),
    [
        (arm, "right_arn", "basic_info.manip: arm7 has no group or joint 'right_arn'; expected right_arm, …"),
        (arm, "right_arm+elbow_pitch", "basic_info.manip: elbow_pitch is named twice"),
        (arm, "right_arm+base", "basic_info.manip: the base of arm7 is fixed; leave 'base' out"),
        (arm, "x+" * 100, "basic_info.manip: expected at most 100 groups and joints, got 101"),
        (atlas, "left_arm+", "basic_info.manip: atlas has no group or joint ''"),
    ],
)
def test_a_manip_that_is_not_there_is_refused(robot, manip, line):
    (problem,) = findings_of(robot(), document(manip))
    assert problem.startswith(line)


def test_joints_outside_the_manip_stay_where_they_start():
    robot = atlas()
    program = program_of(robot, document("left_arm+back", fixed_dofs=[0, 9]))
    assert names(robot, program.free) == ["back_bkz", "back_bky", *robot.groups["left_arm"][1:]]
    np.testing.assert_array_equal(program.init, np.tile(robot.postures["stand"], (5, 1)))
    assert list(program.fixed) == [0]


def test_what_is_fixed_stays_at_its_start_in_the_trajectory_to_start_from():
    init = {"type": "given_traj", "data": straight_rows([0.0] * 7, [0.5] * 7, 5)}
    program = program_of(arm(), document(init=init, dofs_fixed=[2], fixed_timesteps=[0, 4]))
    np.testing.assert_array_equal(program.init[:, 2], 0.0)
    assert program.fixed[4][2] == 0.0
    assert program.fixed[4][3] == 0.5


def test_a_straight_line_runs_from_the_start_to_its_endpoint():
    start = StartRequest(joints={"elbow_pitch": 0.5})
    init = {"type": "straight_line", "endpoint": [0.4, 0, 0, 1.5, 0, 0, 0]}
    program = program_of(arm(), document(init=init), start)
    np.testing.assert_allclose(program.init[:, 3], [0.5, 0.75, 1.0, 1.25, 1.5])
    np.testing.assert_allclose(program.init[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4])


def test_the_first_row_of_a_given_trajectory_is_the_start_where_the_request_is_silent():
    rows = straight_rows([0.1] * 7, [0.5] * 7, 5)
    data = document(init={"type": "given_traj", "data": rows})
    program = program_of(arm(), data)
    np.testing.assert_allclose(program.start, 0.1)
    np.testing.assert_allclose(program.init, rows)
    assert "7 joints start at the first row of init_info.data" in program.notes
    agreed = program_of(arm(), data, StartRequest(joints={"elbow_pitch": 0.10005}))
    assert agreed.start[3] == 0.10005
    (problem,) = findings_of(arm(), data, StartRequest(joints={"elbow_pitch": 0.2}))
    assert problem.startswith("init_info.data[0][3]: 0.1, but elbow_pitch starts at 0.2; the two must agree")
    free = program_of(arm(), {**data, "basic_info": {**data["basic_info"], "start_fixed": False}})
    assert free.fixed == {}
    assert any(note.startswith("start_fixed is false: the motion begins at its own") for note in free.notes)


def test_the_base_of_a_given_trajectory_starts_at_its_first_row_too():
    robot = atlas()
    init = {"type": "given_traj", "data": [[0.2, 0.3, 0.1]] * 3}
    program = program_of(robot, document("base", 3, init=init))
    np.testing.assert_allclose(program.start[[0, 1, 3]], [0.2, 0.3, 0.1])
    assert names(robot, program.free) == ["base_x", "base_y", "base_yaw"]
    stood = StartRequest(base=PoseRequest(position=(0.0, 0.0, 0.9)))
    assert (
        "init_info.data[0][0]: 0.2, but base_x starts at 0;"
        in findings_of(robot, document("base", 3, init=init), stood)[0]
    )


def test_joint_constraints_become_ranges_and_a_waypoint_without_freedom_is_fixed():
    vals = [0.1, -0.4, 0.0, 0.9, 0.0, -0.2, 0.0]
    ranged = term("joint_pos", targets=[0.0], upper_tols=[0.3], lower_tols=[-0.2], first_step=1, last_step=2)
    program = program_of(arm(), document(constraints=[term("joint", vals=vals), ranged]))
    assert sorted(program.fixed) == [0, 4]
    np.testing.assert_array_equal(program.fixed[4], vals)
    asked = program.ranges[2][0]
    assert (asked.lower, asked.target, asked.upper) == (-0.2, 0.0, 0.3)


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (
            document(constraints=[term("joint", vals=[0.1] * 6)]),
            "constraints[0].params.vals: 7 numbers are needed (one",
        ),
        (document(costs=[term("joint_vel", coeffs=[1, 2])]), "costs[0].params.coeffs: 7 numbers are needed"),
        (document(init={"type": "straight_line", "endpoint": [0.0]}), "init_info.endpoint: 7 numbers are needed"),
        (document(dofs_fixed=[7]), "basic_info.dofs_fixed: 7 is no degree of freedom; expected 0 to 6"),
        (
            document(constraints=[term("joint", vals=[0, 0, 0, 2.4, 0, 0, 0])]),
            "constraints[0].params.vals[3]: 2.4 is outside the limits of elbow_pitch; expected -2.3 to 2.3",
        ),
        (
            document(constraints=[term("joint", vals=[0.2] * 7), term("joint", vals=[0.1] * 7)]),
            "constraints[1].params.vals[0]: shoulder_yaw at waypoint 4 has a different range in constraints[0]",
        ),
        (
            document(constraints=[term("joint", vals=[0.2] * 7, timestep=0)]),
            "constraints[0].params.vals[0]: 0.2 is impossible: shoulder_yaw is fixed at its start, 0",
        ),
        (
            document(constraints=[term("joint", vals=[0.2] * 7)], fixed_timesteps=[0, 4]),
            "constraints[0].params.vals[0]: 0.2 is impossible: shoulder_yaw is fixed at waypoint 4, 0",
        ),
        (
            document(constraints=[term("joint", vals=[0.2] * 7)], dofs_fixed=[0]),
            "constraints[0].params.vals[0]: 0.2 is impossible: shoulder_yaw is fixed at its start, 0",
        ),
        (
            document(init={"type": "given_traj", "data": [[3.0] * 7] * 5}),
            "init_info.data[0][0]: 3 is outside the limits of shoulder_yaw; expected -2.6 to 2.6",
        ),
        (
            document(constraints=[term("pose", link="tol", xyz=[1, 0, 1], wxyz=[1, 0, 0, 0])]),
            "constraints[0].params.link: arm7 has no link 'tol'; expected tool, …",
        ),
        (
            document(costs=[term("dynamic_cart_pose", link="tool", target="upper_arn")]),
            "costs[0].params.target: arm7 has no link 'upper_arn'; expected upper_arm, upper_arm_roll, …",
        ),
        (
            document(constraints=[term("zmp", timestep=1, planted_links=["tool"])]),
            "constraints[0].params.planted_links[0]: link 'tool' has no collision shape",
        ),
        (
            document(constraints=[term("zmp", timestep=1, planted_links=["hand"])]),
            "constraints[0].type: zmp needs a free base, and that of arm7 is fixed",
        ),
    ],
)
def test_what_does_not_fit_the_robot_is_said_with_its_path(data, line):
    assert any(finding.startswith(line) for finding in findings_of(arm(), data)), findings_of(arm(), data)


def test_all_that_does_not_fit_is_told_at_once():
    data = document(
        costs=[term("joint_vel", coeffs=[1, 2])],
        constraints=[term("cart_vel", link="tolo", first_step=0, last_step=2, max_displacement=0.1)],
        dofs_fixed=[9],
    )
    paths = [finding.split(":")[0] for finding in findings_of(arm(), data)]
    assert paths == ["constraints[0].params.link", "basic_info.dofs_fixed", "costs[0].params.coeffs"]


def test_a_value_at_a_limit_is_taken_as_it_is():
    program = program_of(arm(), document(constraints=[term("joint", vals=[2.6, 0, 0, 0, 0, 0, 0])]))
    assert program.fixed[4][0] == 2.6


def test_feet_held_at_every_waypoint_are_planted_and_zmp_at_every_waypoint_is_balance():
    program = program_of(atlas(), standing_document())
    assert program.planted == FEET
    assert program.is_balanced
    assert not any(isinstance(each, PoseTerm | ZmpTerm) for each in program.problem.terms)
    assert "l_foot is planted: constraints[0] to constraints[4] hold it where it starts" in program.notes[0]


def test_a_foot_that_is_free_for_one_waypoint_or_held_elsewhere_is_not_planted():
    data = standing_document(balanced=())
    del data["constraints"][0]
    program = program_of(atlas(), data)
    assert program.planted == ("r_foot",)
    assert sum(isinstance(each, PoseTerm) for each in program.problem.terms) == 2
    for each in data["constraints"]:
        each["params"]["xyz"][2] += 0.01
    program = program_of(atlas(), data)
    assert program.planted == ()
    assert any("nothing in the file says that l_foot and r_foot stand" in note for note in program.notes)


def test_zmp_at_some_waypoints_is_no_balance_of_the_whole_motion():
    for balanced in ([1, 3], [2, 3], [1, 2]):
        program = program_of(atlas(), standing_document(balanced=balanced))
        assert not program.is_balanced
        assert sum(isinstance(each, ZmpTerm) for each in program.problem.terms) == 2
        assert any("balance is not part of the proof" in note for note in program.notes)


def test_the_feet_of_a_robot_whose_arm_alone_moves_are_planted_without_balance():
    program = program_of(atlas(), document("left_arm"))
    assert program.planted == FEET
    assert not program.is_balanced
    balanced = program_of(atlas(), standing_document(feet=(), manip="left_arm"))
    assert balanced.is_balanced


def test_nothing_stands_on_a_fixed_base():
    program = program_of(load_robot("atlas", root="fixed"), document("left_arm"))
    assert program.planted == ()
    assert len(program.start) == 30


def test_a_pose_relative_to_what_no_joint_moves_is_a_pose_in_the_world():
    pose = {"source_frame": "tool", "target_frame_offset_xyz": [0.5, 0.1, 0.3]}
    data = document(
        constraints=[
            term("cart_pose", target_frame="pedestal", **pose),
            term("cart_pose", target_frame="world", **pose),
            term("cart_pose", target_frame="upper_arm", **pose),
        ]
    )
    references = [each.reference for each in program_of(arm(), data).problem.terms]
    assert references == [None, None, "upper_arm"]


def test_steps_are_found_again_among_more_waypoints():
    before = np.array([[0.0], [1.0], [1.0], [3.0]])
    after = np.array([[0.0], [0.5], [1.00001], [1.00001], [2.0], [2.5], [3.0]])
    timeline = Timeline.of_steps(4).insert_waypoints(before, after)
    np.testing.assert_array_equal(timeline.rows, [0, 2, 3, 6])
    again = timeline.insert_waypoints(after, np.concatenate([after[:5], [[2.2]], after[5:]]))
    np.testing.assert_array_equal(again.rows, [0, 2, 3, 7])
    np.testing.assert_array_equal(again.list_waypoints(1, 3), np.arange(2, 8))
    np.testing.assert_array_equal(again.find_steps(again.list_waypoints(1, 3)), [1, 2, 2, 2, 2, 3])


def test_the_robot_a_file_names_has_no_bearing_once_there_is_one():
    program = program_of(chain(PLANAR), document("joint1", robot="pr2"))
    assert "basic_info.robot: 'pr2' has no effect; the robot is chain" in program.notes


def test_the_example_for_atlas_plants_both_feet():
    program = program_of(atlas(), json.loads((EXAMPLES / "atlas_reach.json").read_text()))
    assert (program.planted, program.is_balanced) == (FEET, True)
    assert len(program.free) == 36
