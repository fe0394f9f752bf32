"""The certificate's ZMP against momenta of the URDF's links, changed by differences, on random motions of Atlas."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from urdf_momentum import euler, read_links, wrench_about_origin, zmp_of

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from service.verify import Motion, Phase, SupportPolygon, VerifySettings
from service.verify.forces.dynamics import check_dynamics, compute_forces, list_sample_times
from service.verify.prepared_motion import PreparedMotion

# Error of the differences [m] (forces of some 1,500 N to 0.02 N, moments to 0.02 Nm).
TOLERANCE_M = 2e-5
HEIGHT = 0.07
POLYGON = np.array([[-0.12, -0.2], [0.13, -0.19], [0.11, 0.22], [-0.1, 0.18]])


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _random_motion(robot: RobotModel, seed: int) -> Motion:
    """Pelvis and all joints move as they like, from rest to rest; the feet do not matter to the forces."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(-0.15, 0.15, (4, robot.n))
    steps[0] = 0.0
    rows = robot.postures["stand"] + np.cumsum(steps, axis=0)
    rows = np.clip(rows, robot.lower, robot.upper)
    curve = Curve(np.arange(4.0), rows, rng.uniform(-0.1, 0.1, (4, robot.n)))
    path = np.unique(np.concatenate([[0.0, 3.0], rng.uniform(0.0, 3.0, 6)]))
    speed = rng.uniform(0.8, 1.4, len(path))
    speed[[0, -1]] = 0.0
    law = TimeLaw(np.append(0.0, np.cumsum(2.0 * np.diff(path) / (speed[1:] + speed[:-1]))), path, speed)
    phase = Phase("sway", 0.0, 3.0, support=SupportPolygon(POLYGON, 0.0, HEIGHT))
    return Motion(robot, Scene(), curve, law, (phase,))


def _pose_at(motion: Motion, time: float) -> Callable[[float], tuple[np.ndarray, np.ndarray, Mapping[str, float]]]:
    """The motion around a moment, as one polynomial: what jumps at the law's points and knots goes on smoothly."""
    law, curve = motion.law, motion.curve
    assert law is not None
    i = int(np.clip(np.searchsorted(law.times, time) - 1, 0, len(law.times) - 2))
    gain = (law.speed[i + 1] - law.speed[i]) / (law.times[i + 1] - law.times[i])

    def along(later: float) -> float:
        return float(law.path[i] + later * (law.speed[i] + 0.5 * gain * later))

    piece = int(np.clip(np.searchsorted(curve.knots, along(time - law.times[i])) - 1, 0, len(curve.knots) - 2))
    start, h = curve.knots[piece], curve.knots[piece + 1] - curve.knots[piece]
    (p0, p1), (m0, m1) = curve.positions[piece : piece + 2], curve.tangents[piece : piece + 2]

    def pose(offset: float) -> tuple[np.ndarray, np.ndarray, Mapping[str, float]]:
        u = (along(time + offset - law.times[i]) - start) / h
        q = (
            (1.0 + 2.0 * u) * (1.0 - u) ** 2 * p0
            + u * (1.0 - u) ** 2 * h * m0
            + u**2 * (3.0 - 2.0 * u) * p1
            + u**2 * (u - 1.0) * h * m1
        )
        named = dict(zip(motion.robot.joint_names, q.tolist(), strict=True))
        x, y, z, yaw, pitch, roll = (named.pop(f"base_{key}") for key in ("x", "y", "z", "yaw", "pitch", "roll"))
        return euler(roll, pitch, yaw), np.array([x, y, z]), named

    return pose


def _inside(points: np.ndarray) -> np.ndarray:
    """Distance of points inside the polygon, edge by edge by cross products [m]."""
    after = np.roll(POLYGON, -1, axis=0)
    along = (after - POLYGON) / np.linalg.norm(after - POLYGON, axis=1)[:, None]
    away = points[:, None] - POLYGON
    return np.asarray((along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0]).min(axis=1))


@pytest.mark.parametrize("seed", range(3))
def test_the_zmp_of_the_certificate_is_that_of_differentiated_momenta(atlas: RobotModel, seed: int) -> None:
    motion = _random_motion(atlas, seed)
    phase, law = motion.phases[0], motion.law
    assert law is not None
    links = read_links(atlas.source.urdf)
    times = list_sample_times(motion, law, phase.first, phase.last, 0.05)
    found = compute_forces(motion, law, phase, times, torques=False)
    wrenches = np.array([wrench_about_origin(links, _pose_at(motion, time)) for time in times.tolist()])
    np.testing.assert_allclose(found.wrench[0], wrenches, rtol=0.0, atol=0.02)
    own = np.array([zmp_of(wrench, HEIGHT) for wrench in wrenches])
    np.testing.assert_allclose(found.zmp(HEIGHT)[0], own, rtol=0.0, atol=TOLERANCE_M)
    spread = np.ptp(own, axis=0)
    assert np.all(spread > 0.02)  # it moves along both axes
    check = next(check_dynamics(PreparedMotion(motion), phase, VerifySettings(time_step_s=0.05)))
    assert check.value == pytest.approx(float(_inside(own).min()), abs=TOLERANCE_M)
    worst = int(np.argmin(_inside(own)))
    assert check.where is not None
    assert check.where.time_s is not None
    assert check.where.position is not None
    assert _inside(np.array([check.where.position[:2]]))[0] == pytest.approx(check.value, abs=1e-9)
    assert _inside(own)[worst] == pytest.approx(_inside(own)[times == check.where.time_s][0], abs=TOLERANCE_M)
    assert check.where.position[2] == HEIGHT
