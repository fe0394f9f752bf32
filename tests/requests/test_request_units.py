"""Lengths that only another unit explains are refused in one line that says what would do; honest ones pass."""

import re

import pytest

from service.errors import RequestError
from service.request.file import parse_request
from service.setup.prepare import prepare

SIDE = "m is larger than 100 m; are these millimetres? Use"
FAR = "m from the robot, farther than 100 m; are these millimetres? Use"


def prepared(*obstacles, **request):
    named = [{"name": f"thing {k}", **one} for k, one in enumerate(obstacles)]
    scene = {"obstacles": named, **request.pop("scene", {})}
    data = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.6}}, "scene": scene, **request}
    return prepare(parse_request({key: value for key, value in data.items() if value is not None}))


def refusal(*obstacles, **request):
    with pytest.raises(RequestError) as error:
        prepared(*obstacles, **request)
    return tuple(re.sub(r" is \d+ m from", " is # m from", line) for line in error.value.problems)


@pytest.mark.parametrize(
    ("obstacle", "line"),
    [
        ({"type": "box", "size": [600, 900, 40], "position": [750, 0, 800]}, f"size: 600 {SIDE} 0.6."),
        ({"type": "box", "size": [0.6, 900, 0.04]}, f"size: 900 {SIDE} 0.9."),
        ({"type": "box", "size": [600_000, 1, 1]}, f"size: 600000 {SIDE} 600."),
        ({"type": "sphere", "radius": 150}, f"radius: 150 {SIDE} 0.15."),
        ({"type": "cylinder", "radius": 40, "height": 2000}, f"height: 2000 {SIDE} 2."),
        ({"type": "capsule", "radius": 101, "height": 1}, f"radius: 101 {SIDE} 0.101."),
        ({"type": "convex", "points": [[0, 0, 0], [300, 0, 0], [0, 300, 0], [0, 0, 900]]}, f"points: 900 {SIDE} 0.9."),
        ({"type": "box", "size": [40, 40, 40], "position": [750, 0, 800]}, f"position: [750, 0, 800] is # {FAR} "
         "[0.75, 0, 0.8]."),
        ({"type": "sphere", "radius": 25, "position": [0, 700, 900]}, f"position: [0, 700, 900] is # {FAR} "
         "[0, 0.7, 0.9]."),
        ({"type": "cylinder", "radius": 5, "height": 50, "position": [500, 450, 1000]}, f"position: [500, 450, 1000] "
         f"is # {FAR} [0.5, 0.45, 1]."),
        ({"type": "convex", "points": [[700, 0, 0], [720, 0, 0], [700, 50, 0], [700, 0, 40]]},
         f"points: [700, 0, 0] is # {FAR} [0.7, 0, 0]."),
        ({"type": "mesh", "file": "none.obj", "position": [750, 0, 800]}, f"position: [750, 0, 800] is # {FAR} "
         "[0.75, 0, 0.8]."),
    ],
)  # fmt: skip
def test_an_obstacle_in_millimetres_is_refused_with_what_would_do(obstacle, line):
    (problem,) = refusal(obstacle)
    assert problem == f"scene.obstacles[0].{line}"


@pytest.mark.parametrize(
    ("request_part", "line"),
    [
        ({"goal": {"poses": [{"link": "l_tool", "position": [750, 0, 800]}]}}, f"goal.poses[0].position: [750, 0, 800] "
         f"is # {FAR} [0.75, 0, 0.8]."),
        ({"goal": None, "task": {"valve": {"hint": [700, 0, 1000]}}}, f"task.valve.hint: [700, 0, 1000] is # {FAR} "
         "[0.7, 0, 1]."),
        ({"goal": None, "task": {"valve": {"centre": [700, 0, 1000], "axis": [-1, 0, 0], "radius": 0.15}}},
         f"task.valve.centre: [700, 0, 1000] is # {FAR} [0.7, 0, 1]."),
        ({"scene": {"floor": -850}}, "scene.floor: -850 is # m from the robot, farther than 100 m; is it in "
         "millimetres? Use -0.85."),
        ({"keep": [{"link": "l_hand", "position": [300, 0, 900]}]}, f"keep[0].position: [300, 0, 900] is # {FAR} "
         "[0.3, 0, 0.9]."),
        ({"attached": [{"name": "beam", "link": "l_hand", "type": "box", "size": [0.05, 0.9, 0.05],
                        "position": [279, 0, 0]}]}, "attached[0].position: [279, 0, 0] is # m from its link, farther "
         "than 100 m; are these millimetres? Use [0.279, 0, 0]."),
    ],
)  # fmt: skip
def test_places_in_millimetres_are_refused_too(request_part, line):
    (problem,) = refusal(**request_part)
    assert problem == line


def test_what_is_carried_has_no_sides_in_millimetres_either():
    beam = {"name": "beam", "link": "l_hand", "type": "box", "size": [50, 900, 50]}
    assert refusal(attached=[beam]) == (f"attached[0].size: 900 {SIDE} 0.9.",)


def test_a_base_in_millimetres_is_what_is_blamed_when_all_else_is_near_the_origin():
    (problem,) = refusal(
        {"type": "box", "size": [0.1, 0.1, 0.1], "position": [0.75, 0, 0.8]},
        start={"base": {"position": [750, 0, 950]}},
    )
    assert problem == (
        "start.base.position: [750, 0, 950] is # m from scene.obstacles[0], farther than 100 m; "
        "is it in millimetres? Use [0.75, 0, 0.95]."
    )


@pytest.mark.parametrize(
    "obstacle",
    [
        {"type": "box", "size": [20, 20, 0.2], "position": [0, 0, -0.11]},
        {"type": "box", "size": [100, 100, 1], "position": [0, 0, -0.51]},
        {"type": "box", "size": [0.2, 50, 8], "position": [1.5, 0, 4]},
        {"type": "box", "size": [30, 50, 0.3], "position": [0, 0, 12]},
        {"type": "sphere", "radius": 10, "position": [12, 0, 1]},
        {"type": "cylinder", "radius": 0.5, "height": 60, "position": [3, 0, 30]},
    ],
)
def test_slabs_walls_and_roofs_pass_without_a_word(obstacle):
    assert not any("metres" in note for note in prepared(obstacle).notes)


def test_far_things_that_matter_to_nobody_pass_with_a_word():
    things = [{"type": "box", "size": [60, 90, 4], "position": [75, 0, 80]}]
    (note,) = [note for note in prepared(*things).notes if "metres" in note]
    assert note == "scene.obstacles: out of the robot's reach by far: thing 0 (88 m); are they given in metres?"
    many = [{"type": "sphere", "radius": 0.1, "position": [60 + k, 0, 1]} for k in range(7)]
    (note,) = [note for note in prepared(*many).notes if "metres" in note]
    assert note.endswith("and 4 more; are they given in metres?")


def test_a_robot_far_from_the_origin_has_its_obstacles_around_it():
    setup = prepared(
        {"type": "box", "size": [0.2, 0.2, 0.2], "position": [751, 0.9, 0.5]},
        start={"base": {"position": [750, 0, 0.91720092]}},
    )
    assert setup.start[0] == 750.0
