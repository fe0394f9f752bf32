"""Hostile motions: what is not a number, not rigid or out of order is refused, never certified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import CUBE, box, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot.model import LinkBody
from costs.scene import Scene
from service.verify import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    RelativePoseTarget,
    Status,
    SupportPolygon,
    VerifyError,
    verify,
)
from service.verify.phase_proof import bound_largest

NAN = float("nan")
X, Z = np.eye(3)[0], np.eye(3)[2]
FREE = np.full(3, np.inf)
SOLE = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]])


def _motion(*, mechanism: frozenset[str] = frozenset(), **promises: object) -> Motion:
    """A cube on a slide from 0 to 0.1 m, with mass, the frame ``tip`` at its centre, a post fixed in the world."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    cube, post = CUBE * 0.05, CUBE * 0.05 + [0.12, 0.0, 0.0]
    bodies = [LinkBody("cube", "cube", 1, cube, cube), LinkBody("post", "post", 0, post, post)]
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [0.01]]), np.full((2, 1), 0.01))
    return Motion(
        robot_of(model, bodies),
        Scene((box("wall", (0.0, 1.0, 0.0), (0.1, 0.1, 0.1)),)),
        curve,
        phases=(Phase("slide", 0.0, 1.0, **promises),),  # type: ignore[arg-type]
        samples=np.linspace(0.0, 1.0, 5),
        mechanism_links=mechanism,
    )


def _target(target: object) -> Callable[[], Motion]:
    return lambda: _motion(targets=(target,))


def _with_vertices(vertices: np.ndarray) -> Motion:
    motion = _motion()
    return replace(motion, scene=Scene((replace(motion.scene.pieces[0], vertices=vertices),)))


HOSTILE: dict[str, Callable[[], Motion]] = {
    "piece with NaN": lambda: _with_vertices(np.array([[NAN, 0.0, 0.0]])),
    "piece without vertices": lambda: _with_vertices(np.empty((0, 3))),
    "body with NaN": lambda: replace(
        _motion(),
        robot=replace(_motion().robot, bodies=(LinkBody("cube", "cube", 1, np.full((4, 3), NAN), CUBE),)),
    ),
    "knot that is NaN": lambda: replace(
        _motion(), curve=Curve(np.array([0.0, NAN]), np.zeros((2, 1)), np.zeros((2, 1)))
    ),
    "samples with NaN": lambda: replace(_motion(), samples=np.array([0.0, NAN, 1.0])),
    "samples out of order": lambda: replace(_motion(), samples=np.array([0.0, 1.0, 0.5, 1.0])),
    "law with NaN": lambda: replace(
        _motion(), law=TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([0.0, NAN]))
    ),
    "polygon with NaN": lambda: _motion(support=SupportPolygon(np.full((3, 2), NAN))),
    "contact with NaN": lambda: _motion(contacts=(PlantedContact("tip", np.full((4, 4), NAN), SOLE),)),
    "contact that is not rigid": lambda: _motion(contacts=(PlantedContact("tip", np.zeros((4, 4)), SOLE),)),
    "contact without sole": lambda: _motion(contacts=(PlantedContact("tip", np.eye(4), np.empty((0, 3))),)),
    "pose with NaN": _target(PoseTarget("tip", np.array([NAN, 0.0, 0.0]), None, np.full(3, 0.1), FREE)),
    "pose with NaN for a tolerance": _target(PoseTarget("tip", np.ones(3), None, np.full(3, NAN), FREE)),
    "pose with a null rotation": _target(PoseTarget("tip", np.ones(3), np.zeros((3, 3)), np.full(3, 0.1), FREE)),
    "pose with a mirror": _target(PoseTarget("tip", np.ones(3), -np.eye(3), np.full(3, 9.0), FREE)),
    "pose outside its phase": _target(PoseTarget("tip", np.zeros(3), None, np.full(3, 0.1), FREE, at=2.0)),
    "circle with NaN": _target(CircleTarget("tip", np.full(3, NAN), Z, 1.0, 0.1)),
    "circle without axis": _target(CircleTarget("tip", np.zeros(3), np.zeros(3), 0.01, 0.1)),
    "axis that is NaN": _target(AxisTarget("tip", X, np.full(3, NAN), 0.1)),
    "kept pose with NaN": _target(RelativePoseTarget("tip", None, np.full(3, NAN), np.eye(3), 0.1, 0.1)),
    "kept pose with a mirror": _target(RelativePoseTarget("tip", None, X, -np.eye(3), 9.0, 4.0)),
    "kept pose without limit": _target(RelativePoseTarget("tip", None, X, np.eye(3), np.inf, 0.1)),
    "kept pose with a negative limit": _target(RelativePoseTarget("tip", None, X, np.eye(3), 0.1, -0.1)),
    "kept pose with a long axis": _target(RelativePoseTarget("tip", None, X, np.eye(3), 9.0, 4.0, 2.0 * X)),
    "joint at NaN": _target(JointTarget("q0", 0.0, 0.1, NAN)),
}


@pytest.mark.parametrize("make", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_motion_of_which_nothing_can_be_proven_is_refused(make: Callable[[], Motion]) -> None:
    with pytest.raises(VerifyError):
        verify(make())


def test_the_same_motion_without_the_fault_is_certified() -> None:
    assert verify(_motion()).status is Status.CERTIFIED


def test_a_bound_that_is_not_a_number_proves_nothing() -> None:
    def nothing(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        unknown = np.full(len(first), NAN)
        return unknown, unknown, unknown

    assert not bound_largest(np.array([0.0, 1.0]), nothing, 1.0, 0.1, 2, 1).is_proven


def test_a_support_polygon_wider_than_the_planted_soles_is_refuted() -> None:
    pose = np.eye(4)
    contact = PlantedContact("tip", pose, SOLE, tolerance_m=0.1, knot_tolerance_m=0.1)
    for size, holds in ((1.0, True), (1.05, False), (100.0, False)):
        support = SupportPolygon(SOLE[:, :2] * size)
        (check,) = [
            check
            for check in verify(_motion(contacts=(contact,), support=support)).checks
            if check.name == "support.slide"
        ]
        assert check.ok is holds


def test_a_mechanism_that_meets_a_link_that_stands_still_is_refuted() -> None:
    motion = _motion(mechanism=frozenset({"cube"}))
    assert verify(motion).status is Status.CERTIFIED
    further = replace(motion, curve=replace(motion.curve, positions=np.array([[0.0], [0.1]])))
    assert verify(further).status is Status.VIOLATED


def test_what_is_left_out_is_said() -> None:
    motion = _motion()
    notes = verify(replace(motion, robot=replace(motion.robot, ignored_pairs=frozenset({("cube", "post")})))).notes
    assert any("1 pairs of links are not checked" in note for note in notes)
