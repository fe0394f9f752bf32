"""Rods in the hook's way, called like the rim that it may touch: no name earns an allowance."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shared_plans import copy_undrawn, plan_once, write_once
from stranger import check_folder

from costs.allowance import BodyRef
from costs.robot import shapes
from costs.robot.model import LinkBody
from costs.scene import ConvexPiece, Scene
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.replay import read_motion, verify_result
from service.request.file import parse_request
from service.verify import Status, VerifyError, verify

DEPTH = 0.013  # of the rods in the hook [m]; 30 mm are allowed in the rim


def valve_request(obstacles=()):
    valve = {
        "centre": [0.68, 0.12, 1.1],
        "axis": [-1.0, 0.0, 0.0],
        "radius": 0.14,
        "turn_deg": 90,
        "hand": "left",
        "spokes_deg": [45, 135, 225, 315],
    }
    start = {"posture": "reach_ready"}
    return parse_request(
        {"robot": {"name": "atlas"}, "start": start, "scene": {"obstacles": list(obstacles)}, "task": {"valve": valve}}
    )


@pytest.fixture(scope="module")
def turned():
    """A certified turn of a valve in free space."""
    return plan_once(valve_request())


def rod_places(motion):
    """Centres of small boxes that the hook is 13 mm deep in, once in the middle of the turn and once at its end."""
    turn = next(phase for phase in motion.phases if phase.name == "turn")
    data = motion.robot.model.createData()
    places = []
    for q in motion.curve(np.array([0.5 * (turn.first + turn.last), turn.last])):
        pin.forwardKinematics(motion.robot.model, data, q)
        hook = next(body for body in motion.robot.bodies if body.link == "l_hook")
        vertices = hook.vertices @ data.oMi[hook.joint].rotation.T + data.oMi[hook.joint].translation
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        places.append(np.array([vertices[:, 0].max() - DEPTH + 0.025, middle[1], middle[2]]))
    return places


def rods(motion, names):
    box = shapes.box(np.array([0.05, 0.02, 0.02]))
    return tuple(ConvexPiece(name, box + at) for name, at in zip(names, rod_places(motion), strict=False))


def with_rods(motion, *names):
    return replace(motion, scene=Scene((*motion.scene.pieces, *rods(motion, names))))


@pytest.mark.parametrize("name", ["valve/rim/x", "valve/rim/*", "valve/rim/20", "*", "l_hook/1", "valve_turn"])
def test_rods_that_the_hook_goes_into_are_refuted_whatever_they_are_called(turned, name):
    certificate = verify(with_rods(turned.motion, name, f"{name}/0"))
    assert certificate.status is Status.VIOLATED
    deep = [check for check in certificate.failed() if "l_hook" in check.where.names]
    assert any(check.value == pytest.approx(-DEPTH, abs=1e-3) for check in deep)
    assert not any(name in exempt.pair for exempt in certificate.exempt)


@pytest.mark.parametrize(
    ("name", "owner"), [("valve/rim/7", "mechanism"), ("valve", "mechanism"), ("l_hook", "robot"), ("l_tool", "robot")]
)
def test_a_motion_in_which_a_piece_has_the_name_of_something_else_is_refused(turned, name, owner):
    problem = f"'{name}' is a name in the {owner} and in the scene; names must be unique"
    with pytest.raises(VerifyError, match=problem):
        verify(with_rods(turned.motion, name))


def test_a_motion_in_which_two_bodies_have_one_name_is_refused(turned):
    motion, bodies = turned.motion, turned.motion.robot.bodies
    rim = next(body for body in bodies if body.name == "valve/rim/7")
    hand = next(body for body in bodies if body.name == "l_hand")
    renamed = LinkBody("l_hand", rim.link, rim.joint, rim.vertices, rim.outer)
    for changed, problem in (
        (tuple(renamed if body is rim else body for body in bodies), "two bodies are named 'l_hand'"),
        (
            tuple(renamed if body is rim else body for body in bodies if body is not hand),
            "'l_hand' is a name in the robot and in the mechanism",
        ),
    ):
        with pytest.raises(VerifyError, match=problem):
            verify(replace(motion, robot=replace(motion.robot, bodies=changed)))


def test_a_request_cannot_call_its_rods_like_the_rim(turned):
    at = rod_places(turned.motion)[0].tolist()
    rod = {"type": "box", "size": [0.05, 0.02, 0.02], "position": at}
    with pytest.raises(RequestError) as caught:
        plan(valve_request([{"name": "valve/rim/x", **rod}, {"name": "valve/rim/7", **rod}]))
    assert [line.split(";")[0] for line in caught.value.problems] == [
        f"scene.obstacles[{k}].name: {name!r} is the valve that the task moves, or a part of it"
        for k, name in enumerate(("valve/rim/x", "valve/rim/7"))
    ]


NAMES = (
    st.sampled_from(["valve/rim/*", "valve", "l_hook", "*", "None"])
    | st.from_regex(r"valve/rim/[0-9]{1,2}")
    | st.text(max_size=9)
)


@given(name=NAMES)
def test_nothing_but_the_floor_is_allowed_to_be_touched_in_the_scene(turned, name):
    motion, ref = turned.motion, BodyRef.of_piece(name)
    own = [BodyRef.of_body(body, motion.mechanism_links) for body in motion.robot.bodies]
    allowances = [allowance for phase in motion.phases for allowance in phase.allowances]
    assert any(allowance.covers(one, BodyRef.of_piece("floor")) for allowance in allowances for one in own)
    assert name == "floor" or not any(allowance.covers(one, ref) for allowance in allowances for one in own)


@pytest.fixture
def folder(tmp_path):
    """The turn's folder, to be edited."""
    return copy_undrawn(write_once(valve_request()), tmp_path / "out")


