"""Loads that an object's masses, friction, springs and damping put on the hand, and where it rests without one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from heavy_mechanisms import dynamics, inertial, joint, lid_urdf, link, make_task, read_task, robot, slide_urdf
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.robot import MechanismJoint, make_mechanism_model
from costs.robot.elements.inertia import LinkInertia
from costs.robot.servo import DAMPING_S
from service import parse_request
from service.demands.hands import HANDS
from service.demands.mechanism.given import GivenMechanism
from service.demands.mechanism.phases import make_mechanism_phases
from service.demands.moved_object.loads import JointLoad, MovedObject
from service.demands.moved_object.ranges import bound_polynomial, bound_waves
from service.errors import RequestError
from service.setup.prepare import prepare

G = 9.81
STAYS: dict[str, Any] = {"stays": True}


def list_loads(found: GivenMechanism) -> list[JointLoad]:
    """The loads of all moves, one joint after the other."""
    return [load for loads in found.list_joint_loads() for load in loads]


def refuse(*args: Any, **more: Any) -> str:
    with pytest.raises(RequestError) as caught:
        read_task(*args, **more)
    (problem,) = caught.value.problems
    assert "\n" not in problem
    return problem


def test_a_hatch_on_a_slide_weighs_what_its_file_says() -> None:
    """30 kg upwards: 294.3 N, and 30 N for the default acceleration of 1 m/s^2 either way."""
    found = read_task(slide_urdf(30.0, "0 0 1"), [("slide", 0.3)], **STAYS)
    (load,) = list_loads(found)
    assert (load.low, load.high, load.sense) == pytest.approx((30 * G - 30.0, 30 * G + 30.0, 1.0))
    specs = make_mechanism_phases(found, HANDS["left"])
    (force,) = next(spec for spec in specs if spec.name == "move slide").loads
    np.testing.assert_allclose(force.force, [0.0, 0.0, 30 * G + 30.0], atol=1e-9)


def test_the_weight_of_a_lid_keeps_its_sign_on_the_way_back() -> None:
    """10 kg at 0.3 m: 29.43 N m shut, half of it at 60 deg; 5 N m of friction turn with the motion."""
    urdf = lid_urdf(10.0, dynamics(friction=5.0))
    opened = float(np.deg2rad(60.0))
    found = read_task(urdf, [("hinge", opened), ("hinge", 0.0)])
    up, down = list_loads(found)
    gravity = np.array([0.5, 1.0]) * 10.0 * G * 0.3
    # M = 0.2 + 10 * 0.3^2 = 1.1 kg m^2; the default acceleration of 2 rad/s^2 is slower than a fifth of the least load
    # on the way up, but not of the one on the way down: 0.2 * (14.715 - 5) / 1.1.
    most = 0.2 * (gravity[0] - 5.0) / 1.1
    assert found.mechanism.joints[0].acceleration == pytest.approx(most)
    assert (up.low, up.high) == pytest.approx((gravity[0] + 5.0 - 1.1 * most, gravity[1] + 5.0 + 1.1 * most))
    assert (down.low, down.high) == pytest.approx((gravity[0] - 5.0 - 1.1 * most, gravity[1] - 5.0 + 1.1 * most))
    assert up.low > 0.0
    assert down.low > 0.0  # closing it takes an upward push, too


def test_a_lid_that_its_weight_pulls_over_needs_a_hand_that_holds_it_back() -> None:
    """Beyond the vertical the weight helps: the hand would have to pull, so that there is a load in that direction."""
    found = read_task(lid_urdf(), [("hinge", 2.5)], **STAYS)
    (load,) = list_loads(found)
    assert load.low < 10.0 * G * 0.3 * np.cos(2.5) < 0.0 < 10.0 * G * 0.3 < load.high
    moved = next(spec for spec in make_mechanism_phases(found, HANDS["left"]) if spec.name == "move hinge")
    forces = [each.force for each in moved.loads]
    assert len(forces) == 2
    assert forces[0] @ forces[1] < 0.0


def test_a_drawer_on_a_slope_weighs_the_sine_of_it() -> None:
    """2 kg on a slide that rises by 30 deg: 9.81 N; the pose of the root turns it."""
    turned = [float(np.cos(np.pi / 12)), 0.0, float(np.sin(np.pi / 12)), 0.0]  # 30 deg about y: -x rises
    urdf = slide_urdf(2.0, "-1 0 0", dynamics(friction=15.0))
    (load,) = list_loads(read_task(urdf, [("slide", 0.2)], quaternion_wxyz=turned))
    assert (load.low + load.high) / 2.0 == pytest.approx(G + 15.0)
    level = list_loads(read_task(urdf, [("slide", 0.2)]))[0]
    assert (level.low + level.high) / 2.0 == pytest.approx(15.0)


def test_damping_needs_force_in_the_direction_of_motion() -> None:
    """20 N s/m at no more than 0.5 m/s: up to 10 N, and nothing where the drawer stands."""
    urdf = slide_urdf(0.0, "-1 0 0", dynamics(friction=3.0, damping=20.0), upper=2.0)
    out, back = list_loads(read_task(urdf, [("slide", 1.0), ("slide", 0.0)]))
    assert (out.low, out.high) == pytest.approx((3.0, 13.0))
    assert (back.low, back.high) == pytest.approx((-13.0, -3.0))


def test_damping_counts_with_the_speed_that_a_short_move_reaches() -> None:
    """From rest to rest over 0.04 m in 0.6 s: up to 0.133 m/s, and that becomes the joint's limit."""
    found = read_task(slide_urdf(0.0, "-1 0 0", dynamics(damping=20.0)), [("slide", 0.04)])
    assert found.mechanism.joints[0].velocity == pytest.approx(2.0 * 0.04 / 0.6)
    assert list_loads(found)[0].high == pytest.approx(20.0 * 2.0 * 0.04 / 0.6)


