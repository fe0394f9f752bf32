"""What hands hold while something else is done: idle hands stay, and what is put down later is upright before."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from service.body.whole_body import Aims, WholeBody
from service.demands.grasping.gripper import list_grippers
from service.demands.steps.compile import compile_step
from service.demands.steps.extent import NamedStep
from service.demands.steps.holding import Holding
from service.demands.steps.phases import StepPhase
from service.request.file import parse_request
from service.tasks.steps.choices import Pick, find_blocked, list_choices, list_off_middle
from service.tasks.steps.plan import list_kept_joints
from service.tasks.steps.refusals import is_built_in

CAN = {"type": "cylinder", "radius": 0.03, "height": 0.12, "mass_kg": 0.5}
STEPS = [
    {"grasp": {"object": "a", "hand": "right"}},
    {"grasp": {"object": "b", "hand": "left"}},
    {"move": {"posture": "stand"}},
    {"body": {"pelvis_m": [0, 0, -0.05], "hands": "along"}},
    {"move": {"poses": [{"link": "a", "position": [0.5, -0.2, 1.0]}]}},
    {"follow": {"frame": "b", "tool_axis": "-z", "face": {"point": [0.5, 0, 0.9], "normal": [0, 0, 1]},
                "polyline": [[0.5, 0.2, 0.9], [0.5, 0.3, 0.9]]}},
    {"release": {"object": "a"}},
]  # fmt: skip


@pytest.fixture(scope="module", name="compiled")
def _compiled() -> tuple[Holding, dict[str, StepPhase], np.ndarray]:
    """Return what is held, phases by name, and where they begin: both hands hold a can, the right one leans."""
    robot = load_robot("atlas", hand="gripper")
    objects: list[dict[str, Any]] = [
        {"name": name, **CAN, "position": [0.5, y, 0.96]} for name, y in (("a", -0.3), ("b", 0.3))
    ]
    request = parse_request({"robot": {"name": "atlas", "hand": "gripper"}, "scene": {"objects": objects},
                             "task": {"steps": STEPS}})  # fmt: skip
    section, q = request.section, robot.postures["reach_ready"]
    holding = Holding.of(section, request, robot, Scene(()))  # type: ignore[arg-type]
    for name, side in (("a", "right"), ("b", "left")):
        holding = holding.take(name, tuple(g for g in list_grippers(robot, "auto") if g.side == side), 60.0, q)
    leaning = q.copy()
    leaning[robot.joint_names.index("r_arm_wrx")] += 0.1
    phases = {}
    for named in NamedStep.list_all(section)[2:-1]:  # type: ignore[arg-type]
        phases |= {maker.name: maker.make(leaning) for maker in compile_step(holding, named)}
    last = NamedStep.list_all(section)[-1]  # type: ignore[arg-type]
    assert last.step.release is not None
    put, opened = holding.let_go(last.step.release, "release", leaning)
    phases |= {maker.name: maker.make(leaning) for maker in compile_step(put, last, None, opened)}
    return holding, phases, leaning


@pytest.mark.parametrize(
    ("phase", "kept"),
    [("3 move", set()), ("4 body", set()), ("5 move", {"l_tool"}), ("7 release: leave", {"l_tool"})],
)
def test_hands_that_hold_something_stay_unless_a_step_moves_them(compiled, phase, kept):
    assert {frame for frame, _ in compiled[1][phase].kept} == kept


def test_what_is_put_down_later_is_brought_upright_with_the_least_turn(compiled):
    holding, phases, q = compiled
    before = holding.locate("a", q)[:3, :3]
    goal = phases["5 move"].goal
    assert goal is not None
    wanted = Rotation.from_quat(goal.poses[0].quaternion_wxyz, scalar_first=True).as_matrix()
    tilt = np.arccos(before[2, 2])
    assert 0.05 < tilt < 0.2
    assert_allclose(wanted[2], [0.0, 0.0, 1.0], atol=1e-9)
    assert Rotation.from_matrix(wanted @ before.T).magnitude() == pytest.approx(tilt)


def test_a_path_leads_the_axis_that_points_into_its_face(compiled):
    goal = compiled[1]["6 follow: reach"].goal
    assert goal is not None
    turned = Rotation.from_quat(goal.poses[0].quaternion_wxyz, scalar_first=True)
    assert_allclose(turned.apply([0.0, 0.0, -1.0]), [0.0, 0.0, -1.0], atol=1e-9)
    (led,) = compiled[1]["6 follow: path"].led
    assert_allclose(led.guide.rotation @ [0.0, 0.0, -1.0], [0.0, 0.0, -1.0], atol=1e-9)
    assert_allclose(led.free_axis, [0.0, 0.0, -1.0])


def test_fingers_and_arms_that_hold_something_do_not_move_while_feet_walk(compiled):
    joints = list_kept_joints(compiled[0])
    assert {name for name in joints if name.startswith("back")} == set()
    assert {f"{side}_arm_{joint}" for side in "lr" for joint in ("shz", "elx", "wrx")} <= joints
    assert {joint for hold in compiled[0].held.values() for joint in hold.fingers} <= joints


def _box(name: str, low: tuple[float, float, float], high: tuple[float, float, float]) -> ConvexPiece:
    return ConvexPiece(name, np.array(list(itertools.product(*zip(low, high, strict=True)))))


def test_a_wall_of_a_socket_is_built_in_and_a_brick_across_others_is_not():
    brick = _box("brick", (0.0, 0.0, 0.1), (0.2, 0.1, 0.15))
    beside = _box("beside", (0.2, 0.0, 0.0), (0.3, 0.1, 0.3))
    below = _box("below", (0.15, 0.0, 0.0), (0.2, 0.1, 0.1))
    above = _box("above", (0.0, 0.0, 0.15), (0.2, 0.1, 0.4))
    assert [is_built_in(brick, Scene((brick, *others))) for others in ((), (below,), (beside,), (below, above))] == [
        False, False, True, True,
    ]  # fmt: skip


def test_an_object_before_a_wall_is_taken_off_its_middle_where_that_has_no_room():
    request = parse_request({
        "robot": {"name": "atlas", "hand": "gripper"},
        "scene": {"objects": [{"name": "plug", "type": "box", "size": [0.24, 0.04, 0.04], "mass_kg": 0.3,
                               "position": [0.7, -0.3, 1.1]}]},
        "task": {"steps": [{"grasp": {"object": "plug"}}]},
    })  # fmt: skip
    robot = load_robot("atlas", hand="gripper")
    walls = Scene(
        (_box("below", (0.705, -0.4, 0.9), (0.8, -0.2, 1.079)), _box("above", (0.705, -0.4, 1.121), (0.8, -0.2, 1.3)))
    )
    holding = Holding.of(request.section, request, robot, walls)  # type: ignore[arg-type]
    body = WholeBody.standing(robot, walls, robot.postures["reach_ready"], ("l_foot", "r_foot"), Aims())
    item = holding.items["plug"]
    pick = Pick(item, request.section.steps[0].grasp, ((item.body.start, "where it is"),))  # type: ignore[union-attr]
    grippers = list_grippers(robot, "auto")
    middle = [
        choice for choice in list_choices(pick, grippers)[0] if abs(choice.grasps[0].along[0]) < 0.5
    ]  # from a side
    assert not [choice for choice in middle if find_blocked(body, pick, choice) is None]
    free = [choice for choice in list_off_middle(pick, grippers) if find_blocked(body, pick, choice) is None]
    assert free
    assert all(choice.grasps[0].pose_object_tool[0, 3] < -0.03 for choice in free)  # away from the wall
