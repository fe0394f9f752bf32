"""Physics whose answers are known by hand: weights, sags, friction, springs and latches."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_robots import box, floating_joint, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot import LinkInertia, MechanismJoint, Release, RobotModel, with_mechanism
from costs.robot.mesh.hull import make_outer_hull
from costs.robot.model import LinkBody
from costs.scene import ConvexPiece, Scene
from service.demands.moved_object.assumed import measure_volume
from service.demands.moved_object.loads import MovedObject
from service.demands.resistance import MechanismPhysics, Resistance
from service.errors import RequestError, ResultError
from service.execution.driver import JointCommand
from service.execution.reference import PlannedReference
from service.simulation.hulls import find_level_top, shrink_hull
from service.simulation.model import PhysicsModel, build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.verify import Motion, Phase, PlantedContact

MASS, ARM, G = 4.0, 0.5, 9.81
CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])


def a_body(name: str, joint: int, vertices: np.ndarray) -> LinkBody:
    return LinkBody(name, name, joint, vertices, make_outer_hull(vertices))


def pendulum() -> RobotModel:
    """A mass at the end of a massless rod that turns about y at the world's origin; at 0 the rod is along x."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint0")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.array([ARM, 0.0, 0.0]), 1e-3 * np.eye(3)), pin.SE3.Identity())
    return robot_of(model, [a_body("rod", joint, 0.2 * CUBE + [ARM, 0.0, 0.0])])


def crate() -> RobotModel:
    """A floating box of 4 kg whose mass is off its middle, without joints."""
    model = pin.Model()
    joint = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    lever = np.array([0.03, 0.0, 0.0])
    model.appendBodyToJoint(joint, pin.Inertia(MASS, lever, 0.02 * np.eye(3)), pin.SE3.Identity())
    model.addJointFrame(joint)
    model.addBodyFrame("crate", joint, pin.SE3.Identity(), -1)
    return robot_of(model, [a_body("crate", joint, CUBE)], is_floating=True)


def resting(robot: RobotModel, q: np.ndarray, scene: Scene | None = None, **more: object) -> Motion:
    """A motion of two seconds that stays where it is."""
    q = np.asarray(q, dtype=float)
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 0.0]))
    curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, len(q))))
    return Motion(robot, scene or Scene(()), curve, law, mechanism_links=robot.mechanism_links, **more)  # type: ignore[arg-type]


def simulated(motion: Motion, physics: MechanismPhysics | None = None, **more: float) -> SimulatedRobot:
    options = SimulationOptions(**more)  # type: ignore[arg-type]
    stiffness = {"joint0": 2000.0} if "joint0" in motion.robot.joint_names else {}
    model = build_physics(motion, physics or MechanismPhysics({}), options, stiffness)
    return SimulatedRobot(model, motion.curve.positions[0], options)


def follow(robot: SimulatedRobot, q: np.ndarray, tau: np.ndarray, seconds: float) -> None:
    q, tau = np.asarray(q, dtype=float), np.asarray(tau, dtype=float)
    for _ in range(round(seconds / robot.period_s)):
        robot.command(JointCommand(q, np.zeros_like(q), tau))


def test_a_pendulum_sags_by_its_torque_over_the_stiffness() -> None:
    robot = simulated(resting(pendulum(), [0.0]), feed_forward=0.0)
    follow(robot, [0.0], [0.0], 3.0)
    # kp q = m g L cos(q): about y, a positive angle lowers the rod.
    assert robot.read().q[0] == pytest.approx(MASS * G * ARM / 2000.0, rel=1e-3)
    assert robot.torque[0] == pytest.approx(-MASS * G * ARM, rel=1e-3)


def test_the_torque_fed_forward_takes_the_sag_away_and_half_of_it_half() -> None:
    sags = []
    for share in (1.0, 0.5):
        robot = simulated(resting(pendulum(), [0.0]), feed_forward=share)
        follow(robot, [0.0], [-MASS * G * ARM], 3.0)
        sags.append(robot.read().q[0])
    assert sags[0] == pytest.approx(0.0, abs=1e-6)
    assert sags[1] == pytest.approx(0.5 * MASS * G * ARM / 2000.0, rel=1e-3)


def test_the_servo_pushes_by_its_law_in_its_first_step() -> None:
    robot = simulated(resting(pendulum(), [0.0]), feed_forward=0.5)
    robot.command(JointCommand(np.array([0.001]), np.array([0.2]), np.array([3.0])))
    # Kp (q_d - q) + Kd (qd_d - qd) + Kf tau_d with Kd = 0.03 Kp, at rest at 0.
    assert robot.torque[0] == pytest.approx(2000.0 * 0.001 + 60.0 * 0.2 + 0.5 * 3.0, rel=1e-6)


