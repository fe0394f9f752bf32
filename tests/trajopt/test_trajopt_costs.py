"""What TrajOpt charges and forbids, worked out by hand on a planar arm of two links of 1 m."""

from __future__ import annotations

import numpy as np
import pytest
from jacobian import check_jacobian
from tiny_robots import PLANAR, SPATIAL, atlas, chain, contact_free_state, random_configurations
from trajopt_problems import document, program_of, term

from costs.scene import ConvexPiece, Scene
from costs.state import MotionState
from costs.terms import FramePose, Masked
from scopt import Sense
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.tasks.trajopt.program import fit_body
from service.trajopt import Builder, Program, Promises, Timeline
from service.verify import AxisTarget, JointTarget, PoseTarget

# The tip is at (2, 0), (1, 1), (-1, 1) and looks along x, y, -x.
X = np.array([[0.0, 0.0], [0.0, np.pi / 2], [np.pi / 2, np.pi / 2]])
CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def builder_of(
    data: dict, scene: Scene | None = None, timeline: Timeline | None = None, robot=None
) -> tuple[Builder, Program]:
    robot = robot or chain(PLANAR)
    program = program_of(robot, data)
    standing = WholeBody.standing(robot, scene or Scene(), program.start, program.planted, Aims())
    body = fit_body(standing, program)
    return Builder(program, timeline or Timeline.of_steps(program.n_steps), body, body.make_checker()), program


def state_of(builder: Builder, x: np.ndarray) -> MotionState:
    kinematics = builder.body.engine(x)
    return MotionState(kinematics, builder.checker(kinematics))


def charged(terms: list, x: np.ndarray = X, scene: Scene | None = None) -> list[float]:
    """What each cost of a problem costs."""
    builder, _ = builder_of(document("joint1+joint2", len(x), costs=terms), scene)
    state = state_of(builder, x)
    return [cost.measure(cost.residual.value(state)) for cost in builder.make_costs()]


def violated(terms: list, x: np.ndarray = X, scene: Scene | None = None) -> dict[str, np.ndarray]:
    """By how much each constraint of a problem is off, by name."""
    builder, _ = builder_of(document("joint1+joint2", len(x), constraints=terms), scene)
    state = state_of(builder, x)
    return {each.name: each.measure_violation(each.residual.value(state)) for each in builder.make_constraints()}


def test_joint_velocity_costs_the_squares_of_the_steps():
    # sum over t and j of c_j (q_{t+1,j} - q_{t,j})^2: both joints turn once by 90 degrees
    (cost,) = charged([term("joint_vel", coeffs=[2.0, 3.0])])
    assert cost == pytest.approx(5.0 * (np.pi / 2) ** 2)
    later, earlier = charged(
        [
            term("joint_vel", coeffs=[1.0], targets=[0.0], first_step=1, last_step=2),
            term("joint_vel", coeffs=[1.0, 4.0], targets=[0.0, 1.0], first_step=0, last_step=1),
        ]
    )
    assert later == pytest.approx((np.pi / 2) ** 2)
    assert earlier == pytest.approx(4.0 * (np.pi / 2 - 1.0) ** 2)


def test_lists_follow_the_order_of_the_manip():
    builder, _ = builder_of(document("joint2+joint1", 3, costs=[term("joint_vel", coeffs=[2.0, 3.0], last_step=1)]))
    (cost,) = builder.make_costs()
    assert cost.measure(cost.residual.value(state_of(builder, X))) == pytest.approx(2.0 * (np.pi / 2) ** 2)


def test_accelerations_and_tolerances_cost_what_lies_beyond():
    acceleration, hinge = charged(
        [
            term("joint_acc", coeffs=[1.0]),  # (pi/2, -pi/2)
            term("joint_vel", coeffs=[2.0], upper_tols=[1.0], lower_tols=[-1.0]),
        ]
    )
    assert acceleration == pytest.approx(2.0 * (np.pi / 2) ** 2)
    assert hinge == pytest.approx(2.0 * 2.0 * (np.pi / 2 - 1.0))


def test_joint_positions_cost_the_squares_of_what_they_are_off():
    original, later = charged(
        [
            term("joint_pos", vals=[1.0, 1.0], coeffs=[2.0, 0.5]),
            term("joint_pos", targets=[0.0, 1.0], coeffs=[0.0, 1.0]),
        ]
    )
    off = np.pi / 2 - 1.0
    assert original == pytest.approx(2.5 * off**2)
    assert later == pytest.approx(1.0 + 2.0 * off**2)


