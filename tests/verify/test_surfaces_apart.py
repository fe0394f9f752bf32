"""Links whose hulls overlap and whose meshes do not: proven by their triangles, refuted where these meet."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.native import find_library, without_library
from costs.robot import LinkSurface, RobotModel, load_robot, read_surface
from service.planner import plan
from service.request.file import parse_request
from service.result.result import PlanResult
from service.verify.coverage import apart
from service.verify.coverage.apart import LinkPairSpace
from service.verify.coverage.surface_gap import HeldSurface
from service.verify.joint_chain import JointTree

FACES = [
    (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
    (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
]  # fmt: skip
FORK = (
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.02)), ((-0.1, -0.1, 0.02), (-0.08, 0.1, 0.2)),
    ((0.08, -0.1, 0.02), (0.1, 0.1, 0.2)),
)  # fmt: skip
URDF = """<robot name="pendulum">
<link name="fork"><collision><geometry><mesh filename="fork.obj"/></geometry></collision></link>
<link name="pivot"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
<link name="rod"><collision><origin xyz="0 0 -0.325"/>
<geometry><box size="0.05 0.05 0.5"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="fork"/><child link="pivot"/><origin xyz="0 0 0.75"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="9"/></joint>
<joint name="swing" type="revolute"><parent link="pivot"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>"""
PLACE = st.tuples(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0))
SIZE = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 0.5))
SRDF = """<robot name="pendulum"><disable_collisions link1="fork" link2="rod" reason="Never"/>
<disable_collisions link1="fork" link2="pivot" reason="Adjacent"/>
<disable_collisions link1="pivot" link2="rod" reason="Adjacent"/></robot>"""


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pendulum")
    lines = [
        "v " + " ".join(str(2.5 * box[(corner >> k) & 1][k]) for k in range(3)) for box in FORK for corner in range(8)
    ]
    lines += [f"f {a + 1 + 8 * k} {b + 1 + 8 * k} {c + 1 + 8 * k}" for k in range(len(FORK)) for a, b, c in FACES]
    (folder / "fork.obj").write_text("\n".join(lines) + "\n")
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.srdf").write_text(SRDF)
    return folder


@pytest.fixture(scope="module", name="robot")
def _robot(folder: Path) -> RobotModel:
    return load_robot(urdf=folder / "arm.urdf", srdf=folder / "arm.srdf")


def _swing(folder: Path, angle: float) -> PlanResult:
    robot = {"urdf": "arm.urdf", "srdf": "arm.srdf"}
    goal = {"joints": {"turn": 0.3, "swing": angle}}
    ball = {"type": "sphere", "name": "ball", "radius": 0.1, "position": [1.5, 0.0, 0.3]}
    scene = {"floor": False, "obstacles": [ball]}
    return plan(parse_request({"robot": robot, "goal": goal, "scene": scene}, folder))


@pytest.mark.parametrize("most_coordinates", [4, 1], ids=["cells", "along the motion"])
def test_a_rod_that_turns_within_a_fork_is_certified_and_one_that_meets_it_is_not(
    folder: Path, monkeypatch: pytest.MonkeyPatch, most_coordinates: int
) -> None:
    monkeypatch.setattr(apart, "_MOST_COORDINATES", most_coordinates)
    within = _swing(folder, 0.1)
    assert within.verdict.value == "CERTIFIED", within.explanation
    check = next(check for check in within.certificate.checks if check.name == "coverage.surfaces")
    assert "the meshes of 1 pair of links that are left out keep at least" in check.text
    meets = _swing(folder, 0.6)
    assert meets.verdict.value == "FEASIBLE_AT_SAMPLES"
    names = {check.name for check in meets.certificate.checks}
    assert "coverage.overlap.fork.rod" in names
    assert "coverage.surfaces" not in names


def _measure(first: LinkSurface, at_first: np.ndarray, second: LinkSurface, at_second: np.ndarray) -> float:
    """Return the distance of two surfaces by coal's own method for meshes."""
    meshes = []
    for surface in (first, second):
        mesh = coal.BVHModelOBBRSS()
        mesh.beginModel(len(surface.triangles), len(surface.vertices))
        points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        points.extend(list(surface.vertices))
        triangles.extend([coal.Triangle(*corners) for corners in surface.triangles.tolist()])
        mesh.addSubModel(points, triangles)
        mesh.endModel()
        meshes.append(mesh)
    poses = [coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (at_first, at_second)]
    return float(coal.distance(meshes[0], poses[0], meshes[1], poses[1], coal.DistanceRequest(), coal.DistanceResult()))