def test_the_request_s_friction_counts_instead_of_the_file_s() -> None:
    urdf = slide_urdf(0.0, "-1 0 0", dynamics(friction=12.0))
    for stated, counted in ((None, 12.0), (7.0, 7.0), (0.0, 0.0)):
        joints = {} if stated is None else {"slide": {"friction": stated}}
        (load,) = list_loads(read_task(urdf, [("slide", 0.2)], joints=joints))
        assert load.high == counted


def test_a_spring_s_force_grows_with_the_travel_and_helps_on_the_way_back() -> None:
    """5 N and 20 N/m from 0 to 0.2 m, against 2 N of friction."""
    joints = {"slide": {"friction": 2.0, "preload": 5.0, "stiffness": 20.0}}
    out, back = list_loads(read_task(slide_urdf(0.0, "-1 0 0"), [("slide", 0.2), ("slide", 0.0)], joints=joints))
    assert (out.low, out.high) == pytest.approx((5.0 + 2.0, 9.0 + 2.0))
    assert (back.low, back.high) == pytest.approx((5.0 - 2.0, 9.0 - 2.0))


def stacked_urdf(*more: str) -> str:
    """A slide that rises, with 4 kg of its own, and on it a hinge about z with a body of 6 kg."""
    return robot(
        link("carriage", inertial(4.0)),
        link("body", inertial(6.0, (-0.2, 0, 0), 0.1)),
        joint("lift", "prismatic", "root", "carriage", "0 0 1", *more),
        joint("hinge", "revolute", "carriage", "body", "0 0 1", dynamics(friction=1.0)),
    )


def test_masses_below_a_second_joint_weigh_on_the_first() -> None:
    """The slide lifts 10 kg: its own 4 and the 6 on its hinge."""
    loads = {load.joint: load for load in list_loads(read_task(stacked_urdf(), [("lift", 0.3)], **STAYS))}
    assert (loads["lift"].low + loads["lift"].high) / 2.0 == pytest.approx(10.0 * G)
    assert (loads["hinge"].low, loads["hinge"].high) == (0.0, 0.0)
    assert loads["hinge"].slack == (np.inf, 1.0)  # it is at its lower stop, and has 1 N m of friction


def test_a_weight_above_the_moving_joint_that_nothing_holds_is_refused() -> None:
    moves = [("lift", 0.3), ("hinge", 0.5)]
    assert refuse(stacked_urdf(), moves, **STAYS) == (
        "task.mechanism.joints.lift: gravity pulls while the hand moves hinge below it with 98.1 N, its friction holds "
        "0; expected no spring or weight, more friction, or lift moved after hinge"
    )
    assert read_task(stacked_urdf(dynamics(friction=99.0)), moves)


def test_a_mass_beside_the_hand_that_nothing_holds_is_refused() -> None:
    """A flap of 1 kg hangs from a lid's edge by a hinge of its own, 0.1 m from it."""
    flap = link("flap", inertial(1.0, (0.1, 0, 0), 0.01))
    parts = [link("body", inertial(1.0, (-0.3, 0, 0), 0.01)), flap]
    hinge = joint("hinge", "revolute", "root", "body", "0 1 0", dynamics(friction=9.0), upper=3.0)

    def hang(*more: str) -> str:
        return robot(*parts, hinge, joint("hang", "revolute", "body", "flap", "0 1 0", *more, lower=-1, at="-0.4 0 0"))

    problem = refuse(hang(dynamics(friction=0.5)), [("hinge", 1.0)])
    assert problem.startswith(
        "task.mechanism: hang does not rest at its start (0 deg): gravity turns it with 0.981 N m"
    )
    problem = refuse(hang(dynamics(friction=1.0)), [("hinge", 1.0)])
    assert problem.startswith("task.mechanism.moves[0]: nothing holds hang while the hand moves hinge: gravity and the")
    assert read_task(hang(dynamics(friction=3.0)), [("hinge", 1.0)])


