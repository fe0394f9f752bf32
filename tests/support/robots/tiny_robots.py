"""Robots for tests of terms and kinematics: chains written as URDF, and the bundled Atlas at random configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.robot import MechanismJoint, RobotModel, load_robot, with_mechanism
from costs.state import MotionState


@dataclass(frozen=True)
class Segment:
    """A joint, and the box of its link along +x of the joint's frame.

    Attributes:
        axis: of the joint, in the parent's frame.
        origin: of the joint in the parent's frame [m].
        size: of the box, whose middle is at ``size_x / 2`` along x [m].
        mass: at the middle of the box [kg].
        kind: ``revolute`` or ``prismatic``.
    """

    axis: tuple[float, float, float]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    size: tuple[float, float, float] = (1.0, 0.1, 0.1)
    mass: float = 1.0
    kind: str = "revolute"


Z = (0.0, 0.0, 1.0)
PLANAR = (Segment(Z), Segment(Z, origin=(1.0, 0.0, 0.0)))
SPATIAL = (
    Segment(Z, origin=(0.0, 0.0, 0.4), size=(0.3, 0.1, 0.12), mass=2.0),
    Segment((0.0, 1.0, 0.0), origin=(0.3, 0.0, 0.1), size=(0.25, 0.08, 0.1), mass=1.5),
    Segment((0.6, 0.0, 0.8), origin=(0.25, 0.05, 0.0), size=(0.2, 0.07, 0.08), kind="prismatic"),
    Segment((1.0, 0.0, 0.0), origin=(0.2, 0.0, 0.03), size=(0.2, 0.1, 0.05), mass=0.7),
)


def chain_urdf(segments: Sequence[Segment]) -> str:
    """Links ``base``, ``link1`` ... and a frame ``tip`` at the end of the last box; all joints within +-2."""
    parts = ['<link name="base"/>']
    for k, segment in enumerate(segments, start=1):
        middle = f"{0.5 * segment.size[0]} 0 0"
        size, axis, origin = (" ".join(map(str, v)) for v in (segment.size, segment.axis, segment.origin))
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="{middle}"/><mass value="{segment.mass}"/>'
            '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
            f'<collision><origin xyz="{middle}"/><geometry><box size="{size}"/></geometry></collision></link>'
            f'<joint name="joint{k}" type="{segment.kind}"><parent link="{"base" if k == 1 else f"link{k - 1}"}"/>'
            f'<child link="link{k}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        )
    parts.append(
        f'<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="link{len(segments)}"/>'
        f'<child link="tip"/><origin xyz="{segments[-1].size[0]} 0 0" rpy="0 0 0"/></joint>'
    )
    return f'<robot name="chain">{"".join(parts)}</robot>'


@cache
def chain(segments: tuple[Segment, ...], root: str = "fixed") -> RobotModel:
    """The chain as the loader makes it."""
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / "chain.urdf"
        urdf.write_text(chain_urdf(segments), encoding="utf-8")
        return load_robot(urdf=urdf, root=root)


@cache
def atlas() -> RobotModel:
    """The bundled Atlas with a floating base."""
    return load_robot("atlas")


@cache
def atlas_with_wheel() -> RobotModel:
    """Atlas and a valve wheel before it, whose angle is the last coordinate."""
    corners = np.array([[x, y, z] for x in (0.69, 0.71) for y in (-0.2, 0.2) for z in (0.9, 1.3)])
    return with_mechanism(
        atlas(),
        [
            MechanismJoint(
                name="valve_turn",
                origin=np.array([0.7, 0.0, 1.1]),
                axis=np.array([1.0, 0.2, -0.1]),
                bodies={"valve/rim": corners},
                link="valve",
                lower=-6.0,
                upper=6.0,
                velocity=1.0,
                acceleration=1.0,
            )
        ],
    )


def random_configurations(robot: RobotModel, rng: np.random.Generator, n_waypoints: int) -> np.ndarray:
    """(T, n) joints anywhere within their limits, the base within a metre and well away from pitch +-90 degrees."""
    lower, upper = np.maximum(robot.lower, -1.0), np.minimum(robot.upper, 1.0)
    bounded = np.isfinite(robot.lower)
    lower[bounded], upper[bounded] = robot.lower[bounded], robot.upper[bounded]
    return rng.uniform(lower, upper, size=(n_waypoints, robot.n))


def contact_free_state(robot: RobotModel):
    """Maps an iterate to a state without contacts."""
    engine = KinematicsEngine(robot)
    return lambda x: MotionState(engine(x), Contacts.none())
