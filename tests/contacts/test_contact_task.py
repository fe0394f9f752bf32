"""Stances of a request: surfaces, places of links, phases, and one sentence for each bad input."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from costs.contact import Contact
from costs.primitive import Primitive
from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from service import RequestError, parse_request, prepare
from service.demands.contacts.phases import LINE_M, list_contact_phases
from service.demands.contacts.stances import (
    INSIDE_M,
    ContactStance,
    StanceContact,
    Surface,
    ends_with_new_contacts,
    find_link_pose,
    find_unjoined,
    place_patch,
)
from service.demands.contacts.surfaces import STRIP_M, make_surfaces
from service.request.tasks.contacts import SurfaceRequest

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
SOLE = Contact(
    "foot",
    np.array([[0.1, 0.05, -0.08], [-0.1, 0.05, -0.08], [-0.1, -0.05, -0.08], [0.1, -0.05, -0.08]]),
    np.tile([0.0, 0.0, 1.0], (4, 1)),
    0.6,
    1000.0,
)


def make_plane(normal: np.ndarray, at: np.ndarray, name: str = "plane") -> Surface:
    """Return a square of two metres."""
    u = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    return Surface(name, at + np.stack([-u - v, u - v, u + v, v - u]), normal, 0.5)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), yaw=st.floats(-3.0, 3.0))
def test_a_link_lies_flat_on_its_surface_with_the_middle_of_its_points_at_the_place(seed: int, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    surface = make_plane(normal, rng.normal(size=3))
    turn = Rotation.random(random_state=seed).as_matrix()
    patch = replace(SOLE, points=SOLE.points @ turn.T, normals=SOLE.normals @ turn.T)
    place = surface.middle + rng.uniform(-0.5, 0.5, 3)
    pose = find_link_pose(patch, surface, place, yaw)
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    contact = place_patch(patch, "foot", surface, pose)
    assert np.allclose(surface.measure_height(contact.points), 0.0, atol=1e-9)
    assert np.allclose(pose[:3, :3] @ patch.normals[0], normal)
    off = contact.points.mean(axis=0) - place
    assert np.allclose(off - (off @ normal) * normal, 0.0, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(turn=st.floats(-1.0, 1.0), along=st.floats(-0.4, 0.4))
def test_the_normal_on_a_round_bar_points_away_from_its_axis(turn: float, along: float) -> None:
    bar = Primitive("cylinder", 0.025, 1.0, np.eye(4))
    points = 0.025 * np.stack([np.cos(np.linspace(0, 6, 12)), np.sin(np.linspace(0, 6, 12))], axis=1)
    vertices = np.concatenate([np.column_stack([points, np.full(12, z)]) for z in (-0.5, 0.5)])
    piece = ConvexPiece("bar", vertices, exact=bar)
    corners = np.array([[0.025, -0.02, -0.5], [0.025, 0.02, -0.5], [0.025, 0.02, 0.5], [0.025, -0.02, 0.5]])
    surface = Surface.on_pieces("side", corners, np.array([1.0, 0.0, 0.0]), 0.6, [piece])
    outwards = np.array([np.cos(turn), np.sin(turn), 0.0])
    np.testing.assert_allclose(surface.find_normal((0.025 * outwards + [0.0, 0.0, along])[None]), outwards, atol=1e-9)
    flat = Surface.on_pieces("side", corners, np.array([1.0, 0.0, 0.0]), 0.6, [replace(piece, exact=None)])
    np.testing.assert_allclose(flat.find_normal(corners), [1.0, 0.0, 0.0])


def test_yaw_turns_a_foot_about_the_normal_and_0_points_it_along_x() -> None:
    floor = make_plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    for yaw in (0.0, 0.4, -1.2):
        pose = find_link_pose(SOLE, floor, np.zeros(3), yaw)
        assert np.allclose(pose[:3, :3], Rotation.from_euler("z", yaw).as_matrix())


def test_the_weaker_of_patch_and_surface_is_the_friction() -> None:
    floor = make_plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    pose = np.eye(4)
    assert place_patch(SOLE, "foot", floor, pose).planted.friction == 0.5
    assert place_patch(SOLE, "foot", replace(floor, friction=0.9), pose).planted.friction == 0.6


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_side_of_a_box_is_found_with_its_corners_around_its_normal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, half, middle = Rotation.random(random_state=seed), rng.uniform(0.05, 0.5, 3), rng.normal(size=3)
    box = ConvexPiece("box", turn.apply(SIGNS * half) + middle)
    outwards = turn.apply([0.0, 0.0, 1.0])
    x, y, z = (3.0 * outwards).tolist()
    side = make_surfaces({"side": SurfaceRequest(piece="box", normal=(x, y, z))}, Scene((box,)), "surfaces")["side"]
    assert np.allclose(side.normal, outwards, atol=1e-6)
    assert np.allclose(side.measure_height(box.vertices).max(), 0.0, atol=1e-6)
    assert side.measure_outside(side.middle[None])[0] == pytest.approx(-half[:2].min(), abs=1e-6)
    inside = side.middle + turn.apply([*(half[:2] - 1e-3), 0.0])
    beyond = side.middle + turn.apply([half[0] + 2e-3, 0.0, 0.0])
    assert side.measure_outside(inside[None])[0] < 0.0
    assert side.measure_outside(beyond[None])[0] == pytest.approx(2e-3, abs=1e-6)
    along = np.roll(side.corners, -1, axis=0) - side.corners
    assert np.all(np.cross(along, np.roll(along, -1, axis=0)) @ side.normal > 0.0)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), n_sides=st.sampled_from([6, 8, 16]))
def test_a_round_bar_has_a_strip_along_its_upper_edge(seed: int, n_sides: int) -> None:
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(n_sides) / n_sides + 0.5 * np.pi
    ring = 0.02 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    length, yaw, middle = rng.uniform(0.3, 2.0), rng.uniform(-3.0, 3.0), rng.normal(size=3)
    ends = [np.column_stack([np.full(n_sides, x), ring]) for x in (-0.5 * length, 0.5 * length)]
    turn = Rotation.from_euler("z", yaw)
    bar = ConvexPiece("bar", turn.apply(np.vstack(ends)) + middle)
    strip = make_surfaces({"rail": SurfaceRequest(piece="bar")}, Scene((bar,)), "surfaces")["rail"]
    assert np.allclose(strip.normal, [0.0, 0.0, 1.0], atol=1e-9)
    assert np.allclose(strip.corners[:, 2], middle[2] + 0.02, atol=1e-9)
    sizes = np.linalg.norm(np.roll(strip.corners, -1, axis=0) - strip.corners, axis=1)
    assert sorted(sizes) == pytest.approx([STRIP_M, STRIP_M, length, length])
    assert np.allclose(strip.middle[:2], middle[:2], atol=1e-9)
    on_end = strip.middle + turn.apply([0.5 * length + 1e-3, 0.0, 0.0])
    assert strip.measure_outside(on_end[None])[0] == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (SurfaceRequest(piece="bix"), "task.contacts.surfaces.x: no piece 'bix' in the scene, which has box, tip"),
        (SurfaceRequest(piece="tip"), "task.contacts.surfaces.x: tip has no flat side along [0.0, 0.0, 1.0]"),
        (
            SurfaceRequest(corners=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.3))),
            "task.contacts.surfaces.x: the polygon has no flat side along [0.0, 0.0, 1.0]",
        ),
        (
            SurfaceRequest(corners=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0))),
            "task.contacts.surfaces.x: the polygon has no flat side along [0.0, 0.0, 1.0]",
        ),
        (
            SurfaceRequest(corners=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), pieces=("table",)),
            "task.contacts.surfaces.x: no piece 'table' in the scene, which has box, tip",
        ),
    ],
)
def test_a_surface_that_is_none_is_refused_by_name(request_: SurfaceRequest, words: str) -> None:
    tip = ConvexPiece("tip", np.vstack([np.zeros(3), *(SIGNS[SIGNS[:, 2] < 0] * [0.1, 0.1, 0.5])]))
    with pytest.raises(RequestError) as caught:
        make_surfaces({"x": request_}, Scene((ConvexPiece("box", SIGNS), tip)), "task.contacts.surfaces")
    assert [line[: len(words)] for line in caught.value.problems] == [words]


def stand(name: str, *contacts: StanceContact) -> ContactStance:
    return ContactStance(name, contacts)


def test_phases_of_steps_shift_lift_swing_and_land_on_what_stays() -> None:
    floor = make_plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))

    def place(link: str, x: float) -> StanceContact:
        patch = replace(SOLE, link=link)
        return place_patch(patch, link, floor, find_link_pose(patch, floor, np.array([x, 0.0, 0.0]), 0.0))

    left, right, ahead = place("l", 0.0), place("r", 0.1), place("r", 0.4)
    stances = (stand("start", left, right), stand("step", left, ahead), stand("let go", left))
    assert find_unjoined(stances) is None
    phases = list_contact_phases(stances, has_finish=True)
    assert [phase.name for phase in phases] == [
        "step: shift",
        "step: lift",
        "step: swing",
        "step: land",
        "let go: shift",
        "let go: lift",
        "finish",
    ]
    carrying = [[contact.patch for contact in phase.contacts] for phase in phases]
    assert carrying == [["l", "r"], ["l"], ["l"], ["l"], ["l", "r"], ["l"], ["l"]]
    again = list_contact_phases((stances[-1], stand("rise", left)), has_finish=False)
    assert [(phase.name, phase.frames) for phase in again] == [("rise: move", ())]
    assert ends_with_new_contacts(stances[:2])
    assert not ends_with_new_contacts(stances)
    (leaving,), (arriving,) = phases[1].frames, phases[3].frames
    assert (leaving.tool, leaving.leaves) == ("r", True)
    assert np.allclose(leaving.place, right.planted.pose_world_link[:3, 3])
    assert (arriving.tool, arriving.leaves) == ("r", False)
    (line,) = phases[3].list_targets((), 1.0)
    assert line.frame == "r"
    assert np.allclose(line.position + line.slide - ahead.planted.pose_world_link[:3, 3], [0.0, 0.0, LINE_M])
    assert np.allclose(line.position - line.slide, ahead.planted.pose_world_link[:3, 3])


def test_stances_without_a_contact_in_common_are_named() -> None:
    floor = make_plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    here, there = (
        place_patch(SOLE, "foot", floor, find_link_pose(SOLE, floor, np.array([x, 0.0, 0.0]), 0.0)) for x in (0.0, 0.3)
    )
    words = "the stances 'start' and 'jump' share no contact that stays where it is"
    assert find_unjoined((stand("start", here), stand("jump", there))) == words


def read_steps() -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load((REQUESTS / "steps.yaml").read_text())
    return data


def refuse(change: Any, base: Any = read_steps) -> list[str]:
    """Return the problems of a changed request."""
    data = copy.deepcopy(base())
    change(data, data["task"]["contacts"])
    with pytest.raises(RequestError) as caught:
        prepare(parse_request(data))
    return list(caught.value.problems)


def _make(contacts: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = contacts["stances"][0]["make"]
    return found


BAD: dict[str, tuple[Any, str]] = {
    "unknown patch": (
        lambda d, c: _make(c).update(right_fot=_make(c).pop("right_foot")),
        "task.contacts.stances[0].make: unknown contact patch 'right_fot'",
    ),
    "unknown surface": (
        lambda d, c: _make(c)["right_foot"].update(surface="stone_9"),
        "task.contacts.stances[0].make.right_foot: unknown surface 'stone_9'",
    ),
    "unknown piece": (
        lambda d, c: c["surfaces"]["stone_1"].update(piece="rock"),
        "task.contacts.surfaces.stone_1: no piece 'rock' in the scene",
    ),
    "metres beside its surface": (
        lambda d, c: _make(c)["right_foot"].update(at=[3.0, 0.0, 0.0]),
        "task.contacts.stances[0].make.right_foot: a point of right_foot is 2.610 m beyond the edge of stone_1",
    ),
    "released and not in contact": (
        lambda d, c: c["stances"].insert(0, {"name": "let go", "release": ["left_wrist"]}),
        "task.contacts.stances[0].release: left_wrist is not in contact then; left_foot, right_foot is",
    ),
    "a jump": (
        lambda d, c: _make(c).update(left_foot={"surface": "stone_2", "at": [0.5, 0.12, 0.0]}),
        "task.contacts: the stances 'start' and 'right foot on the first stone' share no contact",
    ),
    "unknown finish": (lambda d, c: c.update(finish="reach_redy"), "unknown posture 'reach_redy'"),
    "start off its surface": (
        lambda d, c: c.update(start={"left_foot": "stone_1", "right_foot": "floor"}),
        "task.contacts.start.left_foot: a point of left_foot is 0.050 m below stone_1",
    ),
    "unknown patch at the start": (
        lambda d, c: c.update(start={"left_fot": "floor"}),
        "task.contacts.start: unknown contact patch 'left_fot'",
    ),
    "made and released": (
        lambda d, c: c["stances"][0].update(release=["right_foot"]),
        "right_foot' is both made and released",
    ),
    "two stances of one name": (lambda d, c: c["stances"][1].update(name=c["stances"][0]["name"]), "two stances"),
    "an empty stance": (lambda d, c: c["stances"][0].update(make={}), "neither makes nor releases a contact"),
    "neither piece nor corners": (lambda d, c: c["surfaces"].update(stone_1={}), "give either piece or corners"),
    "no normal": (
        lambda d, c: c["surfaces"]["stone_1"].update(normal=[0, 0, 0]),
        "normal has no length",
    ),
    "a surface in the air": (
        lambda d, c: c["surfaces"].update(
            stone_3={"corners": [[x, y, 0.3] for x, y in ((0.5, -0.3), (0.9, -0.3), (0.9, 0.1), (0.5, 0.1))]}
        ),
        "task.contacts.stances[2].make.right_foot: stone_3 has no piece of the scene behind a point of right_foot",
    ),
    "unknown key": (lambda d, c: c["stances"][0].update(makes={}), "makes"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_that_names_it(name: str) -> None:
    change, words = BAD[name]
    problems = refuse(change)
    assert len(problems) == 1, problems
    assert words in problems[0]


def test_a_contact_on_a_round_pillar_off_its_polytope_is_refused() -> None:
    """The last stance has no phase that stands on it, so that the request itself is held to the scene."""

    def change(data: dict[str, Any], contacts: dict[str, Any]) -> None:
        del contacts["stances"][1:]
        corners = [[x, y, 0.05] for x, y in ((0.2, -0.25), (0.55, -0.25), (0.55, 0.0), (0.2, 0.0))]
        contacts["surfaces"] = {"stone_1": {"corners": corners, "pieces": ["stone_1"]}}
        data["scene"]["obstacles"][0] = {
            "name": "stone_1", "type": "sphere", "radius": 0.3, "position": [0.37, -0.12, -0.25],
        }  # fmt: skip

    (problem,) = refuse(change)
    assert "stone_1 has no piece of the scene behind a point of right_foot" in problem


def test_a_fixed_base_needs_no_contacts() -> None:
    def change(data: dict[str, Any], contacts: dict[str, Any]) -> None:
        data["robot"]["root"] = "fixed"
        contacts.pop("finish")

    assert "task.contacts: this robot's base is fixed" in refuse(change)[0]


def test_the_places_of_a_request_are_on_their_stones() -> None:
    setup = prepare(parse_request(read_steps()))
    robot = load_robot("atlas")
    heights = []
    for stance in setup.stances:
        assert len(stance.contacts) == 2
        for contact in stance.contacts:
            assert contact.planted.tilt_rad < 1e-3
            assert contact.planted.friction <= robot.contacts[contact.patch].friction
        heights.append([round(float(contact.points[:, 2].mean()), 6) for contact in stance.contacts])
    assert heights == [[0.0, 0.0], [0.0, 0.05], [0.05, 0.1], [0.1, 0.05]]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_place_is_brought_to_the_nearest_point_of_its_surface(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, half, middle = Rotation.random(random_state=seed), rng.uniform(0.01, 0.5, 2), rng.normal(size=3)
    corners = turn.apply(np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0]) + middle
    surface = Surface("s", corners, turn.apply([0.0, 0.0, 1.0]), 0.6)
    local = rng.uniform(-1.0, 1.0, 3)
    place = surface.bring_onto(turn.apply(local) + middle)
    expected = turn.apply([*np.clip(local[:2], -half, half), 0.0]) + middle
    assert np.linalg.norm(place - expected) <= INSIDE_M + 1e-9
    assert surface.measure_outside(place[None])[0] <= 1e-9
    assert abs(surface.measure_height(place[None])[0]) <= 1e-9