def _read(robot: RobotModel) -> tuple[LinkSurface, LinkSurface]:
    fork, rod = read_surface(robot, "fork"), read_surface(robot, "rod")
    assert fork is not None
    assert rod is not None
    return fork, rod


def _space(robot: RobotModel) -> LinkPairSpace:
    fork, rod = _read(robot)
    return LinkPairSpace(robot.model, JointTree(robot.model, np.full(robot.n, 3.0), 0), fork, rod)


@settings(max_examples=12, deadline=None)
@given(
    st.tuples(st.floats(-3, 3), st.floats(-1, 1)), st.tuples(st.floats(0, 1), st.floats(0, 0.5)), st.integers(0, 999)
)
def test_a_proven_gap_bounds_the_distance_at_every_place_of_the_box(
    robot: RobotModel, low: tuple[float, float], width: tuple[float, float], seed: int
) -> None:
    import pinocchio as pin

    lower, upper = np.array(low)[None], np.array(low)[None] + np.array(width)
    gap = _space(robot).prove(lower, upper, lower)
    fork, rod = _read(robot)
    data, distances = robot.model.createData(), []
    for share in np.random.default_rng(seed).uniform(0.0, 1.0, (5, 2)):
        pin.forwardKinematics(robot.model, data, lower[0] + share * (upper - lower)[0])
        distances.append(_measure(fork, np.eye(4), rod, data.oMi[rod.joint].homogeneous))
    assert gap <= min(distances) + 1e-6
    if gap == 0.0:  # no proof is missing where there is much room
        corners = [lower[0] + np.array(share) * (upper - lower)[0] for share in product(np.linspace(0, 1, 9), repeat=2)]
        for q in corners:
            pin.forwardKinematics(robot.model, data, q)
            distances.append(_measure(fork, np.eye(4), rod, data.oMi[rod.joint].homogeneous))
        assert min(distances) < 0.01


def test_a_surface_knows_what_is_inside_it_and_what_is_beyond_a_ball(robot: RobotModel) -> None:
    fork, _ = _read(robot)
    inside = fork.holds(np.array([[0.0, 0.0, 0.02], [0.22, 0.0, 0.25], [0.0, 0.0, 0.25], [1.0, 0.0, 0.0]]))
    assert inside.tolist() == [True, True, False, False]
    assert len(fork.samples) == 1  # its boxes share corners
    far = fork.beyond(np.array([0.0, 0.0, 0.2]), 0.16)
    assert np.linalg.norm(far.vertices - [0.0, 0.0, 0.2], axis=1).max() > 0.18
    assert np.linalg.norm(far.vertices - [0.0, 0.0, 0.2], axis=1).min() > 0.16 - 0.03


@pytest.mark.skipif(find_library() is None, reason="the library was not built")
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_without_the_library_gaps_are_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    held = HeldSurface(LinkSurface(0, rng.uniform(-1, 1, (9, 3)), np.arange(9).reshape(-1, 3), has_mesh=True))
    points = rng.uniform(-0.1, 0.1, (2, 6, 3)) + rng.uniform(-1, 1, 3)
    triangles, stray = np.arange(6).reshape(-1, 3), rng.uniform(0, 0.02, 6)
    compiled = held.bound_gap(triangles, points, stray)
    with without_library():
        assert held.bound_gap(triangles, points, stray) == pytest.approx(compiled, abs=1e-5)