def test_a_hatch_that_falls_when_the_hand_lets_go_is_refused() -> None:
    assert refuse(slide_urdf(30.0, "0 0 1"), [("slide", 0.05)]) == (
        "task.mechanism: slide does not rest where the hand lets go (0.05 m): gravity moves it with 294 N, its "
        "friction holds 0; expected task.mechanism.stays: true, friction, a latch, or a last move to where it rests"
    )


@pytest.mark.parametrize(
    ("urdf", "moves"),
    [
        (slide_urdf(30.0, "0 0 1", dynamics(friction=295.0)), [("slide", 0.05)]),
        (slide_urdf(30.0, "0 0 1"), [("slide", 0.05), ("slide", 0.0)]),  # its lower stop
        (slide_urdf(30.0, "1 0 0"), [("slide", 0.05)]),  # nothing pulls
        (lid_urdf(), [("hinge", 3.0)]),  # beyond the vertical, its upper stop
        (lid_urdf(10.0, dynamics(friction=29.5)), [("hinge", 0.1)]),
    ],
)
def test_an_object_that_friction_or_a_stop_holds_may_be_let_go(urdf: str, moves: Any) -> None:
    assert read_task(urdf, moves)


def test_a_stop_holds_only_against_what_presses_on_it() -> None:
    """At its upper stop, but before the vertical, a lid falls shut."""
    assert "turns it with 28.8 N m" in refuse(lid_urdf().replace('upper="3.0"', 'upper="0.21"'), [("hinge", 0.21)])


def test_a_continuous_joint_has_no_stops() -> None:
    wheel = lid_urdf().replace('"revolute"', '"continuous"')
    assert "does not rest at its start (0 deg): gravity turns it with 29.4 N m" in refuse(wheel, [("hinge", 1.0)])


def test_a_spring_that_pulls_back_at_let_go_is_refused() -> None:
    joints = {"slide": {"friction": 6.0, "preload": 5.0, "stiffness": 20.0}}
    problem = refuse(slide_urdf(0.0, "-1 0 0"), [("slide", 0.2)], joints=joints)
    assert "slide does not rest where the hand lets go (0.2 m): its spring moves it with 9 N, its friction holds 6" in (
        problem
    )
    joints["slide"]["friction"] = 9.5
    assert read_task(slide_urdf(0.0, "-1 0 0"), [("slide", 0.2)], joints=joints)


def test_a_spring_holds_its_joint_at_the_start_against_less_than_its_preload() -> None:
    urdf = slide_urdf(2.0, "0 0 1", lower=-1)
    assert "gravity moves it with 19.6 N, its friction and spring hold 15" in refuse(
        urdf, [("slide", 0.2)], joints={"slide": {"preload": 15.0}}, **STAYS
    )
    assert read_task(urdf, [("slide", 0.2)], joints={"slide": {"preload": 25.0}}, **STAYS)


@pytest.mark.parametrize(("angle", "rests"), [("1.570796", True), ("1.5708", True), ("1.57", False)])
def test_a_hinge_that_is_upright_but_for_rounding_rests(angle: str, rests: bool) -> None:
    """A door of 20 kg whose hinge lies along y before it is turned: 1.57 leaves 0.8 mrad, and 0.047 N m."""
    urdf = lid_urdf(20.0).replace('<origin xyz="0 0 0"/><axis', f'<origin xyz="0 0 0" rpy="{angle} 0 0"/><axis')
    urdf = urdf.replace('lower="0"', 'lower="-1"')
    if rests:
        assert read_task(urdf, [("hinge", 1.0)])
    else:
        assert "gravity turns it with 0.0469 N m" in refuse(urdf, [("hinge", 1.0)])


def test_an_untimed_motion_names_the_pace_that_its_loads_assume() -> None:
    request = make_task(slide_urdf(5.0, "-1 0 0", dynamics(friction=2.0)), [("slide", 0.3)])
    request["options"]["timed"] = False
    notes = prepare(parse_request(request), checks_start=False).notes
    assert notes[-1] == (
        "task.mechanism: the loads of slide hold up to 0.155 m/s and 0.08 m/s^2, which an untimed motion leaves open"
    )