def test_a_pose_costs_the_absolute_errors_in_the_axes_of_its_target():
    # The target looks along y: in its axes the tip, 1 m off along x and 2 m along -y, is at (-2, -1, 0).
    turned = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    place = term("pose", link="tip", xyz=[1, 2, 0], wxyz=turned, timestep=0, rot_coeffs=[0, 0, 0])
    place["params"]["pos_coeffs"] = [10, 1, 5]
    place["params"]["xyz"] = [1.0, 2.0, 0.0]
    (cost,) = charged([place])
    assert cost == pytest.approx(10 * 2.0 + 1 * 1.0)


def test_a_turn_costs_its_angle_in_tesseract_and_half_of_it_in_the_original():
    angle = 0.2
    wxyz = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
    params = {"link": "tip", "xyz": [2, 0, 0], "wxyz": wxyz, "timestep": 0, "rot_coeffs": [7, 7, 3]}
    later, original = charged([term("cart_pose", **params), term("pose", **params)])
    assert later == pytest.approx(3 * angle)
    assert original == pytest.approx(3 * np.sin(angle / 2), rel=2e-3)  # the vector part of the quaternion


def test_what_an_offset_carries_is_brought_to_the_pose():
    params = {"link": "tip", "xyz": [2, 0.5, 0], "wxyz": [1, 0, 0, 0], "timestep": 0}
    on, off = charged(
        [term("cart_pose", tcp_xyz=[0, 0.5, 0], **params), term("cart_pose", tcp_xyz=[0, 0, 0], **params)]
    )
    assert on == pytest.approx(0.0, abs=1e-12)
    assert off == pytest.approx(0.5)


def test_a_relative_pose_is_measured_in_its_reference():
    later = {"source_frame": "tip", "target_frame": "link1", "target_frame_offset_xyz": [1, 1, 0], "timestep": 1}
    (cost,) = charged([term("cart_pose", rot_coeffs=[0, 0, 0], **later)])
    assert cost == pytest.approx(0.0, abs=1e-12)
    assert violated([term("cart_pose", rot_coeffs=[0, 0, 0], **later)])
    (cost,) = charged([term("dynamic_cart_pose", link="tip", target="link1", timestep=0, rot_coeffs=[0, 0, 0])])
    assert cost == pytest.approx(2.0)


def test_cart_vel_forbids_long_steps_and_as_a_cost_charges_both_sides():
    # The tip goes by (-1, 1) and (-2, 0).
    off = violated([term("cart_vel", link="tip", first_step=0, last_step=2, max_displacement=0.75)])
    (rows,) = off.values()
    np.testing.assert_allclose(sorted(rows[rows > 1e-9]), [0.25, 0.25, 1.25])
    (cost,) = charged([term("cart_vel", link="tip", first_step=1, last_step=2, max_displacement=0.75)])
    assert cost == pytest.approx((2.0 + 0.75) + (2.0 - 0.75) + 4 * 0.75)


def test_joint_steps_are_limited_between_their_waypoints():
    (rows,) = violated([term("joint_vel_limits", vals=[1.0, 2.0], first_step=1)]).values()
    np.testing.assert_allclose(rows[rows > 0], [np.pi / 2 - 1.0])


def _beside(gap: float) -> Scene:
    """A box beside the first link of the arm that lies along x, ``gap`` away from it."""
    return Scene((ConvexPiece("box", CUBE + np.array([0.5, -0.15 - gap, 0.0])),))


def test_collision_costs_what_a_pair_falls_short_of_dist_pen():
    x = np.array([[0.0, 0.0], [0.0, 0.0], [np.pi / 2, 0.0]])
    swept, poses, late = charged(
        [
            term("collision", coeffs=[20], dist_pen=[0.05]),
            term("collision", coeffs=[20], dist_pen=[0.05], continuous=False),
            term("collision", coeffs=[1, 2], dist_pen=[0.05, 0.1], continuous=False, first_step=1, last_step=2),
        ],
        x,
        _beside(0.03),
    )
    assert swept == pytest.approx(2 * 20 * 0.02)  # both intervals touch the pose beside the box
    assert poses == pytest.approx(2 * 20 * 0.02)  # two waypoints lie beside it
    assert late == pytest.approx(1 * 0.02)


def test_a_sweep_is_charged_where_no_waypoint_is_near():
    scene = Scene((ConvexPiece("box", CUBE + np.array([0.8, 0.6, 0.0])),))
    x = np.array([[0.0, -0.2], [np.pi / 2, 0.2]])
    swept, poses = charged(
        [
            term("collision", coeffs=[1], dist_pen=[0.01]),
            term("collision", coeffs=[1], dist_pen=[0.01], continuous=False),
        ],
        x,
        scene,
    )
    assert swept > 0.1
    assert poses == 0.0


