"""Given doors, valves and mechanisms that could not be built are refused with field and distance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from given_doors import door_request
from given_mechanisms import box, cabinet_request, drawer_request, drawer_urdf, latched_request

from service.errors import RequestError
from service.planner import plan
from service.request.file import load_request, parse_request
from service.setup.prepare import prepare

HANDLE = "task.door.handle"


def refuse(request: dict[str, Any]) -> str:
    with pytest.raises(RequestError) as caught:
        prepare(parse_request(request))
    (problem,) = caught.value.problems
    return problem


def door(kind: str = "lever", opens: str = "push", **handle: Any) -> dict[str, Any]:
    request = door_request(opens, kind)
    request["task"]["door"]["handle"].update(handle)
    return request


def at(**place: float) -> list[float]:
    """A lever's place on the leaf, its hinge at (0.7, -0.45, 0.01), its face towards the robot at x = 0.655."""
    return [place.get("x", 0.6), place.get("y", 0.38), place.get("z", 1.02)]


@pytest.mark.parametrize(
    ("kind", "opens"), [("lever", "push"), ("lever", "pull"), ("pull", "pull"), ("push_bar", "push")]
)
def test_handles_on_their_leaves_are_accepted(kind: str, opens: str) -> None:
    prepare(parse_request(door(kind, opens)))


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"x": 0.205}, "0.45 m in front of the leaf's face"),
        ({"x": 0.755}, "0.10 m behind the leaf's face"),
        ({"y": 0.55}, "0.10 m beyond the leaf's free edge"),
        ({"y": -0.75}, "0.30 m beside the hinge, off the leaf"),
        ({"z": 2.31}, "0.30 m above the leaf's top"),
        ({"z": -0.19}, "0.20 m below the leaf's lower edge"),
    ],
)
@pytest.mark.parametrize("kind", ["lever", "pull", "push_bar", "knob"])
def test_a_handle_off_its_leaf_is_refused_with_the_distance(kind: str, place: dict[str, float], words: str) -> None:
    request = door("lever", "pull" if kind == "pull" else "push")
    request["task"]["door"]["handle"] = {"kind": kind, "centre": at(**place), "length_m": 0.1}
    if kind == "pull":  # whose leaf has its face where its hinge is
        request["task"]["door"]["handle"]["centre"][0] += 0.045
    assert refuse(request).startswith(f"{HANDLE}.centre: ")
    assert words in refuse(request)


@pytest.mark.parametrize(
    ("kind", "changes", "words"),
    [
        ("lever", {"length_m": 0.3, "direction": [0, 1, 0]}, "0.23 m beside the leaf"),
        ("lever", {"direction": [-1, 0, 0], "length_m": 0.2}, "in front of the leaf's face"),
        ("lever", {"direction": [1, 0, 0]}, "behind the leaf's face"),
        ("pull", {"length_m": 2.6}, "beside the leaf"),
        ("push_bar", {"length_m": 1.2}, "beside the leaf"),
        ("push_bar", {"direction": [0, 0, 1]}, "a push bar 90 deg off the leaf's width"),
    ],
)
def test_a_bar_that_leaves_its_leaf_is_refused(kind: str, changes: dict[str, Any], words: str) -> None:
    problem = refuse(door(kind, "pull" if kind == "pull" else "push", **changes))
    assert problem.startswith(HANDLE)
    assert words in problem


def test_an_edge_above_the_hinge_is_refused_with_the_distance() -> None:
    request = door()
    request["task"]["door"]["leaf"]["edge"][2] = 0.91
    with pytest.raises(RequestError, match=r"task\.door\.leaf.* edge: is 0\.90 m above hinge; expected the same level"):
        parse_request(request)


@pytest.mark.parametrize("make", [drawer_request, cabinet_request, latched_request])
def test_mechanisms_whose_parts_lie_beside_each_other_are_accepted(make: Any) -> None:
    prepare(parse_request(make()))


def fill(depth: float) -> str:
    """The URDF of the drawer with a block in its cupboard, into which the drawer's floor reaches by ``depth``."""
    # The tray is 20 mm thick with its middle at z = 0.89.
    block = box((0.5, 0.5, 0.3), (0.27, 0.0, 0.88 + depth - 0.15))
    return drawer_urdf().replace('<link name="cupboard">', f'<link name="cupboard">{block}', 1)


