"""Edits of a result that turns the lever of a valve: where the peg pushes, how far, and between which stops."""

from __future__ import annotations

import math
from typing import Any, cast

from benchmarks.attack.forgery import Folder, Level, Registry

LEVER = Registry()
HASHED = Level.HASHED


def _valve(folder: Folder) -> dict[str, Any]:
    return cast("dict[str, Any]", folder.request["task"]["valve"])


@LEVER.lie("lever", level=HASHED)
def lever_10_mm_shorter(folder: Folder) -> None:
    _valve(folder)["lever"]["length_m"] -= 0.01


@LEVER.lie("lever", level=HASHED)
def lever_3_mm_thicker(folder: Folder) -> None:
    _valve(folder)["lever"]["radius_m"] += 0.003


@LEVER.lie("lever", level=HASHED)
def lever_turned_by_5_degrees(folder: Folder) -> None:
    angle = math.radians(5.0)
    _valve(folder)["lever"]["direction"] = [0.0, math.sin(angle), math.cos(angle)]


@LEVER.lie("lever", level=HASHED)
def lever_turned_the_other_way(folder: Folder) -> None:
    _valve(folder)["turn_deg"] = -90.0


@LEVER.lie("lever", level=HASHED)
def lever_that_stops_at_60_degrees(folder: Folder) -> None:
    _valve(folder)["stops_deg"] = [0.0, 60.0]


@LEVER.lie("lever", level=HASHED)
def lever_that_is_a_crank(folder: Folder) -> None:
    _valve(folder)["lever"]["grip_m"] = 0.1


@LEVER.lie("lever", level=HASHED)
def lever_that_takes_40_nm(folder: Folder) -> None:
    _valve(folder)["torque_nm"] = 40.0


@LEVER.lie("lever")
def stops_of_the_joint_widened(folder: Folder) -> None:
    folder.data["movables"][0].update(lower=-1.0, upper=3.0)


@LEVER.lie("lever")
def lever_turns_half_as_far(folder: Folder) -> None:
    for row in folder.curve["positions"]:
        row[-1] *= 0.5
    for row in folder.curve["tangents"]:
        row[-1] *= 0.5


@LEVER.lie("lever")
def lever_is_turned_beyond_its_stop(folder: Folder) -> None:
    for name in ("positions", "tangents"):
        for row in folder.curve[name]:
            row[-1] *= 1.05


@LEVER.lie("lever")
def peg_pulls_from_the_other_side(folder: Folder) -> None:
    for phase in folder.phases:
        for target in phase["targets"]:
            if target["kind"] == "relative_pose":
                target["position"][1] *= -1.0


@LEVER.lie("lever")
def lever_without_a_bar(folder: Folder) -> None:
    folder.data["movables"][0]["bodies"] = folder.data["movables"][0]["bodies"][1:]


@LEVER.lie("lever")
def peg_may_be_deep_in_the_lever(folder: Folder) -> None:
    for phase in folder.phases:
        for allowance in phase["allowances"]:
            if allowance["second"]["body"] == "valve/bar":
                allowance["depth"] = 0.03


@LEVER.lie("lever")
def lever_without_load(folder: Folder) -> None:
    for phase in folder.phases:
        phase["loads"], phase["regions"] = [], []