def test_a_servo_gives_no_more_than_its_effort_and_goes_no_faster_than_its_joint() -> None:
    robot = simulated(resting(pendulum(), [0.0]))
    far = JointCommand(np.array([9.0]), np.zeros(1), np.array([1e6]))
    robot.command(far)
    assert robot.torque[0] == 1e3
    robot = simulated(resting(pendulum(), [0.0]))
    robot.command(JointCommand(np.array([9.0]), np.zeros(1), np.zeros(1)))
    # 10 rad/s for a millisecond is all that the desired position moves.
    assert robot.torque[0] == pytest.approx(2000.0 * 0.01, rel=1e-6)


def test_a_delayed_command_arrives_later_by_its_delay() -> None:
    robot = simulated(resting(pendulum(), [0.0]), delay_ms=5.0, feed_forward=1.0)
    command = JointCommand(np.zeros(1), np.zeros(1), np.array([7.0]))
    pushed = []
    for _ in range(8):
        robot.command(command)
        pushed.append(float(robot.torque[0]))
    rises = np.diff(pushed) > 5.0
    assert rises.tolist() == [False] * 4 + [True] + [False] * 2  # between the fifth and the sixth step


def test_noise_is_the_same_for_the_same_seed() -> None:
    def read(seed: int) -> np.ndarray:
        robot = simulated(resting(pendulum(), [0.0]), noise=1.0, seed=seed)
        follow(robot, [0.0], [0.0], 0.01)
        return robot.read().q

    assert read(1) == read(1)
    assert read(1) != read(2)


def floor() -> ConvexPiece:
    return ConvexPiece("floor", box("floor", (0.0, 0.0, -0.1), (2.0, 2.0, 0.1)).vertices, "floor")


def test_the_ground_carries_a_box_by_its_weight_at_its_centre_of_mass() -> None:
    sole = np.array([[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.2, 0.2)])
    pose = np.eye(4)
    pose[2, 3] = 0.05
    phase = Phase("rest", 0.0, 1.0, (PlantedContact("crate", pose, sole),))
    motion = resting(crate(), [0.0, 0.0, 0.05, 0.0, 0.0, 0.0], Scene((floor(),)), phases=(phase,))
    robot = simulated(motion)
    follow(robot, [], [], 1.0)
    wrench = robot.measure_contact_wrenches()["crate"]
    assert wrench[2] == pytest.approx(MASS * G, rel=1e-3)
    assert wrench[4] == pytest.approx(-0.03 * MASS * G, rel=2e-2)  # the moment of a force that acts 3 cm ahead
    assert np.linalg.norm(wrench[:2]) < 0.5
    assert robot.pose_world_base[2, 3] == pytest.approx(0.05, abs=1e-3)
    # The plan's own forces say the same.
    planned = PlannedReference(motion).at(1.0).contact_wrenches["crate"]
    assert planned[:3] == pytest.approx([0.0, 0.0, MASS * G], abs=0.05)
    assert planned[4] == pytest.approx(-0.03 * MASS * G, abs=0.01)
    # Gravity is all that its inertial unit feels.
    assert robot.read().imu_acceleration == pytest.approx([0.0, 0.0, G], abs=0.1)


def mechanism(kind: str = "revolute", **more: float) -> Motion:
    """The pendulum beside a wheel (or slide) and a lever that it never touches."""
    wheel = MechanismJoint(
        "turn", "wheel", np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]),
        {"wheel/1": CUBE + np.array([3.0, 0.0, 0.0])}, kind=kind, lower=-1.0, upper=1.0,  # type: ignore[arg-type]
    )  # fmt: skip
    lever = MechanismJoint(
        "lever", "wheel/lever", np.array([3.2, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]),
        {"wheel/lever/1": 0.5 * CUBE + np.array([3.3, 0.0, 0.0])}, parent="wheel", lower=-1.0, upper=1.0,
    )  # fmt: skip
    robot = with_mechanism(pendulum(), [wheel, lever])
    releases = (Release("turn", "lever", 0.5, 0.1),) if more.get("is_latched") else ()
    return resting(robot, [0.0, 0.0, 0.0], releases=releases)


def push(robot: SimulatedRobot, forces: Mapping[str, float], seconds: float) -> dict[str, float]:
    """Push the mechanism's joints by given torques; springs write to the same place, so add to them."""
    model: PhysicsModel = robot.model
    mj_step = robot.mujoco.mj_step
    command = JointCommand(np.zeros(1), np.zeros(1), np.zeros(1))
    for _ in range(round(seconds / robot.period_s)):
        robot._apply(command)
        robot.data.qfrc_applied[:] = 0.0
        robot._oppose()
        for name, force in forces.items():
            robot.data.qfrc_applied[model.moved_dof[model.moved_names.index(name)]] += force
        mj_step(model.mj, robot.data)
    return robot.mechanism