def test_a_latch_holds_what_it_locks() -> None:
    """A hatch that slides down is locked at 0 until its bolt is turned, and the hand must be at it then."""
    parts = [link("body", inertial(3.0)), link("bolt")]
    hatch = joint("drop", "prismatic", "root", "body", "0 0 -1")
    bolt = joint("bolt_turn", "revolute", "body", "bolt", "1 0 0", dynamics(friction=1.0))
    handle = {"link": "bolt", "place": [0.0, 0.0, 0.1], "axis": [1.0, 0.0, 0.0]}
    latched = {"handle": handle, "releases": [{"joint": "drop", "latch": "bolt_turn", "at": 0.5}]}
    text = robot(*parts, hatch, bolt)
    assert "drop does not rest at its start (0 m)" in refuse(text, [("bolt_turn", 0.3)], handle=handle)
    assert read_task(text, [("bolt_turn", 0.3)], **latched)
    assert "drop does not rest where the hand lets go (0 m)" in refuse(text, [("bolt_turn", 0.6)], **latched)


def test_an_object_is_moved_so_gently_that_it_does_not_run_ahead_of_the_hand() -> None:
    """2 N of friction stop 5 kg at 0.4 m/s^2: at a fifth of that the hand always pushes."""
    found = read_task(slide_urdf(5.0, "-1 0 0", dynamics(friction=2.0)), [("slide", 0.3)])
    assert found.mechanism.joints[0].acceleration == pytest.approx(0.2 * 2.0 / 5.0)
    (load,) = list_loads(found)
    assert (load.low, load.high) == pytest.approx((1.6, 2.4))


def test_an_object_without_friction_runs_ahead_and_has_loads_both_ways() -> None:
    """0.3 m in 10 s: 4 * 0.3 / 100 = 0.012 m/s^2, 0.06 N of 5 kg either way."""
    (load,) = list_loads(read_task(slide_urdf(5.0, "-1 0 0"), [("slide", 0.3)]))
    assert (load.low, load.high) == pytest.approx((-0.06, 0.06))


def test_a_turning_mass_pulls_the_slide_that_carries_it() -> None:
    """6 kg at 0.2 m turn by half a turn: up to m r (alpha + omega^2) along the slide, either way."""
    slide = MechanismJoint("slide", "a", np.zeros(3), np.array([1.0, 0.0, 0.0]), {}, kind="prismatic")
    mass = LinkInertia(6.0, np.array([0.2, 0.0, 0.0]), np.zeros((3, 3)))
    hinge = MechanismJoint(
        "hinge",
        "b",
        np.zeros(3),
        np.array([0.0, 0.0, 1.0]),
        {},
        parent="a",
        velocity=0.5,
        acceleration=0.3,
        inertia=mass,
    )
    loads = MovedObject((slide, hinge)).list_loads(np.zeros(2), np.array([0.0, np.pi]), ["hinge", "slide"])
    most = 6.0 * 0.2 * (0.3 + 0.5**2)
    assert (loads[1].low, loads[1].high) == pytest.approx((-most, most))
    assert (loads[0].low, loads[0].high) == pytest.approx((-6.0 * 0.2**2 * 0.3, 6.0 * 0.2**2 * 0.3))


def test_a_mechanism_without_masses_and_damping_keeps_its_pace() -> None:
    found = read_task(slide_urdf(0.0, "-1 0 0", velocity=0.9), [("slide", 0.3)])
    assert (found.mechanism.joints[0].velocity, found.mechanism.joints[0].acceleration) == (0.9, 1.0)


def test_servos_lag_behind_a_short_travel_by_a_hundredth_of_it() -> None:
    found = read_task(slide_urdf(0.0, "-1 0 0", velocity=0.9), [("slide", 0.009)])
    joint = found.mechanism.joints[0]
    assert joint.acceleration * DAMPING_S**2 == pytest.approx(0.01 * 0.009)  # behind, as it comes to rest
    assert joint.velocity == 0.9


numbers = st.floats(-1.0, 1.0)
vectors = st.tuples(numbers, numbers, numbers)
axes = vectors.filter(lambda vector: float(np.linalg.norm(vector)) > 0.1)


