"""Verdicts on runs in physics that were written down by hand: what counts as work, as standing, and as a fall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import CUBE, floating_joint, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot import MechanismJoint, Release, RobotModel, with_mechanism
from costs.robot.mesh.hull import make_outer_hull
from costs.robot.model import LinkBody
from costs.scene import Scene
from service.demands.resistance import MechanismPhysics, Resistance
from service.execution.reference import PlannedReference
from service.simulation.seen import Seen
from service.simulation.travel import measure_moves
from service.simulation.verdict import Judgement, judge
from service.verify import Motion, Phase, PlantedContact, PoseTarget, SupportPolygon

SOLE = np.array([[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.2, 0.2)])
PLAIN = MechanismPhysics({})
STEP_S, AFTER_S = 0.02, 3.0


def a_body(name: str, joint: int, middle: list[float]) -> LinkBody:
    vertices = np.asarray(middle) + CUBE * [0.1, 0.2, 0.05]
    return LinkBody(name, name, joint, vertices, make_outer_hull(vertices))


def arm() -> RobotModel:
    """A mass at the end of a rod that turns about y, with its hand half a metre from the joint."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint0")
    model.appendBodyToJoint(joint, pin.Inertia(4.0, np.array([0.5, 0.0, 0.0]), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("hand", joint, 0, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), pin.FrameType.OP_FRAME))
    return robot_of(model, [a_body("rod", joint, [0.5, 0.0, 0.0])])


def crate() -> RobotModel:
    """A floating box of 4 kg."""
    model = pin.Model()
    joint = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia(4.0, np.zeros(3), 0.02 * np.eye(3)), pin.SE3.Identity())
    model.addJointFrame(joint)
    model.addBodyFrame("crate", joint, pin.SE3.Identity(), -1)
    return robot_of(model, [a_body("crate", joint, [0.0, 0.0, 0.0])], is_floating=True)


def moving(robot: RobotModel, places: list[list[float]], phases: tuple[Phase, ...] = (), **more: object) -> Motion:
    """A motion through places, a second each, at rest at each of them."""
    q = np.array(places)
    s = np.arange(len(places), dtype=float)
    law = TimeLaw(s, s, np.ones(len(s)))
    return Motion(
        robot, Scene(()), Curve(s, q, np.zeros_like(q)), law, phases, mechanism_links=robot.mechanism_links, **more
    )  # type: ignore[arg-type]


def plug(**more: object) -> PlannedReference:
    """A plug that is pulled out by 80 mm and pushed in again to 5 mm, beside a lever that stays at 0."""
    slide = MechanismJoint(
        "out", "plug", np.array([3.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]),
        {"plug/1": 0.1 * CUBE + [3.0, 0.0, 0.0]}, kind="prismatic", lower=-1.0, upper=1.0,
    )  # fmt: skip
    lever = MechanismJoint(
        "lever", "lever", np.array([4.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]),
        {"lever/1": 0.1 * CUBE + [4.0, 0.0, 0.0]}, lower=-1.0, upper=1.0,
    )  # fmt: skip
    phases = (Phase("pull", 0.0, 1.0), Phase("push", 1.0, 2.0))
    robot = with_mechanism(arm(), [slide, lever])
    return PlannedReference(moving(robot, [[0.0, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.005, 0.0]], phases, **more))


def see(reference: PlannedReference, **more: object) -> Seen:
    """A run that follows the plan, and stands for three seconds."""
    times = np.arange(0.0, reference.duration_s + AFTER_S, STEP_S)
    planned = np.array([reference.at(t).configuration for t in times])
    latched = np.ones((len(times), len(reference.motion.releases)), dtype=bool)
    return replace(Seen(times, planned.copy(), planned, latched, None), **more)  # type: ignore[arg-type]


def judged_with(reference: PlannedReference, column: int, change, physics: MechanismPhysics = PLAIN) -> Judgement:
    """The verdict on a run in which one coordinate is ``change(times, planned values)``."""
    seen = see(reference)
    seen.configuration[:, column] = change(seen.times, seen.planned[:, column])
    return judge(reference, seen, physics)


def test_what_follows_the_plan_is_done():
    reference = plug()
    assert judge(reference, see(reference), PLAIN) == Judgement(
        "DONE", (), measure_moves(reference, see(reference), PLAIN)
    )


def test_each_move_counts_by_itself_in_its_own_sense():
    judged = judged_with(plug(), 1, lambda t, x: np.where(t < 1.0, x, 0.08))
    assert judged.verdict == "STOOD"
    assert judged.reasons == ("out moved by 0.0 of -75.0 mm in phase 'push' (0 %)",)
    assert [round(move.share, 3) for move in judged.moves] == [1.0, 0.0]
    # Never out: the second move begins at 0, where it has nothing to push in.
    stuck = judged_with(plug(), 1, lambda t, x: 0.0 * x)
    assert [round(move.share, 3) for move in stuck.moves] == [0.0, 0.0]
    assert "pull" in stuck.reasons[0]