def test_pairs_of_a_collision_term_have_their_own_distance_and_weight():
    pair = {"link": "link1", "pair": ["box"], "coeffs": [5], "dist_pen": [0.04]}
    (cost,) = charged([term("collision", coeffs=[20], dist_pen=[0.05], pairs=[pair])], X[:2], _beside(0.03))
    assert cost == pytest.approx(5 * 0.01)


def test_a_forbidden_distance_is_no_more_than_the_fixed_start_has():
    x = np.array([[0.0, 0.0], [0.1, 0.0], [0.3, 0.0]])
    (rows,) = violated([term("collision", coeffs=[20], dist_pen=[0.05])], x, _beside(0.03)).values()
    assert rows.max() <= 0.0  # the start has 30 mm, and no more than 28 mm are asked for
    (rows,) = violated([term("collision", coeffs=[20], dist_pen=[0.02])], x - [0.2, 0.0], _beside(0.03)).values()
    assert rows.max() > 0.0


def test_constraints_on_poses_are_equalities_weighed_by_their_coefficients():
    params = {"link": "tip", "xyz": [2, 0, 0], "wxyz": [1, 0, 0, 0], "pos_coeffs": [0, 3, 0], "rot_coeffs": [0, 0, 9]}
    builder, _ = builder_of(document("joint1+joint2", 3, constraints=[term("pose", timestep=1, **params)]))
    place, turn = builder.make_constraints()
    assert (place.sense, place.scale, turn.scale) == (Sense.EQUAL_ZERO, 3, 9)
    state = state_of(builder, X)
    np.testing.assert_allclose(place.residual.value(state), [1.0])
    np.testing.assert_allclose(turn.residual.value(state), [np.pi / 2])


def test_bounds_hold_what_does_not_move_what_is_fixed_and_what_joints_are_asked_for():
    data = document(
        "joint1+joint2",
        3,
        constraints=[term("joint", vals=[0.5, 1.995]), term("joint_pos", targets=[0.1], upper_tols=[0.2], last_step=1)],
        start_fixed=False,
    )
    builder, program = builder_of(data)
    lower, upper = builder.body.bounds(3, {})
    builder.narrow_bounds(lower, upper)
    np.testing.assert_allclose(lower, [[0.1, 0.1], [0.1, 0.1], [0.5, 1.995]])
    np.testing.assert_allclose(upper, [[0.3, 0.3], [0.3, 0.3], [0.5, 1.995]])
    still, _ = builder_of(document("joint2", 3))
    lower, upper = still.body.bounds(3, {})
    still.narrow_bounds(lower, upper)
    np.testing.assert_array_equal(lower[:, 0], upper[:, 0])
    assert sorted(program.fixed) == [2]


def test_on_denser_waypoints_terms_stay_at_their_steps():
    terms = [
        term("pose", link="tip", xyz=[1, 1, 0], wxyz=[1, 0, 0, 0], rot_coeffs=[0, 0, 0], timestep=1),
        term("collision", coeffs=[20, 0, 0], dist_pen=[0.05]),
    ]
    data = document("joint1+joint2", 3, costs=terms)
    denser = np.insert(X, [1, 2, 2], [[0.0, 0.3], [0.1, np.pi / 2], [0.2, np.pi / 2]], axis=0)
    timeline = Timeline.of_steps(3).insert_waypoints(X, denser)
    builder, _ = builder_of(data, _beside(0.03), timeline)
    state = state_of(builder, denser)
    pose, collision = (cost.measure(cost.residual.value(state)) for cost in builder.make_costs())
    assert pose == pytest.approx(0.0, abs=1e-9)
    assert collision == pytest.approx(2 * 20 * 0.02)  # the two intervals of the first step


def test_feet_stay_above_a_height_and_the_mass_above_a_foot_at_their_waypoint():
    robot = atlas()
    data = document(
        "active",
        3,
        constraints=[
            term("foot_height", timestep=1, link="l_foot", height=0.02),
            term("zmp", timestep=2, planted_links=["r_foot"]),
        ],
    )
    builder, program = builder_of(data, robot=robot)
    state = state_of(builder, program.init)
    *corners, balance = builder.make_constraints()
    assert len(corners) >= 4
    heights = [corner.residual.value(state)[0] for corner in corners]
    np.testing.assert_allclose(heights, 0.02, atol=1e-3)  # the sole is on the floor
    assert balance.residual.value(state).max() > 0.02  # between the feet is not above one of them
    for constraint in builder.make_constraints():
        check_jacobian(constraint.residual, lambda x: state_of(builder, x), program.init)


