"""Edits of what few plans have: bases that roll, split links, regions, padding, rounded corners, stacks, two hands,
fingers that follow, leaves that two steps push, and motions that begin moving."""

from __future__ import annotations

from typing import Any, cast
from xml.etree import ElementTree as ET

import numpy as np

from benchmarks.attack.forgery import Folder, Level, Registry
from costs.curve import Curve

RARE_EDITS = Registry()
FITTED, HASHED, REMADE = Level.FITTED, Level.HASHED, Level.REMADE


def _column(folder: Folder, joint: str) -> int:
    return int(folder.curve["joint_names"].index(joint))


def _bulge(folder: Folder, joint: str, size: float) -> None:
    """Lead a joint beside its way and back, as far in the middle of the motion."""
    column, rows = _column(folder, joint), folder.curve["positions"]
    for row, share in zip(rows, np.linspace(0.0, 1.0, len(rows)), strict=True):
        row[column] += size * 16.0 * (share * (1.0 - share)) ** 2


def _slow(folder: Folder, factor: float) -> None:
    """Take more time for the same path."""
    law = folder.curve["law"]
    law.update(times=[factor * time for time in law["times"]], speed=[speed / factor for speed in law["speed"]])


def _steps(folder: Folder) -> list[dict[str, Any]]:
    return cast("list[dict[str, Any]]", folder.request["task"]["steps"])


# Bases.
@RARE_EDITS.lie("cart")
def a_base_on_wheels_that_slides_sideways(folder: Folder) -> None:
    _bulge(folder, "base_y", 0.04)


