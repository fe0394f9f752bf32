"""Forces in timing: torques of a cell's rows, joints that their own weight overloads, slowing until feet hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import floating_joint, random_curve, random_model, robot_of

from costs.curve import Curve, TimeLaw
from costs.scene import Scene
from service.motion.time_rows import Cells, HalfRows, force_rows
from service.motion.timing import slow_until_zmp_inside
from service.verify import Motion, Phase, PlantedContact

G = 9.81


def excess(rows: HalfRows, u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``a u + b x - room`` of every row."""
    return np.asarray(rows.a * u[:, None] + rows.b * x[:, None] - rows.room)


@pytest.mark.parametrize(("seed", "n_straight"), [(0, 0), (1, 0), (2, 1), (3, 2)])
def test_rows_of_torque_are_the_torques_at_both_ends_of_every_cell_and_of_its_own_piece(
    seed: int, n_straight: int
) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, 3, is_floating=False, branches=False)
    robot = replace(robot_of(model, []), effort=rng.uniform(100.0, 200.0, 3))
    curve = random_curve(rng, 3, 4)
    curve.positions[:, :n_straight] = curve.knots[:, None]  # the second derivatives of these joints do not jump
    curve.tangents[:, :n_straight] = 1.0
    grid = np.unique(np.concatenate([curve.knots, np.linspace(curve.knots[0], curve.knots[-1], 10)]))
    width, data = np.diff(grid), model.createData()
    # s'' = u and s'^2 = x at the beginning of a cell, and s'^2 = x + 2 width u at its end
    u, x = rng.uniform(-1.0, 1.0, len(grid)), rng.uniform(2.0, 4.0, len(grid))

    def torque(s: float, u: float, x: float) -> np.ndarray:
        slope, bend = curve(np.array([s]), 1)[0], curve(np.array([s]), 2)[0]
        return np.asarray(pin.rnea(model, data, curve(np.array([s]))[0], slope * np.sqrt(x), slope * u + bend * x))

    first, last = force_rows(robot, curve, Cells.of(curve, grid), np.ones(3, dtype=bool), None, 0.0)
    at = range(len(width))
    inside = 1e-9  # the second derivative jumps at knots
    begin = np.array([torque(grid[k] + inside, u[k], x[k]) for k in at])
    end = np.array([torque(grid[k + 1] - inside, u[k], x[k] + 2.0 * width[k] * u[k]) for k in at])
    for rows, expected in ((first, begin), (last, end)):
        limit = 0.98 * robot.effort
        np.testing.assert_allclose(excess(rows, u, x)[:-1], np.hstack([expected - limit, -expected - limit]), atol=1e-6)


def test_joints_that_their_weight_overloads_anywhere_have_no_rows_nor_have_those_that_are_not_asked_for() -> None:
    # three rods of 1 kg turn about y, each with its mass at 1 m: m g cos(q) at rest
    model = pin.Model()
    for k in range(3):
        joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), f"rod{k}")
        model.appendBodyToJoint(
            joint, pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3))), pin.SE3.Identity()
        )
    robot = replace(robot_of(model, []), effort=np.array([0.9 * G, 2.0 * G, 2.0 * G]))
    ends = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]) * np.pi  # from level to hanging
    curve = Curve(np.array([0.0, 1.0]), ends, np.tile(ends[1] - ends[0], (2, 1)))
    cells = Cells.of(curve, np.linspace(0.0, 1.0, 6))
    # the first rod cannot be held level, though it can be held where it hangs; nobody asks for the third
    for rows in force_rows(robot, curve, cells, np.array([True, True, False]), None, 0.0):
        assert rows.room.shape == (6, 2)
        level = rows.room.min(axis=1)
        assert (level > 0.0).all()
    # the beginning of the first cell: 2 g less 2 % hold g, with g to spare
    first, _ = force_rows(robot, curve, cells, np.array([True, True, False]), None, 0.0)
    np.testing.assert_allclose(np.sort(first.room[0]), [0.98 * 2.0 * G - G, 0.98 * 2.0 * G + G])


SLAB, LOAD, WAY = 20.0, 10.0, 0.4  # [kg, kg, m]


def push_load(acceleration: float, friction: float, effort: float, share: float = 0.5) -> Motion:
    """A load slides on a slab from rest to rest; the slab's friction bears its reaction.

    It is faster and faster for a share of the time; the larger one of both accelerations is ``acceleration``.
    """
    model = pin.Model()
    base = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(SLAB, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    slide = model.addJoint(base, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia(LOAD, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("slab", base, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    robot = robot_of(model, [], is_floating=True)
    robot = replace(robot, effort=np.append(robot.effort[:-1], effort))
    way = np.append(np.zeros(6), WAY)
    curve = Curve(np.array([0.0, 1.0]), np.stack([0.0 * way, way]), np.stack([way, way]))
    # the greatest speed is 2 WAY / duration, reached in the share of the time and left in the rest
    duration = np.sqrt(2.0 * WAY / (acceleration * min(share, 1.0 - share)))
    law = TimeLaw(
        duration * np.array([0.0, share, 1.0]), np.array([0.0, share, 1.0]), np.array([0.0, 2.0, 0.0]) / duration
    )
    corners = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    contact = PlantedContact("slab", np.eye(4), corners, friction=friction, force_cap_n=1e4)
    phase = Phase("push", 0.0, 1.0, contacts=(contact,), region_margin_m=0.02)
    return Motion(robot, Scene(), curve, law, (phase,))


def slow_push(motion: Motion) -> float:
    """The largest acceleration after slowing [m/s^2]."""
    law = slow_until_zmp_inside(motion)
    return float(np.abs(np.diff(WAY * law.speed) / np.diff(law.times)).max())


# The slab is held with 0.1 * 30 kg * g; its friction pyramid has cos(22.5 deg) of the cone at least.
@pytest.mark.parametrize(("times", "share"), [(1.2, 0.5), (3.0, 0.5), (3.0, 0.7), (3.0, 0.3)])
def test_a_push_that_friction_does_not_bear_is_slowed_until_it_does_and_no_further(times: float, share: float) -> None:
    most = 0.1 * (SLAB + LOAD) * G / LOAD
    after = slow_push(push_load(times * most, friction=0.1, effort=1e4, share=share))
    assert 0.9 * most <= after <= most


@pytest.mark.parametrize("times", [0.97, 1.2, 3.0])
def test_a_push_of_all_that_a_joint_can_give_is_slowed_to_a_little_less(times: float) -> None:
    most = 20.0 / LOAD
    after = slow_push(push_load(times * most, friction=0.7, effort=20.0))
    assert 0.9 * most <= after <= 0.95 * most


@pytest.mark.parametrize("times", [0.5, 0.9])
def test_a_push_that_friction_and_joint_bear_is_not_slowed(times: float) -> None:
    for friction, effort in ((0.1, 1e4), (0.7, 0.1 * (SLAB + LOAD) * G)):
        motion = push_load(times * 0.1 * (SLAB + LOAD) * G / LOAD, friction, effort)
        assert slow_until_zmp_inside(motion) is motion.law
