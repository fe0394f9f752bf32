"""Poses that are led by hand: each is checked, moves little, and says what stops it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.curve import Curve, TimeLaw
from costs.kinematics import locate_links
from costs.robot import RobotModel, load_robot
from costs.scene import ConvexPiece, Scene
from service.demands.stance import Stance, make_standing_allowances
from service.errors import RequestError
from service.posing.drag import Drag, DragTarget, StopKind
from service.posing.numbers import PoseNumbers
from service.posing.reading import list_joint_names, read_pose, write_pose
from service.posing.session import PoseSession
from service.posing.world import MOST_STEP_RAD, STEP_PER_M, STEP_RAD, PoseWorld
from service.request.file import parse_request, parse_section
from service.request.schema import StateRequest
from service.start.configuration import make_start_configuration
from service.verify import Motion, Phase, Status, verify

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FEET = ("l_foot", "r_foot")
FLOOR = ConvexPiece("floor", CORNERS * [6.0, 6.0, 0.2] + [0.0, 0.0, -0.1], "floor")
WALL = ConvexPiece("wall", CORNERS * [0.1, 3.0, 2.0] + [0.65, 0.0, 1.0])


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


@pytest.fixture(scope="module")
def world(atlas: RobotModel) -> PoseWorld:
    return PoseWorld.standing(atlas, Scene((FLOOR, WALL)), atlas.postures["stand"], FEET)


@pytest.fixture
def session(world: PoseWorld) -> PoseSession:
    return PoseSession(world, write_pose(world.robot, world.body.nominal))


def _place(session: PoseSession, link: str) -> np.ndarray:
    q = read_pose(session.world.robot, session.pose.numbers)
    return np.asarray(locate_links(session.world.body.engine, q, [link])[link][:3, 3])


def _lead(link: str, place: np.ndarray) -> Drag:
    x, y, z = place.tolist()
    return Drag((DragTarget(link, (x, y, z)),))


def _certify(world: PoseWorld, numbers: PoseNumbers) -> Status:
    """Status of the whole certificate of a motion that stays at a pose, from promises made anew."""
    robot, scene = world.robot, world.body.scene
    q = read_pose(robot, numbers)
    stance = Stance.of(robot, world.body.nominal, FEET, world.body.aims.balance_margin, is_balanced=True)
    support, touching = (
        stance.support("pose", world.body.nominal),
        make_standing_allowances(robot, stance.contacts, scene),
    )
    phase = Phase("pose", 0.0, 1.0, contacts=stance.contacts, support=support, allowances=touching)
    curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, len(q))))
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.ones(2))
    return verify(Motion(robot, scene, curve, law, (phase,))).status


def test_a_hand_follows_its_target(session: PoseSession) -> None:
    first = _place(session, "r_hand")
    for k in range(1, 6):
        pose = session.drag(_lead("r_hand", first + np.array([0.0, -0.01 * k, 0.01 * k])))
    assert np.linalg.norm(_place(session, "r_hand") - first - [0.0, -0.05, 0.05]) < 2e-3
    assert pose.stops == ()
    assert _certify(session.world, pose.numbers) is Status.CERTIFIED


def test_a_hand_led_into_a_wall_stops_before_it_without_a_jump(session: PoseSession) -> None:
    first, largest = _place(session, "r_hand"), 0.0
    for k in range(1, 29):
        before = session.pose.numbers.positions
        pose = session.drag(_lead("r_hand", first + np.array([0.01 * k, 0.0, 0.0])))
        largest = max(largest, float(np.abs(np.subtract(pose.numbers.positions, before)).max()))
    assert largest <= STEP_RAD + 1e-9
    assert pose.clearance_m is not None
    assert pose.clearance_m > 0.01
    pairs = [stop for stop in pose.stops if stop.kind is StopKind.PAIR]
    assert any("wall" in stop.names for stop in pairs)
    assert pose.stops[-1].kind is StopKind.REACH
    assert pose.stops[-1].value == pytest.approx(pose.miss_m[0])
    assert "mm from wall" in pairs[0].text


def test_a_hand_led_beyond_reach_stays_in_balance(session: PoseSession) -> None:
    first = _place(session, "l_hand")
    for k in range(1, 13):
        pose = session.drag(_lead("l_hand", first + np.array([-0.03 * k, 0.08 * k, 0.0])))
    assert pose.miss_m[0] > 0.1
    assert pose.stops
    assert pose.balance_margin_m is not None
    assert pose.balance_margin_m >= session.world.body.aims.balance_margin
    assert _certify(session.world, pose.numbers) is Status.CERTIFIED


HANDLES = st.lists(
    st.sampled_from(["l_hand", "r_hand", "pelvis", "utorso", "head"]), min_size=1, max_size=3, unique=True
)
WAYS = st.tuples(*[st.floats(-0.08, 0.08)] * 3)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(data=st.data())
def test_random_drags_give_poses_that_the_verifier_certifies(world: PoseWorld, data: st.DataObject) -> None:
    session = PoseSession(world, write_pose(world.robot, world.body.nominal))
    places: dict[str, np.ndarray] = {}
    for _ in range(data.draw(st.integers(1, 4))):
        before, moved = session.pose.numbers, {}
        for link in data.draw(HANDLES):
            way = np.array(data.draw(WAYS))
            moved[link] = places.get(link, _place(session, link)) + way
        step = max((float(np.linalg.norm(moved[k] - places[k])) for k in moved if k in places), default=0.0)
        targets = tuple(DragTarget(link, tuple(place.tolist())) for link, place in moved.items())
        pose = session.drag(Drag(targets))
        places = moved
        most = min(max(STEP_RAD, STEP_PER_M * step), MOST_STEP_RAD)
        assert np.abs(np.subtract(pose.numbers.positions, before.positions)).max() <= most + 1e-6
        assert pose.is_checked
        assert _certify(world, pose.numbers) is Status.CERTIFIED


def test_undo_and_redo_restore_every_bit(session: PoseSession) -> None:
    seen = [session.pose.numbers]
    for link, way in (("r_hand", [0.0, -0.05, 0.1]), ("pelvis", [0.0, 0.0, -0.05])):
        first = _place(session, link)
        for share in (0.5, 1.0):
            session.drag(_lead(link, first + share * np.array(way)), is_last=share == 1.0)
        seen.append(session.pose.numbers)
    assert len(set(seen)) == 3
    history = session.history
    assert history.undo()
    assert history.pose.numbers == seen[1]
    assert history.undo()
    assert history.pose.numbers == seen[0]
    assert not history.undo()
    assert history.redo()
    assert history.redo()
    assert history.pose.numbers == seen[2]
    assert not history.redo()


def test_a_pose_is_read_back_bit_by_bit_as_start_and_as_state(session: PoseSession) -> None:
    first = _place(session, "l_hand")
    numbers = session.drag(_lead("l_hand", first + np.array([0.02, 0.03, 0.1]))).numbers
    robot, names = session.world.robot, list_joint_names(session.world.robot)
    q = read_pose(robot, numbers)
    data = numbers.to_state(names)
    request = parse_request({"robot": {"name": "atlas"}, "start": data, "goal": numbers.to_goal(names)})
    assert np.array_equal(make_start_configuration(robot, request.start)[0], q)
    state = parse_section(StateRequest, data)
    assert (state.positions, state.base) == (request.start.positions, request.start.base)
    assert request.goal is not None
    assert tuple(request.goal.joints.values()) == numbers.positions
    given = PoseSession(session.world, numbers)
    assert given.pose.numbers == numbers


def test_a_preview_follows_without_being_checked(session: PoseSession) -> None:
    first = _place(session, "r_hand")
    preview = session.world.preview(session.pose.numbers, _lead("r_hand", first + np.array([0.0, 0.0, 0.02])))
    assert not preview.is_checked
    assert preview.miss_m[0] < 2e-3


@pytest.mark.parametrize(
    ("drag", "sentence"),
    [
        (Drag(), "drag: leads nothing; expected targets or joints"),
        (Drag((DragTarget("r_hnd", (0.3, -0.4, 0.8)),)), "unknown link 'r_hnd' in drag.targets"),
        (Drag((DragTarget("l_foot", (0.3, 0.1, 0.2)),)), "'l_foot' stands and carries the robot"),
        (Drag((DragTarget("r_hand", (300.0, -400.0, 800.0)),)), "expected metres, at most 100 each"),
        (Drag((DragTarget("r_hand", (float("nan"), 0.0, 0.0)),)), "expected metres, at most 100 each"),
        (Drag((DragTarget("r_hand", (0.3, -0.4, 0.8)),) * 2), "link 'r_hand' is led to two places; expected one"),
        (Drag(joints={"l_arm_elz": 0.2}), "unknown joint 'l_arm_elz' in drag.joints"),
    ],
)
def test_a_wrong_drag_is_refused_in_a_sentence_and_the_pose_stays(
    session: PoseSession, drag: Drag, sentence: str
) -> None:
    before = session.pose
    with pytest.raises(RequestError, match=sentence.replace(".", r"\.")):
        session.drag(drag)
    assert session.pose is before


def test_a_joint_is_led(session: PoseSession) -> None:
    names = list_joint_names(session.world.robot)
    own = session.pose.numbers.positions[names.index("back_bkz")]
    for k in range(1, 6):
        pose = session.drag(Drag(joints={"back_bkz": own + 0.05 * k}))
    assert pose.numbers.positions[names.index("back_bkz")] == pytest.approx(own + 0.25, abs=0.02)


def test_a_pose_that_does_not_stand_is_no_pose_of_a_session(session: PoseSession) -> None:
    q = session.world.body.nominal.copy()
    q[session.world.robot.joint_names.index("r_leg_kny")] += 0.2
    lifted = replace(session.pose.numbers, positions=write_pose(session.world.robot, q).positions)
    before = session.pose
    with pytest.raises(RequestError, match=r"pose: r_foot is .* mm from where it stands"):
        session.set(lifted)
    assert session.pose is before
