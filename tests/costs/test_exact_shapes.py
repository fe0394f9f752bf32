"""INFEASIBLE and a refused start come from the shapes as they were given; hulls that overlap alone say so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_arm import write_planar_arm
from scipy.spatial.transform import Rotation
from tiny_robots import atlas

from costs.primitive import make_round_shape
from costs.robot import load_robot, shapes
from costs.scene import ConvexPiece, Scene
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.errors import RequestError
from service.explain.goal import find_goal_reasons
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.result import Verdict
from service.start.overlaps import ExactShape
from service.start.standing import FEET_GROUP
from service.verify import PoseTarget

SEED = st.integers(0, 10_000)
ARM_END_M = 0.6  # of three links of 0.2 m, 40 mm thick


def _piece(kind: str, rng: np.random.Generator, scale: float) -> tuple[ConvexPiece, float]:
    """A random shape about the origin, and by how much its hull may exceed it [m]."""
    size = tuple(rng.uniform(0.01, 0.3, {"sphere": 1, "box": 3}.get(kind, 2)) * scale)
    vertices = shapes.box(np.array(size)) if kind == "box" else getattr(shapes, kind)(*size)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    exact = make_round_shape(kind, size)
    moved = None if exact is None else exact.move(pose)
    return ConvexPiece(kind, vertices @ pose[:3, :3].T, exact=moved), 0.0 if exact is None else shapes.allowed_excess(
        size[0]
    )


def _shifted(piece: ConvexPiece, offset: np.ndarray) -> ConvexPiece:
    pose = np.eye(4)
    pose[:3, 3] = offset
    exact = None if piece.exact is None else piece.exact.move(pose)
    return ConvexPiece(piece.name, piece.vertices + offset, exact=exact)


@pytest.mark.parametrize("second", ["sphere", "cylinder", "capsule", "box"])
@pytest.mark.parametrize("first", ["sphere", "cylinder", "capsule"])
@given(seed=SEED)
@settings(max_examples=15)
def test_shapes_are_as_deep_as_their_hulls_less_what_the_hulls_exceed_them(first: str, second: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    (one, excess), (other, more) = _piece(first, rng, 1.0), _piece(second, rng, 10.0 ** rng.uniform(0.0, 1.5))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    apart = np.max(one.vertices @ direction) - np.min(other.vertices @ direction)
    placed = _shifted(other, (apart + rng.uniform(-0.05, 0.05)) * direction)
    exact = ExactShape.of(one).depth_in(ExactShape.of(placed))
    hull = ExactShape.of_hull(one).depth_in(ExactShape.of_hull(placed))
    assert exact <= hull + 1e-5
    assert hull - exact <= excess + more + 1e-5


def test_depths_of_round_shapes_are_those_worked_out_by_hand() -> None:
    ball = make_round_shape("sphere", (0.1,))
    tube = make_round_shape("cylinder", (3.0, 5.0))
    assert ball is not None
    assert tube is not None
    beside = np.eye(4)
    beside[0, 3] = 3.05
    one, other = (ConvexPiece(p.kind, shapes.box(np.ones(3)), exact=p) for p in (ball.move(beside), tube))
    assert ExactShape.of(one).depth_in(ExactShape.of(other)) == pytest.approx(0.05, abs=1e-6)
    beside[0, 3] = 2.5  # its centre is inside, where coal's own shortcut for the two is metres off
    inside = ConvexPiece("ball", shapes.box(np.ones(3)), exact=ball.move(beside))
    assert ExactShape.of(inside).depth_in(ExactShape.of(other)) == pytest.approx(0.6, abs=1e-6)


def _request(folder: Path, obstacles: list[dict[str, object]], **more: object) -> PlanRequest:
    """An arm that turns in the plane from -1 rad until it is stretched along x."""
    urdf = write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0)
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"obstacles": obstacles, "floor": False},
            "start": {"joints": {"j0": -1.0}},
            "goal": {"joints": {"j0": 0.0, "j1": 0.0, "j2": 0.0}},
            **more,
        }
    )


def _ball(gap: float, radius: float = 10.0) -> dict[str, object]:
    """A sphere whose surface is ``gap`` before the tip of the stretched arm."""
    return {"name": "ball", "type": "sphere", "radius": radius, "position": [ARM_END_M + gap + radius, 0.02, 0.02]}


def test_a_large_sphere_beside_the_goal_does_not_make_it_infeasible(tmp_path: Path) -> None:
    # the hull of a sphere of 10 m exceeds it by up to 100 mm
    result = plan(_request(tmp_path, [_ball(0.105)]))
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_a_goal_nearer_than_the_hulls_resolve_is_not_found_and_told_with_its_distance(tmp_path: Path) -> None:
    result = plan(_request(tmp_path, [_ball(0.012)]))
    assert result.verdict is Verdict.NOT_FOUND
    (line,) = result.explanation
    start = "the goal is too near to plan to: l2 is 12 mm from ball (obstacle), nearer than the planner's hulls resolve"
    assert line.startswith(start)
    assert result.motion is None


def test_a_goal_in_a_sphere_is_infeasible_and_told_with_the_depth_in_the_sphere(tmp_path: Path) -> None:
    result = plan(_request(tmp_path, [_ball(-0.0076)]))
    assert result.verdict is Verdict.INFEASIBLE
    assert result.explanation == ("the goal is in collision: l2 is 7.6 mm inside ball (obstacle)",)


def test_a_start_nearer_than_the_hulls_resolve_is_not_found_and_may_be_left_first(tmp_path: Path) -> None:
    start, goal = {"joints": {"j0": 0.0}}, {"joints": {"j0": -1.0, "j1": 0.0, "j2": 0.0}}
    beside = _ball(0.0) | {"position": [0.5, 0.02 + 0.012 + 10.0, 0.02]}
    result = plan(_request(tmp_path, [beside], start=start, goal=goal))
    assert result.verdict is Verdict.NOT_FOUND
    told = (
        "the start is too near to plan from: l2 is 12 mm from ball (obstacle), nearer than the planner's hulls resolve"
    )
    assert any(line.startswith(told) for line in result.explanation)
    left = plan(_request(tmp_path, [beside], start=start, goal=goal, options={"escape": True}))
    assert left.verdict is Verdict.CERTIFIED, left.explanation
    assert any(note.startswith(told) and note.endswith("mm; the first phase leaves it") for note in left.notes)
    with pytest.raises(RequestError, match=r"start is in collision: l2 is 7\.6 mm inside ball \(obstacle\)"):
        plan(_request(tmp_path, [_ball(-0.0076)], start=start, goal=goal))


def test_a_pose_that_only_hulls_bring_into_collision_is_not_called_infeasible(tmp_path: Path) -> None:
    # l2's frame is at its joint, 0.2 m before the tip; turned about z by nothing it points at the sphere
    goal = {"poses": [{"link": "l2", "position": [0.4, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}]}
    near = plan(_request(tmp_path, [_ball(0.012)], goal=goal))
    assert near.verdict is Verdict.NOT_FOUND
    assert (
        "turned as requested, l2 is 12 mm from ball (obstacle), nearer than the planner's hulls" in near.explanation[0]
    )
    inside = plan(_request(tmp_path, [_ball(-0.02)], goal=goal))
    assert inside.verdict is Verdict.INFEASIBLE
    assert "turned as requested, l2 is 20 mm inside ball (obstacle)" in inside.explanation[0]


def test_a_link_keeps_the_round_shape_of_its_description(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"/><link name="a"><collision><origin xyz="0.1 0 0" rpy="0 1.5 0"/>'
        '<geometry><capsule radius="0.05" length="0.2"/></geometry></collision></link>'
        '<joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    (body,) = load_robot(urdf=urdf).bodies
    assert body.exact is not None
    assert (body.exact.kind, body.exact.radius, body.exact.length) == ("capsule", 0.05, 0.2)
    np.testing.assert_allclose(body.exact.pose[:3, 3], [0.1, 0.0, 0.0])
    axis = body.exact.pose[:3, 2]
    assert np.abs(body.vertices @ axis - 0.1 * axis[0]).max() <= 0.1 + 0.05 + 0.002


@given(seed=SEED)
@settings(max_examples=30)
def test_a_link_said_to_be_in_a_round_shape_is_in_it_at_every_pose_within_tolerance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = atlas()
    piece = _shifted(_piece(("sphere", "cylinder", "capsule")[seed % 3], rng, 1.0)[0], np.array([0.6, 0.2, 1.0]))
    tolerance, turn = rng.uniform(1e-3, 0.02), rng.uniform(1e-3, 0.1)
    position = piece.vertices.mean(axis=0) + rng.normal(scale=0.15, size=3)
    rotation = Rotation.random(random_state=seed)
    body = WholeBody.standing(robot, Scene((piece,)), robot.postures["stand"], robot.link_groups[FEET_GROUP], Aims())
    target = PoseTarget("l_tool", position, rotation.as_matrix(), np.full(3, tolerance), np.full(3, turn), 0.0)
    frame = robot.model.frames[robot.model.getFrameId("l_tool")]
    shape = ExactShape.of(piece)
    for line in find_goal_reasons(body, [target]).impossible:
        link = line.rsplit(" is ", 1)[0].split()[-1]
        carried = [one for one in robot.bodies if one.link == link]
        for _ in range(20):
            axis = rng.uniform(-turn, turn, 3) / np.sqrt(3.0)
            pose = np.eye(4)
            pose[:3, :3] = (rotation * Rotation.from_rotvec(axis)).as_matrix()
            pose[:3, 3] = position + rng.uniform(-1.0, 1.0, 3) * tolerance
            pose_joint = pose @ np.linalg.inv(frame.placement.homogeneous)
            assert max(ExactShape.of(one).depth_in(shape, pose_joint) for one in carried) > 0.0, line
