"""Edits of what hands, objects and seats do that no other module makes: each is plausible by itself, and false."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from benchmarks.attack.forgery import Folder, Level, Registry

INVENTED = Registry()
FITTED, HASHED, REMADE = Level.FITTED, Level.HASHED, Level.REMADE
HANDS = ("drawer", "door", "lever", "valve", "gripper", "resume", "compliant")


def _pushes(folder: Folder) -> Iterator[dict[str, Any]]:
    for phase in folder.phases:
        yield from phase["pushes"]


def _contacts(folder: Folder) -> Iterator[dict[str, Any]]:
    for push in _pushes(folder):
        yield from push["contacts"]


def _loads(folder: Folder) -> Iterator[dict[str, Any]]:
    for phase in folder.phases:
        yield from phase["loads"]


def _task(folder: Folder, name: str) -> dict[str, Any]:
    return cast("dict[str, Any]", folder.request["task"][name])


# Where and how a hand touches.
@INVENTED.lie(*HANDS, level=FITTED)
def the_core_of_each_surface_turned_by_a_right_angle(folder: Folder) -> None:
    """Turn what is pressed, and with it all normals."""
    for contact in _contacts(folder):
        contact["core"] = [[z, y, -x] for x, y, z in contact["core"]]
        contact["core"][0][0] += 0.01


@INVENTED.lie("drawer", "door", "lever", level=FITTED)
def surfaces_of_another_radius(folder: Folder) -> None:
    for contact in _contacts(folder):
        contact["radius"] += 0.005


@INVENTED.lie(*HANDS, level=FITTED)
def friction_widened_in_the_result_alone(folder: Folder) -> None:
    for push in _pushes(folder):
        push["friction"] = [0.3, 0.9]


@INVENTED.lie("drawer", "gripper", level=FITTED)
def friction_the_wrong_way_round(folder: Folder) -> None:
    for push in _pushes(folder):
        push["friction"] = push["friction"][::-1]


@INVENTED.lie("door", level=FITTED)
def each_push_of_the_other_joint(folder: Folder) -> None:
    names = [movable["joint"] for movable in folder.data["movables"]]
    for push in _pushes(folder):
        push["joint"] = names[1 - names.index(push["joint"])]


@INVENTED.lie("door", level=FITTED)
def held_joints_with_their_bounds_exchanged(folder: Folder) -> None:
    for push in _pushes(folder):
        for held in push["held"]:
            held.update(low=-1e4, high=1e4)


@INVENTED.lie("gripper", level=FITTED)
def a_grip_of_one_finger(folder: Folder) -> None:
    for push in _pushes(folder):
        push["contacts"] = push["contacts"][:1]


@INVENTED.lie("gripper", "drawer", level=FITTED)
def contacts_pressed_twice(folder: Folder) -> None:
    for push in _pushes(folder):
        push["contacts"] = [*push["contacts"], *push["contacts"]]


@INVENTED.lie("drawer", "lever", "valve")
def pushes_of_a_phase_in_which_nothing_moves(folder: Folder) -> None:
    pushes = next(phase["pushes"] for phase in folder.phases if phase["pushes"])
    folder.phases[0]["pushes"] = pushes


@INVENTED.lie("door")
def the_leaf_opened_with_the_pushes_of_the_handle(folder: Folder) -> None:
    handle, leaf = (phase for phase in folder.phases if phase["name"] in ("turn the handle", "open"))
    leaf.update(pushes=handle["pushes"], loads=handle["loads"], pressed=handle["pressed"])


@INVENTED.lie(*HANDS)
def the_hand_may_lean_by_90_degrees(folder: Folder) -> None:
    for target in folder.targets("relative_pose"):
        target["rotation_tolerance_deg"] = 90.0


@INVENTED.lie("drawer", "door", "lever")
def the_hand_may_slide_along(folder: Folder) -> None:
    for target in folder.targets("relative_pose"):
        target["slide"] = [0.0, 0.0, 0.1]


@INVENTED.lie("drawer", "door", "gripper")
def hands_may_be_3_cm_deep_in_what_they_hold(folder: Folder) -> None:
    for phase in folder.phases:
        for allowance in phase["allowances"]:
            if "mechanism" in str(allowance) or "door/" in str(allowance) or "valve/" in str(allowance):
                allowance["depth"] = 0.03


# What the object demands.
@INVENTED.lie("drawer", "door", "lever", "valve", "gripper")
def loads_of_half_the_size(folder: Folder) -> None:
    for load in _loads(folder):
        load["force_n"] = [0.5 * value for value in load["force_n"]]


@INVENTED.lie("drawer", "door", "lever")
def loads_the_other_way(folder: Folder) -> None:
    for load in _loads(folder):
        load["force_n"] = [-value for value in load["force_n"]]


@INVENTED.lie("drawer", "door", "valve")
def loads_of_the_other_hand(folder: Folder) -> None:
    for load in _loads(folder):
        load["tool"] = ("l" if load["tool"][0] == "r" else "r") + load["tool"][1:]


@INVENTED.lie("drawer", "door", level=FITTED)
def loads_that_may_drift_by_half_a_metre(folder: Folder) -> None:
    for load in _loads(folder):
        load["drift_m"] = 0.5


@INVENTED.lie("drawer", level=HASHED)
def a_drawer_of_60_kg(folder: Folder) -> None:
    _edit_urdf(folder, '<link name="drawer">', f'<link name="drawer">{INERTIAL}')


INERTIAL = '<inertial><mass value="60"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


@INVENTED.lie("drawer", "resume", "compliant", level=HASHED)
def a_drawer_that_is_damped(folder: Folder) -> None:
    _edit_urdf(folder, '<joint name="slide" type="prismatic">', f'<joint name="slide" type="prismatic">{DAMPED}')


DAMPED = '<dynamics damping="200" friction="0"/>'


@INVENTED.lie("drawer", level=HASHED)
def a_drawer_on_a_slope(folder: Folder) -> None:
    _edit_urdf(folder, 'axis xyz="-1 0 0"', 'axis xyz="-0.98 0 0.2"')


def _edit_urdf(folder: Folder, old: str, new: str) -> None:
    mechanism = _task(folder, "mechanism")
    mechanism["urdf"] = mechanism["urdf"].replace(old, new)


@INVENTED.lie("drawer", "resume", level=HASHED)
def a_drawer_that_the_left_hand_pulls(folder: Folder) -> None:
    _task(folder, "mechanism")["hand"] = "left"


@INVENTED.lie("drawer", level=HASHED)
def a_drawer_that_is_pushed_back_in(folder: Folder) -> None:
    moves = _task(folder, "mechanism")["moves"]
    moves.append({**moves[0], "to": 0.0})


@INVENTED.lie("drawer", level=HASHED)
def a_drawer_at_which_the_hand_stays(folder: Folder) -> None:
    _task(folder, "mechanism")["stays"] = True


@INVENTED.lie("door", level=HASHED)
def a_lever_that_is_four_times_as_stiff(folder: Folder) -> None:
    _task(folder, "door")["lever_nm"] = 8.0


@INVENTED.lie("door", level=HASHED)
def a_hinge_that_is_twice_as_stiff(folder: Folder) -> None:
    _task(folder, "door")["hinge_nm"] = 60.0


@INVENTED.lie("door", level=HASHED)
def a_latch_that_is_freed_later(folder: Folder) -> None:
    _task(folder, "door")["release_deg"] = 35.0


@INVENTED.lie("door", level=HASHED)
def a_door_that_opens_by_one_degree_more(folder: Folder) -> None:
    _task(folder, "door")["open_deg"] = 61.0


@INVENTED.lie("valve", level=HASHED)
def spokes_elsewhere(folder: Folder) -> None:
    valve = _task(folder, "valve")
    valve["spokes_deg"] = [angle + 10.0 for angle in valve["spokes_deg"]]


@INVENTED.lie("valve", "gripper", level=HASHED)
def a_wheel_of_twice_the_torque(folder: Folder) -> None:
    _task(folder, "valve")["torque_nm"] = 20.0


# How the object moves.
@INVENTED.lie("drawer", "lever", "valve")
def the_joint_turned_round_with_its_values(folder: Folder) -> None:
    """Describe the same motion with the opposite axis and negative values."""
    movable = folder.data["movables"][0]
    movable["axis"] = [-value for value in movable["axis"]]
    lower, upper = movable["lower"], movable["upper"]
    movable["lower"], movable["upper"] = (None if value is None else -value for value in (upper, lower))
    for name in ("positions", "tangents"):
        for row in folder.curve[name]:
            row[-1] = -row[-1]


@INVENTED.lie("drawer")
def the_zero_of_the_slide_moved(folder: Folder) -> None:
    movable = folder.data["movables"][0]
    movable["origin"] = (np.array(movable["origin"]) + 0.05 * np.array(movable["axis"])).tolist()
    movable["start"] -= 0.05
    for row in folder.curve["positions"]:
        row[-1] -= 0.05


@INVENTED.lie("drawer", "door", "lever", "valve")
def objects_of_half_the_size(folder: Folder) -> None:
    for movable in folder.data["movables"]:
        for body in movable["bodies"]:
            points = np.array(body["vertices"])
            body["vertices"] = (points.mean(axis=0) + 0.5 * (points - points.mean(axis=0))).tolist()


@INVENTED.lie("door")
def a_handle_that_does_not_move_with_the_leaf(folder: Folder) -> None:
    folder.data["movables"][1]["parent"] = None


@INVENTED.lie("door")
def a_latch_that_is_free_at_once(folder: Folder) -> None:
    folder.data["releases"][0].update(latch_at=0.0)


@INVENTED.lie("door")
def a_latch_that_lets_the_leaf_go_farther(folder: Folder) -> None:
    folder.data["releases"][0].update(free_beyond=2.0)


@INVENTED.lie("door")
def the_hold_of_the_handle_left_out(folder: Folder) -> None:
    """Leave out the phase in which the handle is turned, and count its motion as the approach's."""
    index = next(k for k, phase in enumerate(folder.phases) if phase["name"] == "turn the handle")
    folder.phases[index - 1]["last"] = folder.phases[index]["last"]
    del folder.phases[index]


