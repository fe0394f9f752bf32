"""A small certified plan made by hand: Atlas bends an elbow, then a wheel beside it turns."""

from __future__ import annotations

import numpy as np

from costs.allowance import Allowance, BodyRef
from costs.curve import Curve, TimeLaw
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import MechanismJoint, RobotModel, with_mechanism
from costs.support import SupportPolygon as FeetHull
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.setup.prepare import PlanSetup, prepare
from service.verify import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    RelativePoseTarget,
    SupportPolygon,
    verify,
)

ORIGIN = np.array([1.2, 0.5, 1.2])


def small_plan() -> PlanResult:
    """The plan with its certificate."""
    request = parse_request({
        "robot": {"name": "atlas"},
        "goal": {"joints": {"l_arm_elx": 1.6}},
        "scene": {"obstacles": [{"name": "crate", "type": "box", "size": [0.3, 0.3, 0.3], "position": [1.5, 0, 0.5]}]},
    })  # fmt: skip
    setup = prepare(request)
    motion = _motion(setup)
    certificate = verify(motion)
    return PlanResult(
        request,
        Verdict.CERTIFIED,
        setup.robot,
        setup.scene,
        setup.start,
        motion,
        certificate,
        notes=("made by hand",),
        planning_time_s=0.5,
        timings={"reach": 0.4},
        figures={"turned_deg": 5.7},
    )


def _with_wheel(robot: RobotModel) -> RobotModel:
    rng = np.random.default_rng(0)
    return with_mechanism(
        robot,
        [
            MechanismJoint(
                name="wheel_turn",
                origin=ORIGIN,
                axis=np.array([-1.0, 0.0, 0.0]),
                bodies={"wheel/1": ORIGIN + 0.05 * rng.normal(size=(10, 3))},
                link="wheel",
                lower=-7.0,
                upper=7.0,
                velocity=1.0,
                acceleration=2.0,
            )
        ],
    )


def _motion(setup: PlanSetup) -> Motion:
    robot = _with_wheel(setup.robot)
    elbow = robot.joint_names.index("l_arm_elx")
    q = np.tile(np.append(setup.start, 0.0), (3, 1))
    q[1:, elbow] -= 0.3
    q[2, -1] = 0.1
    knots = np.array([0.0, 1.0, 2.0])
    law = TimeLaw(
        np.array([0.0, 2.0, 4.0, 6.0, 8.0]), np.array([0.0, 0.5, 1.0, 1.5, 2.0]), np.array([0.0, 0.5, 0.0, 0.5, 0.0])
    )
    poses = locate_links(KinematicsEngine(setup.robot), setup.start, setup.contacts)
    contacts = tuple(
        PlantedContact(link, pose, (setup.soles[link] - pose[:3, 3]) @ pose[:3, :3]) for link, pose in poses.items()
    )
    support = SupportPolygon(FeetHull.of_soles(list(setup.soles.values())).vertices, 0.02)
    allowances = tuple(Allowance(BodyRef.of_link(link), BodyRef.of_piece("floor"), 0.01) for link in poses)
    up, far = np.array([0.0, 0.0, 1.0]), np.full(3, np.inf)
    poses_of = locate_links(KinematicsEngine(setup.robot), setup.start, ["utorso", "r_hand"])
    chest = poses_of["utorso"]
    rim = ORIGIN + np.array([0.0, 0.0, 0.3])
    held = (_held(chest), _kept("r_hand", "utorso", poses_of))
    bend = Phase("bend", 0.0, 1.0, contacts, allowances, held, support)
    targets = (
        JointTarget("wheel_turn", 0.1, 1e-3, 2.0),
        AxisTarget("utorso", up, up, 0.1),
        CircleTarget("wheel", ORIGIN, np.array([1.0, 0.0, 0.0]), 0.3, 0.5, np.array([1.0, 0.0, 0.0])),
        PoseTarget("wheel", rim, None, np.full(3, 0.5), far, 2.0),
        RelativePoseTarget("utorso", None, chest[:3, 3], chest[:3, :3], 1e-3, 0.01, up),
    )
    turn = Phase("turn", 1.0, 2.0, contacts, allowances, targets, support)
    samples = np.linspace(0.0, 2.0, 81)
    return Motion(
        robot, setup.scene, Curve(knots, q, np.zeros_like(q)), law, (bend, turn), samples, robot.mechanism_links
    )


def _kept(frame: str, reference: str, poses: dict[str, np.ndarray]) -> RelativePoseTarget:
    """The frame keeps the pose it has relative to the other."""
    pose = np.linalg.inv(poses[reference]) @ poses[frame]
    return RelativePoseTarget(frame, reference, pose[:3, 3], pose[:3, :3], 2e-3, 0.02)


def _held(pose: np.ndarray) -> PoseTarget:
    """The chest stays above its place and turned as it is; its height is free."""
    place = np.array([1e-3, 1e-3, np.inf])
    return PoseTarget("utorso", pose[:3, 3], pose[:3, :3], place, np.full(3, 0.01))