@pytest.mark.parametrize(("share", "verdict"), [(0.94, "STOOD"), (0.96, "DONE"), (1.1, "DONE"), (1.15, "STOOD")])
def test_a_joint_falls_short_by_at_most_five_percent_and_goes_too_far_by_at_most_five_millimetres_more(
    share: float, verdict: str
):
    assert (
        judged_with(
            plug(), 1, lambda t, x: np.where(t <= 1.0, share * x, x + np.clip(2.0 - t, 0.0, 1.0) * (share - 1.0) * 0.08)
        ).verdict
        == verdict
    )


def test_what_the_hand_displaces_on_its_way_there_counts_as_moved():
    early = judged_with(plug(), 1, lambda t, x: np.clip(x + 0.003, 0.0, 0.08))
    assert (early.verdict, round(early.moves[0].share, 3)) == ("DONE", 1.0)


def test_a_joint_with_a_spring_may_go_farther_since_it_returns():
    springs = MechanismPhysics({"out": Resistance(preload=2.0)})
    assert judged_with(plug(), 1, lambda t, x: 1.3 * x, springs).verdict == "DONE"
    assert judged_with(plug(), 1, lambda t, x: 1.3 * x).verdict == "STOOD"
    assert judged_with(plug(), 1, lambda t, x: 0.9 * x, springs).verdict == "STOOD"


def test_a_joint_that_the_plan_leaves_alone_stays():
    judged = judged_with(plug(), 2, lambda t, x: np.full_like(x, 0.1))
    assert judged.reasons == ("lever rests at 5.7 deg instead of 0.0 deg",)
    assert judged_with(plug(), 2, lambda t, x: np.full_like(x, 0.04)).verdict == "DONE"


def test_an_object_that_goes_on_moving_or_returns_is_not_done():
    judged = judged_with(plug(), 1, lambda t, x: x + 0.05 * np.maximum(t - 2.5, 0.0))
    assert judged.reasons == ("out rests at 129.0 mm instead of 5.0 mm", "out still moves 3.0 s after the end")


def test_a_latch_that_the_plan_frees_is_freed():
    reference = plug(releases=(Release("lever", "out", 0.06, 0.1),))
    seen = see(reference)
    assert judge(reference, seen, PLAIN).reasons == ("the latch of lever held: out reached 80.0 mm of 60.0 mm",)
    seen.is_latched[20:] = False
    assert judge(reference, seen, PLAIN).verdict == "DONE"
    seen.configuration[:, 1] = 0.9 * seen.planned[:, 1]  # 72 mm of 80, and the latch is free at 60
    assert judge(reference, seen, PLAIN).verdict == "DONE"


def test_a_hand_ends_within_twenty_millimetres_of_its_goal():
    target = PoseTarget("hand", np.array([0.5, 0.0, 0.0]), None, np.full(3, 0.01), np.full(3, np.inf), 1.0)
    reference = PlannedReference(moving(arm(), [[0.3], [0.0]], (Phase("reach", 0.0, 1.0, targets=(target,)),)))
    off = judged_with(reference, 0, lambda t, x: np.full_like(x, 0.05))
    assert off.reasons == ("hand ends 25 mm from its goal; expected at most 20 mm",)
    assert judged_with(reference, 0, lambda t, x: np.full_like(x, 0.03)).verdict == "DONE"


def standing() -> PlannedReference:
    """A crate of 0.2 by 0.4 m that stands for a second."""
    pose = np.eye(4)
    pose[2, 3] = 0.05
    feet = SupportPolygon(np.array([[-0.1, -0.2], [0.1, -0.2], [0.1, 0.2], [-0.1, 0.2]]))
    phase = Phase("rest", 0.0, 1.0, (PlantedContact("crate", pose, SOLE),), support=feet)
    place = [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]
    return PlannedReference(moving(crate(), [place, place], (phase,)))


def test_a_robot_that_leaves_its_feet_while_it_moves_falls():
    judged = judged_with(standing(), 0, lambda t, x: 0.05 * t)
    assert judged.verdict == "FELL"
    assert judged.reasons == ("falls 3.0 s after the end: the centre of mass is 99 mm outside its feet",)


def test_a_robot_that_rests_beside_its_feet_has_not_done_its_work():
    judged = judged_with(standing(), 0, lambda t, x: np.full_like(x, 0.144))
    assert judged.verdict == "STOOD"
    assert judged.reasons[0] == "the centre of mass ends 44 mm outside its feet"
    assert judged.reasons[1] == "crate ends phase 'rest' 144 mm from its place; expected at most 20 mm"


def test_a_robot_that_still_sways_has_not_done_its_work():
    judged = judged_with(standing(), 0, lambda t, x: 0.01 * np.sin(5.0 * t))
    assert judged.reasons == ("the robot still moves 3.0 s after the end",)


def test_a_robot_that_fell_fell_whatever_it_moved():
    reference = plug()
    assert judge(reference, see(reference, fell_at_s=1.5), PLAIN).verdict == "FELL"