@INVENTED.lie("drawer", "valve", "lever", "gripper")
def the_hold_counted_as_the_retraction(folder: Folder) -> None:
    index = next(k for k, phase in enumerate(folder.phases) if phase["pushes"])
    folder.phases[index + 1]["first"] = folder.phases[index]["first"]
    del folder.phases[index]


# What the scan shows, and what a result says of itself.
@INVENTED.lie("door", level=FITTED)
def parts_that_are_given_though_the_scan_shows_them(folder: Folder) -> None:
    for phase in folder.phases:
        for part in phase["pressed"]:
            part["source"] = "given"


@INVENTED.lie("door", level=HASHED)
def a_leaf_that_is_2_cm_narrower(folder: Folder) -> None:
    folder.data["detections"][0]["geometry"]["width"] -= 0.02


@INVENTED.lie("door", level=HASHED)
def a_hinge_1_cm_elsewhere(folder: Folder) -> None:
    folder.data["detections"][0]["geometry"]["hinge"][1] += 0.01


@INVENTED.lie("drawer", "door", "lever", "valve", "gripper", level=Level.RAW)
def stiffer_servos_that_give_way_less(folder: Folder) -> None:
    servo = folder.data["servo"]
    servo["stiffness"] = {name: 10.0 * value for name, value in servo["stiffness"].items()}
    servo.update(sag_m=0.1 * servo["sag_m"], margin_after_sag_m=servo["margin_after_sag_m"] + 0.005)


