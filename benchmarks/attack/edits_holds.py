"""Edits of what a hand does to an object: motions whose hand does not push it, and contacts that are not there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.attack.forgery import Folder, Level, Registry

HOLDS = Registry()
OFF_M = 0.005  # more than surfaces that touch may be apart


def _moving(folder: Folder) -> tuple[dict[str, Any], int]:
    """Return a phase in which a hand pushes a joint, and the joint's column of the curve."""
    phase = next(phase for phase in folder.phases if phase["pushes"])
    return phase, folder.curve["joint_names"].index(phase["pushes"][-1]["joint"])


def _list_pushes(folder: Folder) -> Iterator[dict[str, Any]]:
    for phase in folder.phases:
        yield from phase["pushes"]


def _find_knots(folder: Folder, phase: dict[str, Any]) -> np.ndarray:
    """Return the indices of the knots inside a phase, without its borders."""
    samples, knots = folder.curve["samples"], np.array(folder.curve["knots"])
    first, last = samples[phase["first"]], samples[phase["last"]]
    return np.flatnonzero((knots > first + 1e-9) & (knots < last - 1e-9))


def _shift(folder: Folder, by: float) -> None:
    """Move the object away from the hand, or into it, in the middle of a move."""
    phase, column = _moving(folder)
    inside = _find_knots(folder, phase)
    sense = phase["pushes"][-1]["sense"]
    for k in inside[len(inside) // 4 : -(len(inside) // 4) or None].tolist():
        folder.curve["positions"][k][column] += sense * by


@HOLDS.lie("drawer", "lever", "compliant", stranger=True)
def the_rod_is_off_the_face_during_the_move(folder: Folder) -> None:
    _shift(folder, OFF_M if folder.data["movables"][0]["type"] == "prismatic" else OFF_M / 0.15)


@HOLDS.lie("drawer", "lever", stranger=True)
def the_rod_is_inside_the_face_during_the_move(folder: Folder) -> None:
    _shift(folder, -4 * OFF_M if folder.data["movables"][0]["type"] == "prismatic" else -4 * OFF_M / 0.15)


@HOLDS.lie("drawer", "door", "lever", "gripper", stranger=True)
def the_hand_lets_go_half_way(folder: Folder) -> None:
    """Leave the robot where it is in the middle of the move, and let the object go on."""
    phase, _ = _moving(folder)
    inside = _find_knots(folder, phase)
    middle, n = int(inside[len(inside) // 2]), len(folder.data["trajectory"]["joint_names"]) - 1
    rows, rates = folder.curve["positions"], folder.curve["tangents"]
    for k in range(middle, len(rows)):
        rows[k][:n] = rows[middle][:n]
        rates[k][:n] = [0.0] * n


@HOLDS.lie("drawer", "door", stranger=True)
def the_object_moves_while_the_hand_rests(folder: Folder) -> None:
    """Move the object by itself from the first moment on."""
    _, column = _moving(folder)
    knots = np.array(folder.curve["knots"])
    end = folder.curve["positions"][-1][column]
    share = (knots - knots[0]) / (knots[-1] - knots[0])
    for k, part in enumerate(share.tolist()):
        folder.curve["positions"][k][column] = end * part
        folder.curve["tangents"][k][column] = end / (knots[-1] - knots[0])


@HOLDS.lie("drawer", "door")
def the_object_goes_back_by_itself(folder: Folder) -> None:
    phase, column = _moving(folder)
    border = int(_find_knots(folder, phase)[-1]) + 1
    for k in range(border + 1, len(folder.curve["positions"])):
        folder.curve["positions"][k][column] *= 0.5


@HOLDS.lie("drawer", "door", "gripper")
def the_law_is_twice_as_fast_as_the_loads_are_made_for(folder: Folder) -> None:
    law = folder.curve["law"]
    law.update(times=[0.5 * t for t in law["times"]], speed=[2.0 * v for v in law["speed"]])


@HOLDS.lie("drawer", "door")
def the_law_is_twice_as_fast_and_the_joints_may_be_too(folder: Folder) -> None:
    the_law_is_twice_as_fast_as_the_loads_are_made_for(folder)
    folder.request["options"].update(velocity_scale=1.0, acceleration_scale=1.0)
    for movable in folder.data["movables"]:
        movable.update(velocity=4.0 * movable["velocity"], acceleration=4.0 * movable["acceleration"])


@HOLDS.lie("drawer", "lever", "door", level=Level.FITTED, stranger=True)
def a_push_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["pushes"] = phase["pushes"][1:]


@HOLDS.lie("drawer", "door", "lever", level=Level.FITTED)
def every_push_the_other_way(folder: Folder) -> None:
    for push in _list_pushes(folder):
        push["sense"] *= -1.0


@HOLDS.lie("drawer", "door", level=Level.FITTED)
def a_wider_friction(folder: Folder) -> None:
    for push in _list_pushes(folder):
        push["friction"] = [0.6, 0.6]


@HOLDS.lie("drawer", "door", level=Level.FITTED)
def a_lower_force(folder: Folder) -> None:
    for push in _list_pushes(folder):
        push["force_n"] *= 0.1


@HOLDS.lie("gripper", level=Level.FITTED)
def pads_of_twice_the_size(folder: Folder) -> None:
    """Pads that would resist twice the torsion."""
    for push in _list_pushes(folder):
        for contact in push["contacts"]:
            core = np.array(contact["core"])
            contact["core"] = (core.mean(axis=0) + 2.0 * (core - core.mean(axis=0))).tolist()


@HOLDS.lie("drawer", "door", "gripper", level=Level.FITTED)
def a_bigger_cap(folder: Folder) -> None:
    for push in _list_pushes(folder):
        for contact in push["contacts"]:
            contact["cap_n"] *= 10.0


@HOLDS.lie("door", level=Level.FITTED)
def a_held_joint_left_out(folder: Folder) -> None:
    for push in _list_pushes(folder):
        push["held"] = []


@HOLDS.lie("door", level=Level.FITTED)
def a_held_joint_that_bears_everything(folder: Folder) -> None:
    for push in _list_pushes(folder):
        for held in push["held"]:
            held.update(low=None, high=None)


@HOLDS.lie("drawer", "door", level=Level.FITTED)
def another_body_is_pressed(folder: Folder) -> None:
    other = folder.data["movables"][0]
    for push in _list_pushes(folder):
        for contact in push["contacts"]:
            contact.update(link=other["name"], body=other["bodies"][0]["name"])


@HOLDS.lie("drawer", level=Level.FITTED)
def the_contact_of_another_surface(folder: Folder) -> None:
    for push in _list_pushes(folder):
        for contact in push["contacts"]:
            contact.update(surface="the tip", core=contact["core"][-1:])


@HOLDS.lie("drawer", "door")
def the_contact_of_another_surface_remade(folder: Folder) -> None:
    the_contact_of_another_surface(folder)


@HOLDS.lie("drawer", "door", level=Level.FITTED)
def what_is_pressed_is_no_longer_said(folder: Folder) -> None:
    for phase in folder.phases:
        phase["pressed"] = None


@HOLDS.lie("drawer", "door", level=Level.FITTED)
def pushes_as_before_they_were_written(folder: Folder) -> None:
    for phase in folder.phases:
        del phase["pushes"], phase["pressed"]


@HOLDS.lie("door", level=Level.FITTED)
def a_part_with_more_points(folder: Folder) -> None:
    for phase in folder.phases:
        for part in phase["pressed"]:
            part.update(n_points=part["n_points"] + 5, n_through=0)


@HOLDS.lie("drawer", level=Level.HASHED)
def the_rod_on_the_other_side_of_the_bar(folder: Folder) -> None:
    handle = folder.request["task"]["mechanism"]["handle"]
    handle["place"] = [-handle["place"][0], *handle["place"][1:]]


@HOLDS.lie("drawer", level=Level.HASHED)
def a_heavier_drawer(folder: Folder) -> None:
    folder.request["task"]["mechanism"]["joints"]["slide"]["friction"] = 300.0


@HOLDS.lie("drawer", level=Level.HASHED)
def a_drawer_that_comes_out_farther(folder: Folder) -> None:
    folder.request["task"]["mechanism"]["moves"][0]["to"] += 0.02


@HOLDS.lie("drawer", "door", level=Level.HASHED)
def hands_that_slip(folder: Folder) -> None:
    """Give hands another friction in the request, and leave the pushes as they are."""
    folder.request["options"]["hand_friction"] = [0.05, 0.9]
    folder.data.update(request_format=3, request_defaults={})


@HOLDS.lie("drawer", "door", "gripper", level=Level.HASHED)
def defaults_that_no_release_had(folder: Folder) -> None:
    folder.data["request_defaults"]["Options.hand_friction"] = [0.5, 0.6]


@HOLDS.lie("drawer", "door", "gripper", level=Level.HASHED)
def defaults_left_out(folder: Folder) -> None:
    folder.data["request_defaults"] = {}


@HOLDS.lie("drawer", "door", "gripper", level=Level.RAW)
def servos_that_give_way_less(folder: Folder) -> None:
    servo = folder.data["servo"]
    servo.update(sag_m=0.1 * servo["sag_m"], hands=[])


@HOLDS.harmless("drawer", "door", "gripper", "egress", "resume", "compliant", "lever", "stair", "chair", "steps")
def nothing_but_the_notes_changed(folder: Folder) -> None:
    folder.data["notes"] = ["read by a person"]


@HOLDS.harmless("drawer", "door", "gripper", "egress", "resume", "compliant", level=Level.REMADE)
def written_once_more(folder: Folder) -> None:
    folder.data["found_from"] = "written once more"


@HOLDS.harmless("drawer", "door", level=Level.FITTED)
def fitted_once_more(folder: Folder) -> None:
    folder.data["found_from"] = "fitted once more"