@pytest.mark.parametrize(("depth", "is_refused"), [(0.01, False), (0.028, False), (0.04, True), (0.15, True)])
def test_a_drawer_may_be_three_centimetres_inside_what_stands_still(depth: float, is_refused: bool) -> None:
    request = drawer_request()
    request["task"]["mechanism"]["urdf"] = fill(depth)
    if not is_refused:
        prepare(parse_request(request))
        return
    problem = refuse(request)
    assert problem.startswith("task.mechanism.urdf: mechanism/drawer/")
    assert f"is {depth:.2f} m inside fixture/cupboard" in problem
    assert "with slide at 0; expected at most 0.03 m" in problem


def test_a_drawer_inside_an_obstacle_is_refused_too() -> None:
    request = drawer_request()
    block = {"name": "block", "type": "box", "size": [0.5, 0.5, 0.4], "position": [1.0, -0.25, 0.95]}
    request["scene"] = {"obstacles": [block]}
    assert "inside block with slide at" in refuse(request)


def refuse_before_block(request: dict[str, Any], face: float) -> str:
    """Refuse a mechanism before whose handle a block ends at x = ``face``."""
    place = [face - 0.15, -0.25, 0.95]
    request["scene"] = {"obstacles": [{"name": "block", "type": "box", "size": [0.3, 0.5, 0.3], "position": place}]}
    return refuse(request)


def test_what_is_a_little_inside_at_the_start_is_refused_where_it_becomes_deep() -> None:
    problem = refuse_before_block(drawer_request(), 0.692)  # 1 cm of the bar
    assert "handle is 0.15 m inside block with slide at 0.156" in problem


def test_later_moves_are_looked_at_where_earlier_ones_end() -> None:
    problem = refuse_before_block(latched_request(), 0.662)
    assert "inside block with paddle at 0.3;" in problem


def test_a_shaft_in_its_bearing_and_a_rod_in_its_guide_are_accepted() -> None:
    rod = box((0.6, 0.04, 0.04), (0.5, 0.0, 0.0))  # along the way of the drawer, and 0.3 m inside the block
    shape = '<link name="drawer">'
    request = drawer_request()
    block = box((0.2, 0.5, 0.3), (0.6, 0.0, 0.95))
    urdf = drawer_urdf().replace(shape, shape + rod, 1)
    request["task"]["mechanism"]["urdf"] = urdf.replace('<link name="cupboard">', f'<link name="cupboard">{block}', 1)
    prepare(parse_request(request))
    wide = request["task"]["mechanism"]["urdf"].replace("0.6 0.04 0.04", "0.6 0.24 0.04", 1)
    request["task"]["mechanism"]["urdf"] = wide
    assert "inside fixture/cupboard" in refuse(request)


@pytest.mark.parametrize(
    ("valve", "words"),
    [
        ({"radius": 0.02}, "task.valve.radius: 0.02 m leaves no opening inside a rim 30 mm thick"),
        ({"radius": 0.15, "spokes_deg": [0, 120, 240], "spoke_width_m": 0.1}, "task.valve.spokes_deg: 3 spokes"),
        ({"lever": {"direction": [0, 0, 1], "length_m": 0.05, "radius_m": 0.04}, "turn_deg": 45}, "length_m: 0.05 m"),
    ],
)
def test_a_valve_that_could_not_be_built_is_refused(valve: dict[str, Any], words: str) -> None:
    task = {"valve": {"centre": [0.7, 0.0, 1.1], "axis": [-1, 0, 0], **valve}}
    with pytest.raises(RequestError) as caught:
        plan(parse_request({"robot": {"name": "atlas"}, "start": {"posture": "stand"}, "task": task}))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("case", "words"),
    [("door_float", "0.51 m in front of the leaf's face"), ("solid", "0.10 m inside fixture/cupboard.1")],
)
def test_what_was_believed_before_is_refused(shared_data: Any, case: str, words: str) -> None:
    path = shared_data.parent / "cases" / "lies" / case / "request.yaml"
    if not path.is_file():
        pytest.skip(f"no case at {path}")
    with pytest.raises(RequestError) as caught:
        prepare(load_request(path))
    assert words in str(caught.value)


def test_the_distances_are_those_of_the_leaf_whichever_way_it_faces() -> None:
    request = door()
    leaf, turn = request["task"]["door"]["leaf"], np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    leaf["hinge"], leaf["edge"] = (turn @ leaf["hinge"]).tolist(), (turn @ leaf["edge"]).tolist()
    request["task"]["door"]["handle"]["centre"] = (turn @ at(x=0.205)).tolist()
    request["scene"] = {}
    assert "0.45 m in front of the leaf's face" in refuse(request)