@RARE_EDITS.lie("cart")
def a_base_on_wheels_that_slides_a_little_at_one_place(folder: Folder) -> None:
    """Move the base aside by 1 % of its way between two knots; all of it together would be excused."""
    column, rows = _column(folder, "base_y"), folder.curve["positions"]
    for row in rows[len(rows) // 2 :]:
        row[column] += 0.012


@RARE_EDITS.lie("cart")
def a_base_on_wheels_that_is_said_to_slide(folder: Folder) -> None:
    """Slide, and have a robot in the folder that may."""
    _bulge(folder, "base_y", 0.04)
    folder.edit_urdf(lambda root: root.find("joint[@name='base_yaw']").attrib.pop("rolls"))  # type: ignore[union-attr]


@RARE_EDITS.lie("cart", level=HASHED)
def a_base_that_is_free_in_the_request(folder: Folder) -> None:
    folder.request["robot"]["root"] = "floating"


@RARE_EDITS.lie("mujoco", "split", level=HASHED)
def a_base_that_drives_in_the_request(folder: Folder) -> None:
    folder.request["robot"]["root"] = "planar"


# Robots' files.
@RARE_EDITS.lie("split", robot=True)
def a_fork_of_one_prong(folder: Folder) -> None:
    _drop_shape(folder, "grip")


@RARE_EDITS.lie("mujoco", robot=True)
def a_hand_of_a_model_without_its_shape(folder: Folder) -> None:
    _drop_shape(folder, "hand")


def _drop_shape(folder: Folder, link: str) -> None:
    def change(root: ET.Element) -> None:
        found = next(each for each in root.findall("link") if each.get("name") == link)
        found.remove(found.findall("collision")[-1])

    folder.edit_urdf(change)


@RARE_EDITS.lie("mujoco", robot=True)
def motors_of_a_model_that_are_ten_times_as_strong(folder: Folder) -> None:
    def change(root: ET.Element) -> None:
        for limit in root.iterfind("joint/limit"):
            limit.set("effort", str(10.0 * float(limit.get("effort", "1"))))
            limit.set("velocity", str(10.0 * float(limit.get("velocity", "1"))))

    folder.edit_urdf(change)


@RARE_EDITS.lie("follower", robot=True)
def a_finger_that_follows_the_other_way(folder: Folder) -> None:
    def change(root: ET.Element) -> None:
        for mimic in root.iterfind("joint/mimic"):
            mimic.set("multiplier", "-1")

    folder.edit_urdf(change)


@RARE_EDITS.lie("follower", robot=True)
def a_finger_that_follows_from_elsewhere(folder: Folder) -> None:
    def change(root: ET.Element) -> None:
        for mimic in root.iterfind("joint/mimic"):
            mimic.set("offset", "0.01")

    folder.edit_urdf(change)


# Regions and distances.
@RARE_EDITS.lie("region")
def regions_that_are_wider_in_the_record(folder: Folder) -> None:
    for target in folder.targets("region"):
        target["upper_m"] = [value if value is None else value + 0.2 for value in target["upper_m"]]


@RARE_EDITS.lie("region")
def a_region_that_holds_at_the_end_alone(folder: Folder) -> None:
    for target in folder.targets("region"):
        target.update(during=[0.9, 1.0])


@RARE_EDITS.lie("region", level=HASHED)
def a_region_turned_by_a_right_angle(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["quaternion_wxyz"] = [2**-0.5, 0.0, 0.0, 2**-0.5]
    folder.request["goal"]["poses"][0]["rotation_tolerance_deg"] = 180.0


@RARE_EDITS.lie("region", level=HASHED)
def a_region_that_is_also_a_narrow_cylinder(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["region"]["radius_m"] = 0.25


@RARE_EDITS.lie("region")
def a_hand_that_rises_above_what_is_kept(folder: Folder) -> None:
    _bulge(folder, "shoulder", -0.6)
    _slow(folder, 6.0)


@RARE_EDITS.lie("padded", level=HASHED)
def distances_of_another_link(folder: Folder) -> None:
    folder.request["options"]["padding"] = {"hand": 0.015, "post": 0.01, "forearm": 0.06, "upper_arm": 0.06}


@RARE_EDITS.lie("padded", level=HASHED)
def distances_of_every_link_and_obstacle(folder: Folder) -> None:
    folder.request["options"]["padding"] = dict.fromkeys(("hand", "post", "shelf", "forearm", "wrist_link"), 0.03)


@RARE_EDITS.lie("padded")
def distances_left_out_of_the_record(folder: Folder) -> None:
    folder.data.update(clearance_m=0.0, padding={})


# Motions that begin or end moving.
@RARE_EDITS.lie("moving")
def a_motion_that_begins_at_rest(folder: Folder) -> None:
    folder.data["start_rates"] = {}
    folder.curve["law"]["speed"][0] = 0.0


@RARE_EDITS.lie("moving")
def a_motion_that_ends_twice_as_fast(folder: Folder) -> None:
    folder.data["end_rates"] = {name: 2.0 * rate for name, rate in folder.data["end_rates"].items()}
    folder.curve["law"]["speed"][-1] *= 2.0


@RARE_EDITS.lie("moving", level=HASHED)
def joints_that_move_the_other_way_at_first(folder: Folder) -> None:
    folder.request["start"]["rates"] = {"shoulder": -0.4}


@RARE_EDITS.lie("region", level=HASHED)
def a_start_that_moves_already(folder: Folder) -> None:
    folder.request["start"]["rates"] = {"shoulder": 0.05}


# Rounded corners.
@RARE_EDITS.lie("blends", level=HASHED)
def corners_that_are_not_rounded(folder: Folder) -> None:
    for step in _steps(folder):
        step["move"]["blend_m"] = 0.0


@RARE_EDITS.lie("blends", level=HASHED)
def corners_that_are_rounded_by_less(folder: Folder) -> None:
    _steps(folder)[0]["move"]["blend_m"] = 0.025


@RARE_EDITS.lie("blends")
def corners_that_may_be_cut(folder: Folder) -> None:
    for target in folder.targets("way"):
        target["tolerance_m"] = 0.05
    _bulge(folder, "x", 0.01)


@RARE_EDITS.lie("blends")
def a_corner_counted_as_its_line(folder: Folder) -> None:
    folder.phases[0]["last"] = folder.phases[1]["last"]
    del folder.phases[1]


@RARE_EDITS.lie("blends", level=HASHED)
def lines_in_another_order(folder: Folder) -> None:
    steps = _steps(folder)
    ways = [step["move"]["by"] for step in steps]
    for step, way in zip(steps[:2], ways[1::-1], strict=True):
        step["move"]["by"] = way


# Objects.
@RARE_EDITS.lie("stack", level=HASHED)
def the_lower_block_taken_first(folder: Folder) -> None:
    for step in _steps(folder):
        _rename(step, {"upper": "lower", "lower": "upper"})


def _rename(value: Any, names: dict[str, str]) -> None:
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(inner, str):
            value[key] = names.get(inner, inner)
        elif isinstance(inner, dict | list):
            _rename(inner, names)


@RARE_EDITS.lie("stack", level=HASHED)
def a_block_that_hangs_in_the_air_at_first(folder: Folder) -> None:
    folder.request["scene"]["objects"][1]["position"][2] += 0.03


@RARE_EDITS.lie("stack", level=HASHED)
def blocks_of_20_kg(folder: Folder) -> None:
    for item in folder.request["scene"]["objects"]:
        item["mass_kg"] = 20.0


@RARE_EDITS.lie("stack")
def objects_that_the_world_carries_to_the_end(folder: Folder) -> None:
    for phase in folder.phases:
        for carrier in phase["carriers"]:
            carrier.update(link=None, grips=[])


@RARE_EDITS.lie("stack")
def a_block_that_is_let_go_one_phase_earlier(folder: Folder) -> None:
    index = next(k for k, phase in enumerate(folder.phases) if phase["name"].endswith("open"))
    folder.phases[index - 1]["carriers"] = folder.phases[index]["carriers"]


@RARE_EDITS.lie("follower", level=HASHED)
def fingers_that_hardly_press(folder: Folder) -> None:
    folder.request["task"]["pick_place"]["grip_n"] = 3.0


@RARE_EDITS.lie("stack", "follower", "beam")
def grips_of_one_finger(folder: Folder) -> None:
    for phase in folder.phases:
        for carrier in phase["carriers"]:
            for grip in carrier["grips"]:
                grip["fingers"] = grip["fingers"][:1]


@RARE_EDITS.lie("beam")
def a_beam_in_one_hand_in_the_record(folder: Folder) -> None:
    for phase in folder.phases:
        for carrier in phase["carriers"]:
            carrier["grips"] = carrier["grips"][:1]


@RARE_EDITS.lie("beam", level=HASHED)
def a_beam_that_one_hand_was_to_carry(folder: Folder) -> None:
    folder.request["task"]["pick_place"]["hand"] = "left"


@RARE_EDITS.lie("stack", "beam", level=HASHED)
def hands_that_hold_by_little_friction(folder: Folder) -> None:
    folder.request["options"]["hand_friction"] = [0.02, 0.6]


# Leaves, and friction.
@RARE_EDITS.lie("pushes", "drawer", level=HASHED)
def friction_whose_least_is_more_than_its_largest(folder: Folder) -> None:
    folder.request["options"]["hand_friction"] = [0.6, 0.3]


@RARE_EDITS.lie("pushes")
def friction_of_a_record_whose_least_is_more_than_its_largest(folder: Folder) -> None:
    for phase in folder.phases:
        for push in phase["pushes"]:
            push["friction"] = push["friction"][::-1]


@RARE_EDITS.lie("pushes", level=HASHED)
def a_leaf_that_is_wide_open_after_the_first_push(folder: Folder) -> None:
    first, second = (step["mechanism"]["moves"][0] for step in _steps(folder))
    first["to"], second["to"] = second["to"], first["to"]


@RARE_EDITS.lie("pushes", level=HASHED)
def a_leaf_that_the_second_push_finds_stiff(folder: Folder) -> None:
    _steps(folder)[1]["mechanism"]["joints"]["hinge"]["friction"] = 16.0


@RARE_EDITS.lie("pushes", level=HASHED)
def a_leaf_that_is_elsewhere_for_the_second_push(folder: Folder) -> None:
    _steps(folder)[1]["mechanism"]["position"][0] += 0.01


@RARE_EDITS.lie("pushes", level=HASHED)
def a_leaf_of_80_kg(folder: Folder) -> None:
    for step in _steps(folder):
        text = step["mechanism"]["urdf"]
        step["mechanism"]["urdf"] = text.replace('<link name="leaf">', f'<link name="leaf">{HEAVY}', 1)


HEAVY = (
    '<inertial><origin xyz="0 -0.45 1"/><mass value="80"/>'
    '<inertia ixx="30" iyy="25" izz="6" ixy="0" ixz="0" iyz="0"/></inertial>'
)


@RARE_EDITS.lie("pushes")
def the_first_push_left_out_of_the_record(folder: Folder) -> None:
    index = next(k for k, phase in enumerate(folder.phases) if phase["pushes"])
    folder.phases[index].update(pushes=[], loads=[], regions=[], pressed=[])


@RARE_EDITS.lie("pushes", "drawer")
def what_is_pushed_goes_back_and_on_again(folder: Folder) -> None:
    """Lead hand and object to two thirds of the way, back to one third, and on, slowly enough for every limit."""
    curve, phase = folder.curve, next(phase for phase in folder.phases if phase["pushes"])
    known = Curve(*(np.array(curve[name]) for name in ("knots", "positions", "tangents")))
    borders = {end for each in (phase, *phase["regions"]) for end in (each["first"], each["last"])}
    s = np.array(curve["samples"])[sorted(borders | set(range(phase["first"], phase["last"], 2)))]
    x = (s - s[0]) / (s[-1] - s[0])
    wave = np.sin(2.0 * np.pi * x)
    way = s[0] + (s[-1] - s[0]) * (x**2 * (3.0 - 2.0 * x) + 0.5 * wave**3)
    slope = 6.0 * x * (1.0 - x) + 3.0 * np.pi * wave**2 * np.cos(2.0 * np.pi * x)
    before, after = known.knots < s[0], known.knots > s[-1]
    for name, old, new in (
        ("knots", known.knots, s),
        ("positions", known.positions, known(way)),
        ("tangents", known.tangents, known(way, 1) * slope[:, None]),
    ):
        curve[name] = np.concatenate([old[before], new, old[after]]).tolist()
    _slow(folder, 6.0)


@RARE_EDITS.lie("pushes", level=FITTED)
def a_leaf_that_may_swing_faster(folder: Folder) -> None:
    for movable in folder.data["movables"]:
        movable.update(velocity=10.0 * movable["velocity"], acceleration=10.0 * movable["acceleration"])


@RARE_EDITS.lie("walk", level=HASHED)
def a_walk_that_goes_farther(folder: Folder) -> None:
    step = next(step for step in _steps(folder) if step.get("walk"))
    step["walk"]["to"] = [0.26, 0.0]


@RARE_EDITS.lie("walk")
def feet_that_stay_where_they_were(folder: Folder) -> None:
    for phase in folder.phases[1:]:
        phase["contacts"] = folder.phases[0]["contacts"]


# An object that goes from hand to hand.
def _carriers(folder: Folder, phase: str) -> list[dict[str, Any]]:
    return cast("list[dict[str, Any]]", next(p for p in folder.data["phases"] if p["name"] == phase)["carriers"])


@RARE_EDITS.lie("handover")
def a_hand_that_still_holds_what_it_has_let_go(folder: Folder) -> None:
    both = _carriers(folder, "give: open")[0]["grips"] + _carriers(folder, "take over: close")[0]["grips"]
    for phase in ("give: open", "give: leave", "down"):
        _carriers(folder, phase)[0]["grips"] = both


@RARE_EDITS.lie("handover", level=REMADE)
def a_second_hand_that_never_closes(folder: Folder) -> None:
    rows = np.array(folder.curve["positions"])
    for joint in ("second_grip_1", "second_grip_2"):
        rows[:, _column(folder, joint)] = rows[0, _column(folder, joint)]
    folder.curve["positions"] = rows.tolist()


@RARE_EDITS.lie("handover", level=HASHED)
def the_other_hand_that_lets_go(folder: Folder) -> None:
    _steps(folder)[3]["release"]["hand"] = "left"


@RARE_EDITS.lie("handover", level=HASHED)
def hands_that_both_let_go_in_the_air(folder: Folder) -> None:
    _steps(folder)[3]["release"]["hand"] = "both"


@RARE_EDITS.lie("handover")
def a_bar_that_the_first_hand_carries_to_the_end(folder: Folder) -> None:
    first = _carriers(folder, "up")
    for phase in ("give: open", "give: leave", "down"):
        _carriers(folder, phase)[:] = first


@RARE_EDITS.lie("handle")
def fingers_that_open_while_they_press(folder: Folder) -> None:
    for joint in ("r_grip_1", "r_grip_2"):
        _bulge(folder, joint, 0.03)


@RARE_EDITS.lie("handle", level=HASHED)
def a_lever_that_the_ends_of_fingers_press(folder: Folder) -> None:
    _steps(folder)[0]["mechanism"]["handle"]["tool"] = "tip"


@RARE_EDITS.lie("handle")
def a_lever_that_springs_back_while_the_leaf_opens(folder: Folder) -> None:
    column = _column(folder, "handle")
    for row in folder.curve["positions"]:
        row[column] = min(row[column], 0.3)


@RARE_EDITS.lie("braced")
def a_hand_that_has_let_go_and_still_bears(folder: Folder) -> None:
    for phase in folder.phases:
        phase["contacts"] = [contact for contact in phase["contacts"] if contact["link"] != "l_hook"]


@RARE_EDITS.lie("braced", level=HASHED)
def a_rail_that_is_farther_away(folder: Folder) -> None:
    folder.request["scene"]["obstacles"][0]["position"][0] += 0.05


@RARE_EDITS.lie("braced")
def a_hand_on_a_rail_that_slides(folder: Folder) -> None:
    _bulge(folder, "l_arm_elx", 0.05)
