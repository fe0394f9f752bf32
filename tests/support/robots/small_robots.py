"""Small robots and curves made by hand or at random, for the verifier's tests."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from costs.curve import Curve
from costs.robot.model import BASE_NAMES, LinkBody, RobotModel, RobotSource
from costs.scene import ConvexPiece, Scene
from service.verify import Motion

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def box(name: str, centre: tuple[float, float, float], half: tuple[float, float, float]) -> ConvexPiece:
    """An axis-aligned box."""
    return ConvexPiece(name, np.asarray(centre) + CUBE * np.asarray(half))


def floating_joint() -> pin.JointModelComposite:
    """Translation, then z-y-x angles, as the project's floating base."""
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelTranslation())
    joint.addJoint(pin.JointModelSphericalZYX())
    return joint


def robot_of(
    model: pin.Model,
    bodies: list[LinkBody],
    *,
    is_floating: bool = False,
    ignored: frozenset[tuple[str, str]] = frozenset(),
    limit: float = 10.0,
) -> RobotModel:
    """A RobotModel around a pinocchio model, all limits equal (position, speed, acceleration; torque 1e3)."""
    n = model.nq
    base = 6 if is_floating else 0
    free = np.concatenate([np.full(base, np.inf), np.full(n - base, limit)])
    names = (BASE_NAMES if is_floating else ()) + tuple(f"joint{k}" for k in range(n - base))
    effort = np.concatenate([np.full(base, np.inf), np.full(n - base, 1e3)])
    return RobotModel(
        name="small",
        model=model,
        joint_names=names,
        lower=-free,
        upper=free,
        velocity=free,
        acceleration=free,
        effort=effort,
        bodies=tuple(bodies),
        is_floating=is_floating,
        groups={},
        link_groups={},
        postures={},
        ignored_pairs=ignored,
        fixed_links=frozenset(),
        mechanism_links=frozenset(),
        source=RobotSource("", "", {}),
    )


def random_model(rng: np.random.Generator, n_joints: int, *, is_floating: bool, branches: bool) -> pin.Model:
    """A tree of revolute and prismatic joints with random axes, offsets and a mass each."""
    model = pin.Model()
    tip = 0
    if is_floating:
        tip = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    for k in range(n_joints):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        kind = pin.JointModelPrismaticUnaligned if rng.random() < 0.3 else pin.JointModelRevoluteUnaligned
        parent = int(rng.integers(0, model.njoints)) if branches else tip
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, size=3))
        tip = model.addJoint(parent, kind(axis), placement, f"joint{k}")
    for joint in range(1, model.njoints):
        inertia = pin.Inertia(float(rng.uniform(0.5, 3.0)), rng.uniform(-0.2, 0.2, size=3), 0.02 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"frame{joint}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


def let_some_follow(rng: np.random.Generator, model: pin.Model) -> pin.Model:
    """The model with up to three joints following earlier ones (URDF's ``mimic``)."""
    for _ in range(3):
        own = [j for j in range(1, model.njoints) if model.joints[j].nq == 1]
        if len(own) < 3:
            return model
        leader, follower = np.sort(rng.choice(own, 2, replace=False))
        ratio = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 2.5))
        model = pin.transformJointIntoMimic(model, int(leader), int(follower), ratio, float(rng.uniform(-1.0, 1.0)))
    return model


def random_curve(rng: np.random.Generator, n: int, n_knots: int, *, size: float = 1.0, spread: float = 0.4) -> Curve:
    """A curve with random positions, steps and tangents (often with overshoot between the knots)."""
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, size=n_knots - 1))])
    start = rng.uniform(-size, size, size=n)
    steps = rng.uniform(-spread, spread, size=(n_knots, n))
    steps[0] = 0.0
    return Curve(knots, start + np.cumsum(steps, axis=0), rng.uniform(-2.0, 2.0, size=(n_knots, n)) * spread)


def dense_points(model: pin.Model, curve: Curve, s: np.ndarray, joint: int, points: np.ndarray) -> np.ndarray:
    """(S, C, 3) world positions of points fixed to a joint, placement by placement."""
    data = model.createData()
    found = []
    for q in curve(s):
        pin.forwardKinematics(model, data, q)
        found.append(points @ data.oMi[joint].rotation.T + data.oMi[joint].translation)
    return np.array(found)


def random_crowd(seed: int) -> Motion:
    """A branched random robot among boxes."""
    rng = np.random.default_rng(seed)
    is_floating = bool(rng.integers(0, 2))
    model = random_model(rng, int(rng.integers(2, 5)), is_floating=is_floating, branches=True)
    bodies = []
    for joint in range(model.njoints):
        vertices = rng.uniform(-0.15, 0.15, size=(int(rng.integers(4, 12)), 3))
        bodies.append(LinkBody(f"link{joint}", f"link{joint}", joint, vertices, vertices))
    robot = robot_of(model, bodies, is_floating=is_floating)
    pieces = tuple(box(f"piece{k}", tuple(rng.uniform(-1, 1, 3)), tuple(rng.uniform(0.01, 0.2, 3))) for k in range(3))
    return Motion(robot, Scene(pieces), random_curve(rng, model.nq, 3, spread=0.3))
