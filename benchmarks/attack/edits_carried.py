"""Edits of what carries an object, and of the hole that it goes into: carriers, masses, places, friction."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.attack.forgery import Folder, Level, Registry

CARRIED = Registry()
HELD = ("lift", "carry", "lower")


def _phase(folder: Folder, name: str) -> dict[str, Any]:
    return next(phase for phase in folder.phases if phase["name"] == name)


def _carrier(folder: Folder, name: str) -> dict[str, Any]:
    found: dict[str, Any] = _phase(folder, name)["carriers"][0]
    return found


@CARRIED.lie("carried", stranger=True)
def an_object_let_go_in_the_air(folder: Folder) -> None:
    for name in ("carry", "lower"):
        _carrier(folder, name).update(link=None, grips=[])


@CARRIED.lie("carried")
def an_object_carried_by_the_column(folder: Folder) -> None:
    for name in HELD:
        _carrier(folder, name)["link"] = "column"


@CARRIED.lie("carried", stranger=True)
def an_object_taken_before_the_fingers_close(folder: Folder) -> None:
    _carrier(folder, "grasp: enter").update(_carrier(folder, "lift"))


@CARRIED.lie("carried", level=Level.FITTED)
def half_of_the_object_s_mass(folder: Folder) -> None:
    item = folder.data["objects"][0]
    item["mass_kg"] *= 0.5
    item["moments"] = (0.5 * np.array(item["moments"])).tolist()


@CARRIED.lie("carried", stranger=True)
def an_object_of_twenty_times_the_mass(folder: Folder) -> None:
    folder.data["objects"][0]["mass_kg"] *= 20.0


@CARRIED.lie("carried")
def an_object_that_was_3_mm_beside_its_grasp(folder: Folder) -> None:
    folder.data["objects"][0]["start"]["position"][0] += 0.003


@CARRIED.lie("carried")
def an_object_that_is_smaller_than_the_request_s(folder: Folder) -> None:
    item = folder.data["objects"][0]
    item["vertices"] = (0.9 * np.array(item["vertices"])).tolist()


@CARRIED.lie("carried")
def a_place_moved_by_20_mm(folder: Folder) -> None:
    folder.request["task"]["pick_place"]["to"]["position"][0] += 0.02


@CARRIED.lie("carried", level=Level.FITTED)
def fingers_that_press_harder_than_they_can(folder: Folder) -> None:
    for name in HELD:
        _carrier(folder, name)["grips"][0]["force_n"] = 1000.0


@CARRIED.lie("carried", level=Level.FITTED)
def fingers_that_do_not_slip(folder: Folder) -> None:
    for name in HELD:
        _carrier(folder, name)["grips"][0]["friction"] = 5.0


@CARRIED.lie("carried", level=Level.FITTED)
def one_finger_holds_alone(folder: Folder) -> None:
    for name in HELD:
        _carrier(folder, name)["grips"][0]["fingers"] = ["finger_1"]


@CARRIED.lie("carried", stranger=True)
def fingers_open_as_they_carry(folder: Folder) -> None:
    column = folder.curve["joint_names"].index("grip_1")
    samples, knots = folder.curve["samples"], np.array(folder.curve["knots"])
    first, last = (samples[_phase(folder, "carry")[end]] for end in ("first", "last"))
    for k in np.flatnonzero((knots > first + 1e-9) & (knots < last - 1e-9)).tolist():
        folder.curve["positions"][k][column] += 4e-3


@CARRIED.lie("carried", level=Level.FITTED)
def no_objects(folder: Folder) -> None:
    folder.data["objects"] = []
    for phase in folder.phases:
        phase["carriers"] = []


@CARRIED.lie("carried", level=Level.FITTED)
def an_allowance_of_the_object_for_the_wall(folder: Folder) -> None:
    _phase(folder, "carry")["allowances"].append(
        {
            "first": {"owner": "robot", "link": "block", "body": None},
            "second": {"owner": "scene", "link": None, "body": "table"},
            "depth": 0.05,
        }
    )


def _hole(folder: Folder) -> dict[str, Any]:
    found: dict[str, Any] = next(target for target in _phase(folder, "in")["targets"] if target["kind"] == "hole")
    return found


@CARRIED.lie("peg")
def a_hole_less_deep(folder: Folder) -> None:
    folder.request["task"]["steps"][3]["insert"]["depth_m"] -= 0.02


@CARRIED.lie("peg")
def a_hole_4_mm_beside(folder: Folder) -> None:
    folder.request["task"]["steps"][3]["insert"]["at"][0] += 0.004


@CARRIED.lie("peg", level=Level.FITTED)
def a_hole_without_friction(folder: Folder) -> None:
    _hole(folder)["friction"] = 1e-3


@CARRIED.lie("peg", level=Level.FITTED)
def a_hand_that_yields_to_every_wall(folder: Folder) -> None:
    _hole(folder).update(stiffness_n_m=10.0, turn_stiffness_n_m_rad=1.0)


@CARRIED.lie("peg", level=Level.REMADE)
def an_object_that_cannot_jam(folder: Folder) -> None:
    targets = _phase(folder, "in")["targets"]
    targets.remove(_hole(folder))


@CARRIED.lie("peg", level=Level.REMADE)
def a_hole_of_a_thousand_times_the_stiffness(folder: Folder) -> None:
    _hole(folder).update(stiffness_n_m=1e7, turn_stiffness_n_m_rad=1.0)