@INVENTED.lie("door", "valve", "gripper", "lever", level=Level.RAW)
def loads_that_it_could_hold_are_larger(folder: Folder) -> None:
    for name in folder.data["figures"]:
        folder.data["figures"][name] *= 1.2 if name.startswith("holds_") else 1.0


@INVENTED.lie("compliant", level=Level.RAW)
def a_hand_that_is_where_it_was(folder: Folder) -> None:
    folder.data["figures"].update(hand_displaced_mm=0.0, hand_displaced_deg=0.0)


@INVENTED.lie("drawer", "resume", level=Level.RAW)
def a_motion_that_keeps_an_earlier_one(folder: Folder) -> None:
    folder.data["figures"].update(hand_displaced_mm=1.0, hand_displaced_deg=0.1)


@INVENTED.lie("resume", "compliant", level=HASHED)
def the_drawer_open_where_the_rest_begins(folder: Folder) -> None:
    folder.request["resume"]["mechanism"]["slide"] = 0.05


@INVENTED.lie("resume", "compliant", level=HASHED)
def the_rest_of_another_plan(folder: Folder) -> None:
    folder.request["resume"]["plan"] = "sha256:" + "0" * 64


@INVENTED.lie("resume", "compliant", level=HASHED)
def the_rest_from_another_phase(folder: Folder) -> None:
    folder.request["resume"]["phase"] = "retract"


# Seats, steps and rails.
@INVENTED.lie("egress", "chair", "stair")
def what_carried_first_carries_to_the_end(folder: Folder) -> None:
    for phase in folder.phases[1:]:
        phase.update(contacts=folder.phases[0]["contacts"], regions=folder.phases[0]["regions"])


@INVENTED.lie("egress", "chair", "stair")
def contacts_that_bear_ten_times_as_much(folder: Folder) -> None:
    for phase in folder.phases:
        for contact in phase["contacts"]:
            contact["force_cap_n"] *= 10.0


@INVENTED.lie("stair", "egress")
def points_of_each_contact_2_cm_apart(folder: Folder) -> None:
    for phase in folder.phases:
        for contact in phase["contacts"]:
            for point in contact["sole"]:
                point[0] += 0.02


@INVENTED.lie("egress", level=HASHED)
def an_egress_that_goes_on(folder: Folder) -> None:
    _task(folder, "egress")["until"] = None


@INVENTED.lie("stair", level=HASHED)
def a_rail_10_cm_lower(folder: Folder) -> None:
    folder.request["scene"]["obstacles"][1]["position"][2] -= 0.1


@INVENTED.lie("stair", level=HASHED)
def a_hand_that_may_press_less(folder: Folder) -> None:
    folder.request["robot"]["contacts"]["right_hook"]["force_cap_n"] = 20.0


# What only the independent program reads.
@INVENTED.for_stranger("carry")
def a_hand_that_turns_by_less_than_it_does(folder: Folder) -> None:
    for target in folder.targets("relative_pose"):
        target["rotation_tolerance_deg"] = 0.01
