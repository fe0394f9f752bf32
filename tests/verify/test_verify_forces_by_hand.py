"""Forces, ZMP and torques worked out by hand: masses on slides, rotors and two-legged stands, all off the origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import CUBE, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot.model import LinkBody, RobotModel
from costs.scene import Scene
from service.verify import Basis, Check, Motion, Phase, PlantedContact, SupportPolygon, VerifySettings, verify
from service.verify.forces.dynamics import check_dynamics, compute_forces, list_sample_times
from service.verify.prepared_motion import PreparedMotion

G, MASS, HEIGHT = 9.81, 7.0, 0.05
OFFSET = np.array([0.3, -0.2, 0.9])  # of the centre of mass at coordinates 0
WIDE = 10.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
TIMES = np.array([0.0, 0.4, 1.0])


def _gantry() -> RobotModel:
    """A point mass on slides along x, y and z."""
    model = pin.Model()
    for kind in (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ):
        model.addJoint(model.njoints - 1, kind(), pin.SE3.Identity(), f"slide{model.njoints}")
    model.appendBodyToJoint(3, pin.Inertia(MASS, OFFSET, np.zeros((3, 3))), pin.SE3.Identity())
    return robot_of(model, [])


def _accelerated(robot: RobotModel, acceleration: np.ndarray, support: np.ndarray = WIDE) -> Motion:
    """From rest at coordinates 0, one second of constant accelerations."""
    line = Curve(np.arange(2.0), np.stack([np.zeros(robot.n), 0.5 * acceleration]), np.tile(0.5 * acceleration, (2, 1)))
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    phase = Phase("go", 0.0, 1.0, support=SupportPolygon(support, 0.0, HEIGHT))
    return Motion(robot, Scene(), line, law, (phase,))


def _forces(motion: Motion, times: np.ndarray = TIMES) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wrench, torque and ZMP."""
    assert motion.law is not None
    found = compute_forces(motion, motion.law, motion.phases[0], times)
    np.testing.assert_array_equal(found.times, times)
    return found.wrench[0], found.torque[0], found.zmp(HEIGHT)[0]


def _checks(motion: Motion) -> dict[str, Check]:
    assert motion.law is not None
    checks = check_dynamics(PreparedMotion(motion), motion.phases[0], VerifySettings())
    return {check.name: check for check in checks}


