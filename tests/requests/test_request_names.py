"""Names in a request: an obstacle, a carried body or a scanned piece is never called like a part of something else."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_arm import write_planar_arm
from tiny_robots import atlas

from costs.scene import ConvexPiece
from service.errors import RequestError
from service.request.file import parse_request
from service.request.names import TakenNames, check_names, rename_clashing
from service.setup.prepare import prepare
from service.setup.world import Surroundings

CORNERS = np.array([[x, y, z] for x in (5.0, 5.1) for y in (0.0, 0.1) for z in (0.5, 0.6)])
TURN = {"task": {"valve": {"centre": [0.68, 0.12, 1.1], "axis": [-1, 0, 0], "radius": 0.14}}}
REACH = {"goal": {"joints": {"back_bkz": 0.2}}}
MESH = (
    "solid t\n"
    + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in face)
        + "endloop\nendfacet\n"
        for face in (
            [(0, 0, 0), (0, 1, 0), (1, 0, 0)],
            [(0, 0, 0), (1, 0, 0), (0, 0, 1)],
            [(0, 0, 0), (0, 0, 1), (0, 1, 0)],
            [(1, 0, 0), (0, 1, 0), (0, 0, 1)],
        )
    )
    + "endsolid t\n"
)


def crate(name):
    return {"name": name, "type": "box", "size": [0.1, 0.1, 0.1], "position": [5, 0, 1]}


def asked(*names, does=REACH, **more):
    return parse_request(
        {"robot": {"name": "atlas"}, "scene": {"obstacles": [crate(n) for n in names]}, **does, **more}
    )


def refused(request):
    with pytest.raises(RequestError) as caught:
        prepare(request)
    return caught.value.problems


@pytest.mark.parametrize(
    ("name", "does", "owner"),
    [
        ("l_hand", REACH, "a link of atlas"),
        ("l_tool", REACH, "a link of atlas"),
        ("utorso/1", REACH, "a body of atlas"),
        ("valve", TURN, "the valve that the task moves, or a part of it"),
        ("valve/rim/x", TURN, "the valve that the task moves, or a part of it"),
    ],
)
def test_an_obstacle_that_has_the_name_of_something_else_is_refused_with_field_name_and_owner(name, does, owner):
    line = f"scene.obstacles[1].name: {name!r} is {owner}; expected another name"
    assert refused(asked("crate", name, does=does)) == (line,)


@pytest.mark.parametrize("name", ["valve", "valve/rim/x", "l_hand2", "l_hand/x", "l_arm_elx", "l_h*"])
def test_names_that_nothing_else_has_are_taken_as_they_are(name):
    assert [piece.name for piece in prepare(asked(name)).scene.pieces] == [name, "floor"]


def test_a_carried_body_is_a_link_whose_name_no_obstacle_has():
    beam = {"name": "beam", "link": "l_hand", "type": "box", "size": [0.05, 0.05, 0.3], "position": [0, 0, -0.3]}
    line = "scene.obstacles[0].name: 'beam' is a link of atlas; expected another name"
    assert refused(asked("beam", attached=[beam])) == (line,)
    line = "attached[0].name: 'valve' is also the valve that the task moves, or a part of it; expected another name"
    assert refused(asked(does=TURN, attached=[{**beam, "name": "valve"}])) == (line,)


def test_a_robot_that_has_a_valve_of_its_own_turns_none(tmp_path):
    urdf = write_planar_arm(tmp_path, 2, 0.2, 0.04, limit=3.0)
    text = urdf.read_text().replace('"l1"', '"valve"').replace('"j1"', '"valve_turn"')
    urdf.write_text(text)
    request = parse_request({"robot": {"urdf": str(urdf)}, **TURN})
    assert refused(request) == (
        "robot: 'valve' is also the valve that the task moves, or a part of it; expected another name",
        "robot: 'valve_turn' is also a joint of the valve that the task moves; rename it",
    )


def test_the_numbered_pieces_of_a_mesh_are_no_links_either(tmp_path):
    urdf = write_planar_arm(tmp_path, 2, 0.2, 0.04, limit=3.0)
    urdf.write_text(urdf.read_text().replace('"l1"', '"rock/1"'))
    (tmp_path / "rock.stl").write_text(MESH)
    rock = {"name": "rock", "type": "mesh", "file": str(tmp_path / "rock.stl"), "position": [5, 0, 0]}
    request = {"robot": {"urdf": str(urdf)}, "scene": {"obstacles": [rock]}, "goal": {"joints": {"j0": 0.5}}}
    line = "scene.obstacles[0].name: 'rock/1' is a link of arm; expected another name"
    assert refused(parse_request(request)) == (line,)
    box = {**crate("rock"), "position": [5, 0, 0]}
    assert prepare(parse_request({**request, "scene": {"obstacles": [box]}})).scene.pieces[0].name == "rock"


def test_a_piece_of_a_scenes_file_that_has_the_name_of_a_link_is_refused(tmp_path):
    piece = {"name": "l_hand", "kind": "clutter", "vertices": CORNERS.tolist()}
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({"format": "scopt-scene/1", "pieces": [piece], "detections": []}))
    request = parse_request({"robot": {"name": "atlas"}, "scene": {"file": str(path)}, **REACH})
    assert refused(request) == ("scene.file: piece 'l_hand' is a link of atlas; expected another name",)


def test_pieces_of_a_scan_get_another_name_where_theirs_is_taken(monkeypatch, tmp_path):
    urdf = write_planar_arm(tmp_path, 2, 0.2, 0.04, limit=3.0)
    urdf.write_text(urdf.read_text().replace('"l1"', '"floor"').replace('"l0"', '"wall/0"'))
    seen = tuple(ConvexPiece(name, CORNERS, name.split("/")[0]) for name in ("wall/0", "clutter/0", "floor"))
    monkeypatch.setattr("service.setup.prepare.read_surroundings", lambda *given: Surroundings(seen))
    request = {
        "robot": {"urdf": str(urdf)},
        "scene": {"obstacles": [crate("clutter/0")]},
        "goal": {"joints": {"j0": 0.5}},
    }
    setup = prepare(parse_request(request))
    assert [(piece.name, piece.kind) for piece in setup.scene.pieces] == [
        ("clutter/0", "obstacle"),
        ("wall/0-2", "wall"),
        ("clutter/0-2", "clutter"),
        ("floor-2", "floor"),
    ]
    assert setup.notes[-3:] == (
        "scene: what the scan shows as 'wall/0' is called 'wall/0-2': it is a link of arm",
        "scene: what the scan shows as 'clutter/0' is called 'clutter/0-2': it is an obstacle of the request",
        "scene: what the scan shows as 'floor' is called 'floor-2': it is a link of arm",
    )
    flat = parse_request({**request, "scene": {"floor": -1.0}})
    monkeypatch.setattr("service.setup.prepare.read_surroundings", lambda *given: Surroundings(()))
    assert [piece.name for piece in prepare(flat).scene.pieces] == ["floor-2"]


OWN = [body.name for body in atlas().bodies] + [frame.name for frame in atlas().model.frames]
TRICKY = st.sampled_from([*OWN, "valve", "valve_turn", "floor", *(f"valve/rim/{k}" for k in range(22))])
NAMES = (
    TRICKY | st.builds("{}/{}".format, TRICKY, st.integers(0, 9)) | st.builds("{}{}".format, TRICKY, st.text("* /x"))
)


@settings(max_examples=300, deadline=None)
@given(NAMES, st.booleans())
def test_an_accepted_name_is_nobodys(name, turns):
    robot = atlas()
    try:
        request = asked(name, does=TURN if turns else REACH)
        check_names(request, robot, TakenNames.of(robot, request))
    except RequestError:
        return
    links = {frame.name for frame in robot.model.frames if robot.model.existBodyName(frame.name)}
    assert name not in links | {body.name for body in robot.bodies} | {body.link for body in robot.bodies}
    assert not turns or name.partition("/")[0] != "valve"


@given(st.lists(NAMES, unique=True, max_size=6), st.lists(NAMES, unique=True, max_size=4))
def test_renamed_pieces_are_nobodys_and_unique(names, others):
    taken = TakenNames.of(atlas(), asked("crate", does=TURN))
    pieces, notes = rename_clashing([ConvexPiece(name, CORNERS) for name in names], taken, others)
    now = [piece.name for piece in pieces]
    assert len({*now, *others}) == len(now) + len(others)
    assert not any(taken.owner(name) for name in now)
    kept = [name for name in names if not taken.owner(name) and name not in others]
    assert [name for name in now if name in names] == kept
    assert len(notes) == len(names) - len(kept)