@st.composite
def chains(draw: st.DrawFn) -> tuple[MechanismJoint, ...]:
    """A random chain of one to three joints with masses, friction and damping."""
    joints, parent = [], None
    for k in range(draw(st.integers(1, 3))):
        moments = np.diag([draw(st.floats(0.5, 0.6)) for _ in range(3)])
        inertia = LinkInertia(draw(st.floats(0.1, 20.0)), np.array(draw(vectors)), moments)
        joints.append(
            MechanismJoint(
                f"j{k}", f"l{k}", np.array(draw(vectors)), np.array(draw(axes)), {},
                kind=draw(st.sampled_from(["revolute", "prismatic"])), parent=parent, inertia=inertia,
                velocity=draw(st.floats(0.1, 1.0)), acceleration=draw(st.floats(0.1, 2.0)),
                friction=draw(st.floats(0.0, 5.0)), damping=draw(st.floats(0.0, 5.0)),
            )
        )  # fmt: skip
        parent = f"l{k}"
    return tuple(joints)


@settings(max_examples=60, deadline=None)
@given(joints=chains(), ends=st.tuples(vectors, numbers), seed=st.integers(0, 1000))
def test_no_motion_within_the_limits_needs_more_than_the_loads(
    joints: tuple[MechanismJoint, ...], ends: tuple[tuple[float, ...], float], seed: int
) -> None:
    """By Lagrange's equations from energies, with derivatives by differences: nothing of the planner's dynamics."""
    random = np.random.default_rng(seed)
    k, first = len(joints), np.array(ends[0][: len(joints)])
    column = int(random.integers(k))
    last = first.copy()
    last[column] = ends[1]
    moved = MovedObject(joints)
    loads = {load.joint: load for load in moved.list_loads(first, last, [joint.name for joint in joints])}
    model = make_mechanism_model(joints)
    moving = joints[column]

    def measure_energies(q: np.ndarray, qd: np.ndarray) -> tuple[float, float]:
        data = model.createData()
        return pin.computeKineticEnergy(model, data, q, qd), pin.computePotentialEnergy(model, data, q)

    sense = float(np.sign(last[column] - first[column]))
    for _ in range(4):
        q, qd = first.copy(), np.zeros(k)
        q[column] += random.uniform() * (last[column] - first[column])
        qd[column] = sense * random.uniform() * moving.velocity
        qdd = random.uniform(-1.0, 1.0) * moving.acceleration * np.eye(k)[column]
        for index, own in enumerate(joints):
            step, unit = 1e-4, np.eye(k)[index]

            def momentum(
                s: float, unit: np.ndarray = unit, q: np.ndarray = q, qd: np.ndarray = qd, qdd: Any = qdd
            ) -> Any:
                """Generalised momentum a time s later on the same motion."""
                at, rate = q + s * qd + 0.5 * s * s * qdd, qd + s * qdd
                ahead, behind = (measure_energies(at, rate + sign * unit)[0] for sign in (0.5, -0.5))
                return ahead - behind

            change = (momentum(step) - momentum(-step)) / (2 * step)
            ahead, behind = (measure_energies(q + sign * step * unit, qd) for sign in (1.0, -1.0))
            force = change - (ahead[0] - behind[0] - ahead[1] + behind[1]) / (2 * step)
            load = loads[own.name]
            slack = 1e-3 * (1.0 + abs(force))
            if index == column:
                force += own.friction * sense + own.damping * qd[column]
                assert load.low - slack <= force <= load.high + slack
            elif abs(force) > own.friction + slack:
                assert load.low - slack <= force <= load.high + slack


@settings(max_examples=60, deadline=None)
@given(values=st.lists(numbers, min_size=5, max_size=5), low=st.floats(-9.0, 9.0), length=st.floats(0.0, 7.0))
def test_the_bounds_of_waves_are_those_of_many_samples(values: list[float], low: float, length: float) -> None:
    nodes = 2 * np.pi * np.arange(5) / 5
    waves = lambda a: np.stack([np.ones_like(a), np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)], axis=-1)  # noqa: E731
    factors = np.linalg.solve(waves(nodes), np.array(values))
    found = waves(np.linspace(low, low + length, 4001)) @ factors
    bounds = bound_waves(np.array(values), low, low + length)
    assert bounds == pytest.approx((found.min(), found.max()), abs=1e-5)
    assert bounds[0] <= found.min() + 1e-9
    assert bounds[1] >= found.max() - 1e-9


@settings(max_examples=60, deadline=None)
@given(values=vectors, low=st.floats(-3.0, 3.0), length=st.floats(0.0, 4.0))
def test_the_bounds_of_a_quadratic_are_those_of_many_samples(
    values: tuple[float, ...], low: float, length: float
) -> None:
    factors = np.polyfit([-1.0, 0.0, 1.0], values, 2)
    found = np.polyval(factors, np.linspace(low, low + length, 4001))
    bounds = bound_polynomial(np.array(values), low, low + length)
    assert bounds == pytest.approx((found.min(), found.max()), abs=1e-5)