def test_promises_are_what_the_verifier_knows():
    wxyz = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    whole = {"link": "tip", "xyz": [1, 1, 0], "wxyz": wxyz}
    data = document(
        "joint1+joint2",
        3,
        constraints=[
            term("cart_pose", **whole, timestep=1),
            term("cart_pose", **whole, tcp_xyz=[0.5, 0, 0], timestep=1),
            term("cart_pose", **whole, rot_coeffs=[1, 1, 0], pos_coeffs=[0, 1, 0], timestep=2),
            term("cart_pose", **whole, rot_coeffs=[1, 0, 0], timestep=2),
            term("cart_vel", link="tip", first_step=0, last_step=2, max_displacement=1),
            term("joint_pos", targets=[0.5, 0.7], upper_tols=[0, 0.2], coeffs=[1, 1], first_step=1, last_step=1),
        ],
    )
    robot = chain(PLANAR)
    promises = Promises.of(program_of(robot, data), robot)
    assert promises.along == ()
    joint1, joint2, pose, offset, part, axis = promises.make_waypoint_targets(
        Timeline.of_steps(3), np.array([0.0, 0.4, 1.0])
    )
    assert isinstance(joint1, JointTarget)
    assert (joint1.joint, joint1.value, joint1.at) == ("joint1", 0.5, 0.4)
    assert isinstance(joint2, JointTarget)
    assert joint2.value == pytest.approx(0.8)
    assert joint2.tolerance == pytest.approx(0.101)
    assert isinstance(pose, PoseTarget)
    assert isinstance(offset, PoseTarget)
    np.testing.assert_allclose(offset.position, [1.0, 0.5, 0.0])  # half a metre behind, along y
    assert isinstance(part, PoseTarget)
    np.testing.assert_array_equal(np.isfinite(part.position_tolerance_m), [False, True, False])
    assert isinstance(axis, AxisTarget)
    np.testing.assert_allclose(axis.axis, [0, 0, 1], atol=1e-12)
    assert promises.notes == ("kept at the waypoints, and no part of the proof: constraints[3], constraints[4]",)


def test_a_pose_at_every_waypoint_is_promised_in_between_if_the_start_has_it():
    robot = chain(PLANAR)
    upright = {"link": "tip", "xyz": [2, 0, 0], "wxyz": [1, 0, 0, 0], "pos_coeffs": [0, 1, 0], "rot_coeffs": [1, 1, 0]}
    terms = [term("cart_pose", timestep=t, **upright) for t in (1, 2)]
    promises = Promises.of(program_of(robot, document("joint1", 3, constraints=terms)), robot)
    assert [type(target) for target in promises.make_targets()] == [PoseTarget, AxisTarget]
    assert promises.make_waypoint_targets(Timeline.of_steps(3), np.arange(3.0)) == ()
    place, axis = (hold(np.array([0, 1, 2])) for hold in promises.make_holds())
    state = contact_free_state(robot)(X)
    np.testing.assert_allclose(place.value(state), [0.0, 1.0, 1.0], atol=1e-12)
    dense = place.linearize(state).jacobian.toarray()
    np.testing.assert_allclose(dense[0], [2.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)  # joint2 is not in the manip
    assert not dense[:, 1::2].any()
    assert len(axis.value(state)) == 6
    tilted = {**upright, "wxyz": [np.cos(0.1), np.sin(0.1), 0, 0]}
    terms = [term("cart_pose", timestep=t, **tilted) for t in (1, 2)]
    assert Promises.of(program_of(robot, document("joint1", 3, constraints=terms)), robot).along == ()


def test_masked_rows_have_the_derivatives_of_what_moves_and_no_other():
    robot = chain(SPATIAL)
    x = random_configurations(robot, np.random.default_rng(7), 3)
    pose = FramePose(robot, "tip", [0, 2], np.eye(4))
    state = contact_free_state(robot)(x)
    moves = np.array([True, False, True, False])
    masked = Masked(pose, moves).linearize(state)
    dense = pose.linearize(state).jacobian.toarray()
    np.testing.assert_array_equal(masked.jacobian.toarray(), dense * np.tile(moves, 3))
    np.testing.assert_array_equal(masked.value, Masked(pose, moves).value(state))
    np.testing.assert_array_equal(masked.value, pose.value(state))