def edit(folder, change):
    data = json.loads((folder / "result.json").read_text())
    change(data)
    (folder / "result.json").write_text(json.dumps(data))


@pytest.mark.parametrize("name", ["valve/rim/x", "valve/rim/7", "l_hook"])
def test_a_folder_with_rods_called_like_what_may_be_touched_is_not_certified(turned, folder, name):
    (rod,) = rods(turned.motion, [name])

    def add_rod(data):
        data["pieces"].append({"name": name, "kind": "rim", "vertices": rod.vertices.tolist()})

    edit(folder, add_rod)
    with pytest.raises(ResultError, match=f"the scene has {name}, which the request does not"):
        verify_result(folder)
    if name == "valve/rim/x":
        return
    with pytest.raises(VerifyError, match=f"'{name}' is a name in the .* and in the scene"):
        verify(read_motion(json.loads((folder / "result.json").read_text()), folder))
    code, said = check_folder(folder)
    assert code == 1
    assert said.startswith("two bodies or pieces have one name")


def test_an_allowance_moved_to_the_scene_lets_nothing_of_the_wheel_be_touched(folder):
    def give_away(data):
        for phase in data["phases"]:
            for allowance in phase["allowances"]:
                if allowance["second"]["owner"] == "mechanism":
                    allowance["second"] = {"owner": "scene", "link": None, "body": allowance["second"]["body"]}

    edit(folder, give_away)
    with pytest.raises(ResultError, match="allowances of phase 'turn' are not those of the request"):
        verify_result(folder)
    certificate = verify(read_motion(json.loads((folder / "result.json").read_text()), folder))
    # The hook is in a wide gap here and needs no allowance; what is left of them exempts nothing of the wheel.
    assert not any("valve" in name for exempt in certificate.exempt for name in exempt.pair)


@pytest.mark.parametrize(
    ("second", "problem"),
    [
        ({"owner": "scene", "link": None, "body": None}, "a reference to the scene needs"),
        ({"owner": "any", "link": "valve", "body": None}, "owner is 'any'"),
        ({"owner": "mechanism", "link": "valve"}, "lacks 'body'"),
        ({"owner": "mechanism", "link": ["valve"], "body": None}, "a reference to the mechanism needs"),
    ],
)
def test_an_allowance_that_says_less_than_whose_body_it_is_is_refused(folder, second, problem):
    edit(folder, lambda data: data["phases"][1]["allowances"][-1].update(second=second))
    with pytest.raises(ResultError, match=problem):
        verify_result(folder)


def test_an_object_with_one_key_twice_is_refused(folder):
    path = folder / "result.json"
    path.write_text(path.read_text().replace('"pieces":', '"pieces": [], "pieces":', 1))
    with pytest.raises(ResultError, match="an object has the key 'pieces' twice"):
        verify_result(folder)


@pytest.mark.parametrize("part", ["bodies", "pieces"])
def test_a_body_or_piece_that_is_listed_twice_is_refused(folder, part):
    edit(folder, lambda data: data[part].insert(0, {**data[part][0], "vertices": [[9.0, 9.0, 9.0]]}))
    with pytest.raises(ResultError, match=r"bodies are not those|piece names must be unique"):
        verify_result(folder)