def test_a_wheel_with_friction_stays_where_nobody_pushes_harder() -> None:
    physics = MechanismPhysics({"turn": Resistance(friction=10.0)})
    robot = simulated(mechanism(), physics)
    assert abs(push(robot, {"turn": 9.5}, 1.0)["turn"]) < 1e-3
    assert push(robot, {"turn": 11.0}, 1.0)["turn"] > 0.05


def test_a_spring_holds_its_joint_up_to_its_preload_and_by_its_stiffness_beyond() -> None:
    physics = MechanismPhysics({"turn": Resistance(preload=2.0, stiffness=10.0)})
    robot = simulated(mechanism(), physics)
    assert abs(push(robot, {"turn": 1.0}, 3.0)["turn"]) < 0.01
    assert push(robot, {"turn": 5.0}, 12.0)["turn"] == pytest.approx(0.3, abs=0.01)
    assert abs(push(robot, {}, 12.0)["turn"]) < 0.01


def test_a_spring_may_be_under_tension_where_the_motion_begins() -> None:
    robot = simulated(mechanism(), MechanismPhysics({"turn": Resistance(stiffness=10.0, rest=0.5)}))
    assert push(robot, {}, 12.0)["turn"] == pytest.approx(0.5, abs=0.01)


def test_a_mass_that_the_file_states_falls_as_its_weight_makes_it() -> None:
    """3 kg on a slide that rises by 30 deg: sin(30 deg) g / 2 per squared second; without its mass it stays."""
    slide = MechanismJoint(
        "turn", "wheel", np.array([3.0, 0.0, 0.0]), np.array([np.cos(np.pi / 6), 0.0, 0.5]),
        {"wheel/1": CUBE + np.array([3.0, 0.0, 0.0])}, kind="prismatic", lower=-9.0, upper=9.0,
    )  # fmt: skip
    motion = resting(with_mechanism(pendulum(), [slide]), [0.0, 0.0])
    inertia = LinkInertia(3.0, np.zeros(3), 1e-3 * np.eye(3))
    free = MechanismPhysics({}, inertias={"turn": inertia})
    assert push(simulated(motion, free), {}, 0.5)["turn"] == pytest.approx(-0.5 * 0.5 * G * 0.5**2, rel=0.02)
    held = MechanismPhysics({"turn": Resistance(friction=15.0)}, inertias={"turn": inertia})
    assert abs(push(simulated(motion, held), {}, 0.5)["turn"]) < 1e-4
    assert abs(push(simulated(motion), {}, 0.5)["turn"]) < 1e-6


def test_damping_lets_a_joint_move_as_fast_as_the_push_allows() -> None:
    """8 N m at 20 N m s/rad: 0.4 rad/s."""
    robot = simulated(mechanism(), MechanismPhysics({"turn": Resistance(damping=20.0)}))
    before = push(robot, {"turn": 8.0}, 0.5)["turn"]
    assert push(robot, {"turn": 8.0}, 1.0)["turn"] - before == pytest.approx(0.4, rel=0.02)


def test_a_moment_of_inertia_that_the_file_states_is_sped_up_by_a_torque() -> None:
    """200 N m on 125 kg m^2 (25 about the centre of mass, and 100 kg 1 m off) for half a second: 0.2 rad."""
    inertia = LinkInertia(100.0, np.array([1.0, 0.0, 0.0]), 25.0 * np.eye(3))
    robot = simulated(mechanism(), MechanismPhysics({}, inertias={"turn": inertia}))
    assert push(robot, {"turn": 200.0}, 0.5)["turn"] == pytest.approx(0.5 * 200.0 / 125.0 * 0.25, rel=0.02)