@pytest.mark.parametrize("height", [0.0, 0.05, -0.4, 2.0])
def test_at_rest_the_zmp_is_below_the_centre_of_mass_on_any_plane(height: float) -> None:
    motion = _accelerated(_gantry(), np.zeros(3))
    assert motion.law is not None
    found = compute_forces(motion, motion.law, motion.phases[0], TIMES)
    np.testing.assert_allclose(found.zmp(height)[0], np.tile(OFFSET[:2], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(found.wrench[0, 1, :3], [0.0, 0.0, MASS * G])
    # The moment about the origin: c x f.
    np.testing.assert_allclose(found.wrench[0, 1, 3:], MASS * G * np.array([OFFSET[1], -OFFSET[0], 0.0]))


@pytest.mark.parametrize(
    "acceleration",
    [(1.5, 0.0, 0.0), (-1.5, 0.0, 0.0), (0.0, 0.8, 0.0), (0.0, -0.8, 0.0), (0.0, 0.0, 2.0), (1.1, -0.6, -3.0)],
)
def test_an_accelerated_mass_moves_the_zmp_back_by_its_height_over_gravity(
    acceleration: tuple[float, float, float],
) -> None:
    a = np.array(acceleration)
    wrench, torque, zmp = _forces(_accelerated(_gantry(), a))
    centre = OFFSET + 0.5 * a * TIMES[:, None] ** 2
    expected = centre[:, :2] - (centre[:, 2:] - HEIGHT) * a[:2] / (G + a[2])
    np.testing.assert_allclose(zmp, expected, atol=1e-9)
    force = MASS * (a + np.array([0.0, 0.0, G]))
    np.testing.assert_allclose(wrench[:, :3], np.tile(force, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(wrench[:, 3:], np.cross(centre, force), atol=1e-9)
    np.testing.assert_allclose(torque, np.tile(force, (3, 1)), atol=1e-9)  # each slide carries what moves it


def test_the_zmp_by_numbers() -> None:
    # 0.85 m above the plane, 1.962 m/s^2 = g / 5 along x, then along -y: 0.17 m back each.
    for a, expected in (([1.962, 0.0, 0.0], [0.13, -0.2]), ([0.0, -1.962, 0.0], [0.3, -0.03])):
        zmp = _forces(_accelerated(_gantry(), np.array(a)), np.zeros(1))[2]
        np.testing.assert_allclose(zmp, [expected], atol=1e-12)


@pytest.mark.parametrize(("axis", "shift"), [(0, (0.0, 1.0)), (1, (-1.0, 0.0)), (2, (0.0, 0.0))])
def test_a_rotor_that_is_sped_up_moves_the_zmp_sideways(axis: int, shift: tuple[float, float]) -> None:
    # The ground's moment about the rotor's centre is I alpha: along x it needs the force at +y, along y at -x.
    model = pin.Model()
    kind = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)[axis]
    joint = model.addJoint(0, kind(), pin.SE3(np.eye(3), OFFSET), "rotor")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.diag([0.2, 0.3, 0.4])), pin.SE3.Identity())
    alpha = 12.0
    wrench, torque, zmp = _forces(_accelerated(robot_of(model, []), np.array([alpha])))
    inertia = (0.2, 0.3, 0.4)[axis]
    expected = OFFSET[:2] + np.array(shift) * inertia * alpha / (MASS * G)
    np.testing.assert_allclose(zmp, np.tile(expected, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(torque, inertia * alpha, atol=1e-9)
    moment = np.cross(OFFSET, [0.0, 0.0, MASS * G]) + inertia * alpha * np.eye(3)[axis]
    np.testing.assert_allclose(wrench[:, 3:], np.tile(moment, (3, 1)), atol=1e-9)


def test_a_turning_mass_pulls_the_zmp_outwards_as_it_speeds_up() -> None:
    # On a turntable 1 m from the axis, at angle 0: the force is -m w^2 along x and m alpha along y.
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.array([1.0, 0.0, 0.9]), np.zeros((3, 3))), pin.SE3.Identity())
    curve = Curve(np.arange(2.0), np.array([[0.0], [1.0]]), np.ones((2, 1)))
    law = TimeLaw(np.array([0.0, 2.0 / 5.0]), np.array([0.0, 1.0]), np.array([2.0, 3.0]))
    phase = Phase("go", 0.0, 1.0, support=SupportPolygon(WIDE, 0.0, HEIGHT))
    _, torque, zmp = _forces(Motion(robot_of(model, []), Scene(), curve, law, (phase,)), np.zeros(1))
    w, alpha = 2.0, 2.5
    np.testing.assert_allclose(zmp, [[1.0 + 0.85 * w**2 / G, -0.85 * alpha / G]], atol=1e-9)
    np.testing.assert_allclose(torque, [[MASS * alpha]], atol=1e-9)


def test_a_mass_that_falls_faster_than_gravity_has_no_zmp_and_is_refused() -> None:
    motion = _accelerated(_gantry(), np.array([0.0, 0.0, -12.0]))
    assert np.all(np.isnan(_forces(motion)[2]))
    check = _checks(motion)["zmp.go"]
    assert not check.ok
    assert check.value == -np.inf


def test_what_the_task_moves_does_not_press_on_the_ground() -> None:
    model = _gantry().model.copy()
    wheel = model.addJoint(0, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([2.0, 1.0, 1.0])), "wheel")
    model.appendBodyToJoint(wheel, pin.Inertia(30.0, np.array([0.0, 0.1, 0.0]), np.eye(3)), pin.SE3.Identity())
    robot = robot_of(model, [LinkBody("wheel/rim", "wheel", wheel, CUBE * 0.1, CUBE * 0.1)])
    motion = replace(_accelerated(robot, np.zeros(4)), mechanism_links=frozenset({"wheel"}))
    wrench, torque, zmp = _forces(motion)
    np.testing.assert_allclose(zmp, np.tile(OFFSET[:2], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(wrench[:, 2], MASS * G)
    np.testing.assert_allclose(torque[:, 3], 30.0 * G * 0.1)  # its own weight on its own joint
    both = replace(motion, mechanism_links=frozenset())
    np.testing.assert_allclose(_forces(both)[0][:, 2], (MASS + 30.0) * G)


def _walker() -> RobotModel:
    """A floating mass on two legs of a hip and a sliding knee each; feet ``left`` and ``right`` below, ahead, apart."""
    model = pin.Model()
    base = pin.JointModelComposite()
    base.addJoint(pin.JointModelTranslation())
    base.addJoint(pin.JointModelSphericalZYX())
    trunk = model.addJoint(0, base, pin.SE3.Identity(), "base")
    model.appendBodyToJoint(trunk, pin.Inertia(20.0, np.array([0.02, 0.03, 0.3]), 0.5 * np.eye(3)), pin.SE3.Identity())
    turn = pin.exp3(np.array([0.2, -0.4, 0.3]))
    for name, place in (("left", (0.05, 0.2, -0.1)), ("right", (-0.04, -0.15, -0.1))):
        hip = model.addJoint(trunk, pin.JointModelRY(), pin.SE3(turn, np.array(place)), f"{name}_hip")
        knee = model.addJoint(hip, pin.JointModelPZ(), pin.SE3(turn.T, np.array([0.0, 0.1, -0.3])), f"{name}_knee")
        model.appendBodyToJoint(knee, pin.Inertia(2.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
        foot = pin.SE3(np.eye(3), np.array([0.1, 0.02, -0.4 if name == "left" else -0.3]))
        model.addFrame(pin.Frame(name, knee, 0, foot, pin.FrameType.OP_FRAME))
    return robot_of(model, [], is_floating=True)


def _foot_place(robot: RobotModel, q: np.ndarray, foot: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(foot)].copy()


@pytest.mark.parametrize("feet", [("left", "right"), ("right", "left"), ("right",), ()])
def test_joints_carry_the_feet_s_least_share_of_the_ground_s_wrench(feet: tuple[str, ...]) -> None:
    robot = _walker()
    start = np.array([0.7, -0.4, 0.8, 0.3, 0.1, -0.2, 0.25, 0.02, -0.3, 0.05])
    acceleration = np.array([0.4, -0.3, 0.5, 0.2, 0.3, -0.4, 0.6, 0.1, -0.5, 0.2])
    motion = _accelerated(robot, acceleration)
    motion = replace(motion, curve=replace(motion.curve, positions=motion.curve.positions + start))
    contacts = [PlantedContact(foot, _foot_place(robot, start, foot).homogeneous, np.zeros((1, 3))) for foot in feet]
    free, unloaded, _ = _forces(motion, np.zeros(1))
    motion = replace(motion, phases=(replace(motion.phases[0], contacts=tuple(contacts)),))
    wrench, torque, _ = _forces(motion, np.zeros(1))
    np.testing.assert_allclose(wrench, free)
    # Least squares over all feet's forces and moments (a moment weighs as a tenth of a metre's force): their sum is the
    # ground's wrench about the origin.
    places = [contact.pose_world_link[:3, 3] for contact in contacts]
    rows = np.zeros((6, 6 * len(feet)))
    for k, place in enumerate(places):
        rows[:3, 6 * k : 6 * k + 3] = np.eye(3)
        rows[3:, 6 * k : 6 * k + 3] = np.array([np.cross(place, unit) for unit in np.eye(3)]).T
        rows[3:, 6 * k + 3 : 6 * k + 6] = 0.1 * np.eye(3)
    shares = np.linalg.lstsq(rows, wrench[0], rcond=None)[0].reshape(-1, 6) if feet else np.zeros((0, 6))
    # What a foot's force does at a joint: how far the joint moves the foot along it; the base carries what is left.
    expected = unloaded[0].copy()
    for foot, share in zip(feet, shares, strict=True):
        for j in range(robot.n):
            step = 1e-6 * np.eye(robot.n)[j]
            ahead, behind = _foot_place(robot, start + step, foot), _foot_place(robot, start - step, foot)
            travel = (ahead.translation - behind.translation) / 2e-6
            turn = pin.log3(ahead.rotation @ behind.rotation.T) / 2e-6
            expected[j] -= share[:3] @ travel + 0.1 * share[3:] @ turn
    np.testing.assert_allclose(torque[0], expected, atol=1e-5)
    if feet:
        assert np.abs(torque[0, :6]).max() < 1e-8
        assert np.abs(unloaded[0] - torque[0])[6:].max() > 1.0


def test_forces_without_torques_are_the_same_wrench() -> None:
    motion = _accelerated(_gantry(), np.array([1.0, 2.0, 0.5]))
    assert motion.law is not None
    short = compute_forces(motion, motion.law, motion.phases[0], TIMES, torques=False)
    np.testing.assert_allclose(short.wrench[0], _forces(motion)[0])
    np.testing.assert_allclose(short.path, TIMES**2)


def test_the_worst_zmp_is_told_with_its_place() -> None:
    # It ends 0.7 m along x where the polygon ends at 0.6: 0.1 m outside; at the start 0.13 m, well inside.
    polygon = np.array([[-0.5, -0.5], [0.6, -0.5], [0.6, 0.5], [-0.5, 0.5]])
    motion = _accelerated(_gantry(), np.array([1.14, 0.0, 0.0]), polygon)
    end = 0.3 + 0.57 - 0.85 * 1.14 / G
    check = _checks(motion)["zmp.go"]
    assert not check.ok
    assert check.value == pytest.approx(0.6 - end, abs=1e-9)
    assert check.basis is Basis.SAMPLES
    assert check.limit == 0.0
    assert check.where is not None
    assert check.where.s == check.where.time_s == 1.0
    assert check.where.position == pytest.approx((end, -0.2, HEIGHT))
    assert "is 171.2 mm outside the feet during go" in check.text
    wide = _checks(_accelerated(_gantry(), np.array([1.14, 0.0, 0.0]), polygon + np.array([0.5, 0.0])))["zmp.go"]
    assert wide.ok
    assert "stays" in wide.text


def test_the_zmp_check_needs_a_support_and_the_torque_check_a_limit() -> None:
    motion = _accelerated(_gantry(), np.array([1.0, 0.0, 0.0]))
    assert list(_checks(motion)) == ["zmp.go", "torque.go"]
    unsupported = replace(motion, phases=(Phase("go", 0.0, 1.0),))
    assert list(_checks(unsupported)) == ["torque.go"]
    boundless = replace(motion, robot=replace(motion.robot, effort=np.array([np.inf, 0.0, np.inf])))
    assert list(_checks(boundless)) == ["zmp.go"]


@pytest.mark.parametrize(("sign", "ok"), [(1.0, True), (-1.0, True), (1.3, False), (-1.3, False)])
def test_the_greatest_torque_is_told_with_its_joint(sign: float, ok: bool) -> None:
    # Slides along x and y need 7 and 14 N; what carries the weight has no limit.
    motion = _accelerated(_gantry(), sign * np.array([1.0, 2.0, 0.0]))
    motion = replace(motion, robot=replace(motion.robot, effort=np.array([20.0, 16.0, np.inf])))
    check = _checks(motion)["torque.go"]
    assert check.ok is ok
    assert check.value == pytest.approx(abs(sign) * 14.0 / 16.0)
    assert check.limit == 1.0
    assert check.text.startswith(f"joint1 needs {abs(sign) * 87.5:.0f} % of its torque during go")
    assert check.where is not None
    assert check.where.names == ("joint1",)


def test_the_greatest_torque_is_told_with_its_moment() -> None:
    # ds/dt rises, so that the slide's quadratic path needs most at its end.
    curve = Curve(np.arange(2.0), np.array([[0.0] * 3, [1.0, 0.0, 0.0]]), np.array([[0.0] * 3, [2.0, 0.0, 0.0]]))
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    motion = Motion(_gantry(), Scene(), curve, law, (Phase("go", 0.0, 1.0),))
    motion = replace(motion, robot=replace(motion.robot, effort=np.array([100.0, np.inf, np.inf])))
    check = _checks(motion)["torque.go"]
    # x = s^2 = t^4: 12 t^2.
    assert check.value == pytest.approx(12.0 * MASS / 100.0)
    assert check.where is not None
    assert check.where.s == check.where.time_s == 1.0


def test_samples_of_a_phase_lie_within_it_on_both_sides_of_every_jump() -> None:
    curve = Curve(np.array([0.0, 1.0, 2.0, 4.0]), np.zeros((4, 3)), np.zeros((4, 3)))
    law = TimeLaw(np.array([0.0, 0.5, 1.5, 3.5, 4.0]), np.array([0.0, 0.5, 1.5, 3.5, 4.0]), np.ones(5))
    motion = Motion(_gantry(), Scene(), curve, law)
    times = list_sample_times(motion, law, 1.0, 3.0, 0.4)
    assert (times[0], times[-1]) == (1.0, 3.0)
    assert np.diff(times).max() <= 0.4
    jumps = np.array([1.0 + 1e-7, 1.5 - 1e-7, 1.5 + 1e-7, 2.0 - 1e-7, 2.0 + 1e-7])
    assert np.abs(times[:, None] - jumps).min(axis=0).max() < 1e-9
    even = np.linspace(1.0, 3.0, 6)
    assert np.abs(times[:, None] - even).min(axis=0).max() < 1e-12
    assert len(times) == len(jumps) + len(even)
    assert len(list_sample_times(motion, law, 1.1, 1.2, 1.0)) == 2


@pytest.mark.parametrize("border", [1.5, 2.0])  # a point of the law, a knot
def test_the_near_side_of_a_jump_at_a_phase_s_border_is_sampled(border: float) -> None:
    curve = Curve(np.array([0.0, 2.0, 4.0]), np.zeros((3, 3)), np.zeros((3, 3)))
    law = TimeLaw(np.array([0.0, 1.5, 4.0]), np.array([0.0, 1.5, 4.0]), np.ones(3))
    motion = Motion(_gantry(), Scene(), curve, law)
    before, after = (list_sample_times(motion, law, *ends, 10.0) for ends in ((0.5, border), (border, 3.5)))
    assert np.abs(before - (border - 1e-7)).min() < 1e-9
    assert np.abs(after - (border + 1e-7)).min() < 1e-9
    assert before.max() == border == after.min()


def test_on_the_very_edge_is_inside_and_at_the_very_limit_is_within() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(1, pin.Inertia(8.0, np.array([0.25, -0.5, 1.0]), np.zeros((3, 3))), pin.SE3.Identity())
    robot = replace(robot_of(model, []), effort=np.array([0.5]))
    square = np.array([[0.0, -1.0], [0.25, -1.0], [0.25, 0.0], [0.0, 0.0]])
    still = _checks(_accelerated(robot, np.zeros(1), square))["zmp.go"]
    assert still.value == 0.0
    assert still.ok
    assert "stays" in still.text
    pushed = _checks(_accelerated(robot, np.array([0.0625])))["torque.go"]
    assert pushed.value == 1.0
    assert pushed.ok


@pytest.mark.parametrize(
    ("effort", "names"), [((9.0, 9.0, 9.0), None), ((0.0, 9.0, np.inf), "joint0, joint2"), ((0.0,) * 3, None)]
)
def test_a_note_names_joints_without_a_torque_limit_where_others_have_one(
    effort: tuple[float, ...], names: str | None
) -> None:
    motion = _accelerated(_gantry(), np.zeros(3))
    notes = verify(replace(motion, robot=replace(motion.robot, effort=np.array(effort)))).notes
    told = [note for note in notes if note.startswith("torque not checked for")]
    assert told == ([] if names is None else [f"torque not checked for {names}: their limit is 0 or missing"])