@pytest.mark.parametrize("seed", range(12))
def test_physics_agrees_on_whether_an_object_rests_without_a_hand(seed: int) -> None:
    """Random chains of two joints with masses, with friction 5 % more and less than what they need, or at a stop."""
    random = np.random.default_rng(seed)
    joints, parent = [], None
    for k in range(2):
        origin = np.array([3.0 + k, 0.0, 0.0])
        inertia = LinkInertia(random.uniform(1.0, 9.0), origin + random.uniform(-0.5, 0.5, 3), 0.2 * np.eye(3))
        joints.append(
            MechanismJoint(
                f"j{k}", f"l{k}", origin, random.normal(size=3), {f"l{k}/1": CUBE + origin},
                kind=("revolute", "prismatic")[int(random.integers(2))], parent=parent,  # type: ignore[arg-type]
                lower=-0.5, upper=0.5, inertia=inertia,
            )
        )  # fmt: skip
        parent = f"l{k}"
    values = np.array([random.choice([-0.5, 0.0, 0.5]), 0.0])
    stops = {joint.name: (joint.lower, joint.upper) for joint in joints}
    loads = MovedObject(tuple(joints), stops=stops).bound_move(values, values).still[0]

    for share, moves in ((1.05, False), (0.95, True)):
        rough = [replace(joint, friction=share * abs(load)) for joint, load in zip(joints, loads, strict=True)]
        unheld = MovedObject(tuple(rough), stops=stops).find_unheld(values, values)
        physics = MechanismPhysics(
            {joint.name: Resistance(friction=joint.friction) for joint in rough},
            inertias={
                joint.name: replace(joint.inertia, centre=joint.inertia.centre - joint.origin) for joint in rough
            },
        )
        robot = simulated(resting(with_mechanism(pendulum(), joints), [0.0, *values]), physics)
        at = push(robot, {}, 1.0)
        moved = max(abs(at[f"j{k}"] - values[k]) for k in range(2))
        assert (unheld is not None) == moves  # the second joint is never at a stop
        assert (moved > 5e-3) == moves, (moved, unheld)


def test_a_latch_holds_until_its_lever_is_turned_and_again_when_both_are_back() -> None:
    robot = simulated(mechanism(is_latched=True))
    assert abs(push(robot, {"turn": 20.0}, 0.5)["turn"]) < 0.01
    assert push(robot, {"lever": 1.0}, 1.0)["lever"] > 0.5
    assert push(robot, {"lever": 1.0, "turn": 5.0}, 1.0)["turn"] > 0.1
    assert push(robot, {"lever": -1.0}, 1.0)["lever"] < 0.4
    assert push(robot, {"turn": 5.0}, 0.3)["turn"] > 0.1  # past free_beyond the lever does not matter
    robot.place(np.zeros(3))
    assert abs(push(robot, {"turn": 20.0}, 0.3)["turn"]) < 0.01


def test_what_cannot_be_carried_out_is_refused_in_one_line() -> None:
    motion = resting(pendulum(), [0.0])
    untimed = Motion(motion.robot, motion.scene, motion.curve)
    with pytest.raises(ResultError, match=r"^the result has no time law; plan it again with options.timed: true$"):
        PlannedReference(untimed)
    massless = pin.Model()
    joint = massless.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint0")
    bare = robot_of(massless, [a_body("rod", joint, CUBE)])
    with pytest.raises(ResultError, match=r"^robot 'small' has no masses; give its links an <inertial> in the URDF$"):
        PlannedReference(resting(bare, [0.0]))
    weak = pendulum()
    weak.effort[0] = np.inf
    with pytest.raises(ResultError, match=r"^robot 'small': joint 'joint0' has no effort limit"):
        PlannedReference(resting(weak, [0.0]))
    with pytest.raises(ResultError, match=r"plants no link; a floating robot would fall$"):
        PlannedReference(resting(crate(), np.zeros(6)))


def test_without_mujoco_a_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ResultError, match=r"^a simulation needs MuJoCo, which is not installed; pip install"):
        simulated(resting(pendulum(), [0.0]))


@pytest.mark.parametrize(
    ("field", "value"), [("friction", -1.0), ("feed_forward", 1.5), ("noise", float("nan")), ("delay_ms", 1e6)]
)
def test_options_out_of_range_are_refused(field: str, value: float) -> None:
    with pytest.raises(RequestError, match=f"^{field}: .*; expected"):
        SimulationOptions(**{field: value})  # type: ignore[arg-type]


@given(sides=st.tuples(*[st.floats(0.02, 1.0)] * 3), depth=st.floats(0.0, 0.009))
def test_a_box_shrinks_by_the_depth_on_all_sides(sides: tuple[float, float, float], depth: float) -> None:
    vertices = CUBE / np.array([0.1, 0.2, 0.05]) * 0.5 * np.array(sides)
    shrunk = shrink_hull(vertices, depth)
    assert np.ptp(shrunk, axis=0) == pytest.approx(np.array(sides) - 2.0 * depth, abs=1e-6)
    assert measure_volume(vertices) == pytest.approx(np.prod(sides), rel=1e-9)


def test_only_a_level_top_is_a_floor() -> None:
    assert find_level_top(CUBE) == 0.05
    assert find_level_top(CUBE @ pin.exp3(np.array([0.1, 0.0, 0.0])).T) is None
