"""Edits of motions whose contacts change: contacts, normals, friction, regions and their forces, and phases."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.attack.edits_contacts import allowance
from benchmarks.attack.forgery import Folder, Level, Registry

STANCES = Registry()
CHANGING = ("steps", "chair")


def _every_contact(folder: Folder) -> list[dict[str, Any]]:
    return [contact for phase in folder.phases for contact in phase["contacts"]]


def _every_region(folder: Folder) -> list[dict[str, Any]]:
    return [region for phase in folder.phases for region in phase["regions"]]


def _of_one_foot(folder: Folder) -> list[dict[str, Any]]:
    """Return the phases in which less is planted than in the first."""
    return [phase for phase in folder.phases if len(phase["contacts"]) < len(folder.phases[0]["contacts"])]


def _take_stance(phase: dict[str, Any], other: dict[str, Any]) -> None:
    """Give a phase the contacts of another, and what proves them."""
    phase["contacts"] = other["contacts"]
    _take_region(phase, other)


def _take_region(phase: dict[str, Any], other: dict[str, Any]) -> None:
    keys = ("polygon", "wrenches", "witnesses")
    for region in phase["regions"]:
        region.update({key: other["regions"][0][key] for key in keys})


def _turn(normal: list[float], angle: float) -> list[float]:
    """Return a normal turned towards the world's x axis by an angle [rad]."""
    x, y, z = normal
    c, s = np.cos(angle), np.sin(angle)
    return [c * x + s * z, y, c * z - s * x]


@STANCES.lie(*CHANGING, stranger=True)
def a_link_in_the_air_called_planted(folder: Folder) -> None:
    for phase in _of_one_foot(folder):
        _take_stance(phase, folder.phases[0])


@STANCES.lie(*CHANGING)
def a_contact_called_absent(folder: Folder) -> None:
    alone = _of_one_foot(folder)[0]
    for phase in folder.phases:
        if len(phase["contacts"]) > len(alone["contacts"]):
            _take_stance(phase, alone)
            return


@STANCES.lie("steps")
def the_pelvis_called_planted_in_the_air(folder: Folder) -> None:
    for phase in folder.phases:
        x, y, z = phase["contacts"][0]["position"]
        seat = {**phase["contacts"][0], "link": "pelvis", "position": [x, y, z + 0.8]}
        seat["sole"] = [[px, py, pz + 0.8] for px, py, pz in seat["sole"]]
        phase["contacts"].append(seat)
        for region in phase["regions"]:
            for forces in region["witnesses"]:
                for row in forces:
                    row += [[0.0, 0.0, 0.0]] * len(seat["sole"])


@STANCES.lie(*CHANGING)
def contacts_listed_twice(folder: Folder) -> None:
    for phase in folder.phases:
        phase["contacts"] = [*phase["contacts"], *phase["contacts"]]
        for region in phase["regions"]:
            half = 0.5 * np.array(region["witnesses"])
            region["witnesses"] = np.concatenate([half, half], axis=2).tolist()


@STANCES.lie(*CHANGING)
def points_of_contacts_listed_twice(folder: Folder) -> None:
    for phase in folder.phases:
        counts = np.cumsum([len(contact["sole"]) for contact in phase["contacts"]])[:-1]
        for region in phase["regions"]:
            parts = np.split(0.5 * np.array(region["witnesses"]), counts, axis=2)
            region["witnesses"] = np.concatenate([part for own in parts for part in (own, own)], axis=2).tolist()
        for contact in phase["contacts"]:
            contact["sole"] = [*contact["sole"], *contact["sole"]]


@STANCES.lie(*CHANGING, stranger=True)
def contact_moved_off_its_stone(folder: Folder) -> None:
    for contact in folder.phases[-1]["contacts"]:
        contact["position"][0] += 0.2
        contact["sole"] = [[x + 0.2, y, z] for x, y, z in contact["sole"]]


@STANCES.lie(*CHANGING, stranger=True)
def normals_tilted(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["normal"] = _turn(contact["normal"], 0.3)


@STANCES.lie(*CHANGING)
def normals_tilted_and_the_tilt_stated(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact.update(normal=_turn(contact["normal"], 0.3), tilt_rad=0.31)


@STANCES.lie(*CHANGING)
def normals_turned_round(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["normal"] = [-value for value in contact["normal"]]


@STANCES.lie("steps")
def normals_not_of_unit_length(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["normal"] = [5.0 * value for value in contact["normal"]]


@STANCES.lie("steps")
def normals_left_out(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact.update(normal=None)


@STANCES.lie("steps", level=Level.HASHED)
def tilt_that_is_no_number(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["tilt_rad"] = None


@STANCES.lie("stair")
def tilt_understated(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["tilt_rad"] = 0.0


@STANCES.lie("steps", "chair", "stair")
def friction_raised(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["friction"] = 1.5


@STANCES.lie("stair", "chair")
def force_caps_raised(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["force_cap_n"] *= 4.0


@STANCES.lie(*CHANGING)
def kept_contacts_may_slide(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact.update(tolerance_m=0.02, knot_tolerance_m=0.02)


@STANCES.lie("steps", stranger=True)
def a_kept_foot_slides(folder: Folder) -> None:
    rows = folder.curve["positions"]
    rows[len(rows) // 2][0] += 0.004


@STANCES.lie("steps", stranger=True)
def a_kept_contact_creeps(folder: Folder) -> None:
    for index, phase in enumerate(folder.phases):
        for contact in phase["contacts"]:
            contact["position"][0] += 5e-4 * index
            contact["sole"] = [[x + 5e-4 * index, y, z] for x, y, z in contact["sole"]]


@STANCES.lie(*CHANGING, stranger=True)
def region_enlarged(folder: Folder) -> None:
    for region in _every_region(folder):
        polygon = np.array(region["polygon"])
        region["polygon"] = (polygon.mean(axis=0) + 1.5 * (polygon - polygon.mean(axis=0))).tolist()


@STANCES.lie(*CHANGING, stranger=True)
def region_enlarged_with_its_forces(folder: Folder) -> None:
    """Extrapolate polygon and forces alike: all balances still hold."""
    for region in _every_region(folder):
        for key in ("polygon", "witnesses"):
            values = np.array(region[key])
            region[key] = (values.mean(axis=0) + 1.6 * (values - values.mean(axis=0))).tolist()


@STANCES.lie(*CHANGING, stranger=True)
def region_of_other_contacts(folder: Folder) -> None:
    for phase in folder.phases[1:]:
        _take_region(phase, folder.phases[0])


@STANCES.lie("steps", stranger=True)
def region_of_the_other_foot(folder: Folder) -> None:
    alone = _of_one_foot(folder)
    other = next(phase for phase in alone if phase["contacts"][0]["link"] != alone[0]["contacts"][0]["link"])
    _take_region(alone[0], other)


@STANCES.lie(*CHANGING, stranger=True)
def region_moved(folder: Folder) -> None:
    for region in _every_region(folder):
        region["polygon"] = [[x + 0.05, y] for x, y in region["polygon"]]


@STANCES.lie(*CHANGING)
def regions_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["regions"] = []


@STANCES.lie("steps")
def regions_of_half_of_each_phase(folder: Folder) -> None:
    for phase in folder.phases:
        for region in phase["regions"]:
            region["last"] = (region["first"] + region["last"]) // 2


@STANCES.lie("steps")
def region_margin_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["region_margin_m"] = None


@STANCES.lie("steps")
def region_margin_zero(folder: Folder) -> None:
    for phase in folder.phases:
        phase["region_margin_m"] = 0.0


@STANCES.lie(*CHANGING)
def region_margin_negative(folder: Folder) -> None:
    for phase in folder.phases:
        phase["region_margin_m"] = -1.0


@STANCES.lie("steps", stranger=True)
def support_polygon_of_soles_on_two_levels(folder: Folder) -> None:
    for phase in folder.phases:
        corners = np.concatenate([np.array(contact["sole"]) for contact in phase["contacts"]])
        low, high = corners.min(axis=0), corners.max(axis=0)
        box = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        phase.update(support={"polygon": box, "margin_m": 0.02, "height": 0.0}, region_margin_m=None, regions=[])


@STANCES.lie("steps")
def balance_waived(folder: Folder) -> None:
    for phase in folder.phases:
        phase.update(region_margin_m=None, regions=[])
    folder.data["waived"] = ["balance"]


@STANCES.lie("steps", stranger=True)
def the_robot_jumps_between_phases(folder: Folder) -> None:
    rows, border = folder.curve["positions"], len(folder.curve["positions"]) // 2
    for row in rows[border:]:
        row[0] += 0.3


@STANCES.lie(*CHANGING)
def contacts_that_change_while_the_robot_moves(folder: Folder) -> None:
    before, after = folder.phases[:2]
    border = (before["first"] + before["last"]) // 2
    before["last"] = after["first"] = border
    for phase in (before, after):
        for region in phase["regions"]:
            region.update(first=phase["first"], last=phase["last"])


@STANCES.lie("steps")
def lift_and_swing_merged(folder: Folder) -> None:
    lift, swing = folder.phases[1:3]
    swing.update(first=lift["first"])
    swing["regions"][0]["first"] = lift["first"]
    folder.data["phases"] = [phase for phase in folder.phases if phase is not lift]


@STANCES.lie("steps")
def the_last_step_left_out(folder: Folder) -> None:
    folder.data["phases"] = folder.phases[:-2]


@STANCES.lie("steps")
def phases_of_both_feet_exchanged(folder: Folder) -> None:
    first, second = folder.phases[0]["name"], folder.phases[4]["name"]
    folder.phases[0]["name"], folder.phases[4]["name"] = second, first


@STANCES.lie("steps")
def straight_lines_no_longer_promised(folder: Folder) -> None:
    for phase in folder.phases:
        phase["targets"] = []


@STANCES.lie("steps")
def the_swinging_foot_may_touch_a_stone(folder: Folder) -> None:
    for phase in folder.phases:
        for name in ("stone_1", "stone_2"):
            for foot in ("l_foot", "r_foot"):
                phase["allowances"].append(allowance(("robot", foot, None), ("scene", None, name), 0.05))


@STANCES.lie("rail")
def the_hand_never_reaches_the_rail(folder: Folder) -> None:
    rows = folder.curve["positions"]
    folder.curve["positions"] = [rows[0] for _ in rows]
    folder.curve["tangents"] = [[0.0] * len(row) for row in rows]


@STANCES.lie("rail", "steps")
def the_last_contact_stops_short_of_its_place(folder: Folder) -> None:
    rows = folder.curve["positions"]
    arm = [k for k, name in enumerate(folder.curve["joint_names"]) if name in ("r_arm_shx", "r_leg_kny", "l_leg_kny")]
    for column in arm:
        rows[-1][column] += 0.004


@STANCES.lie("steps")
def place_of_the_request_moved_by_4_mm(folder: Folder) -> None:
    stance = folder.request["task"]["contacts"]["stances"][0]
    stance["make"]["right_foot"]["at"][0] += 0.004


@STANCES.lie("steps")
def foot_of_the_request_turned(folder: Folder) -> None:
    stance = folder.request["task"]["contacts"]["stances"][0]
    stance["make"]["right_foot"]["yaw_deg"] = 5.0


@STANCES.lie("steps")
def stances_of_the_request_in_another_order(folder: Folder) -> None:
    folder.request["task"]["contacts"]["stances"].reverse()


@STANCES.lie("steps")
def a_stance_added_to_the_request(folder: Folder) -> None:
    stances = folder.request["task"]["contacts"]["stances"]
    place = {"surface": "stone_3", "at": [0.7, -0.12, 0.0], "yaw_deg": 0.0}
    stances.append({"name": "one more", "make": {"right_foot": place}, "release": []})


@STANCES.lie("chair")
def the_seat_left_out_of_the_start(folder: Folder) -> None:
    contacts = folder.request["task"]["contacts"]
    contacts["start"] = {"left_foot": "floor", "right_foot": "floor"}


@STANCES.lie("steps", "stair")
def friction_of_the_request_lowered(folder: Folder) -> None:
    for surface in folder.request["task"]["contacts"]["surfaces"].values():
        surface["friction"] = 0.05


@STANCES.lie("steps")
def a_stone_that_is_not_there(folder: Folder) -> None:
    """Keep its surface as a polygon in the air; the verdict would be for the changed request."""
    stone = next(o for o in folder.request["scene"]["obstacles"] if o["name"] == "stone_1")
    (lx, ly, lz), (x, y, z) = stone["size"], stone["position"]
    corners = [[x + sx * lx / 2, y + sy * ly / 2, z + lz / 2] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    surfaces = folder.request["task"]["contacts"]["surfaces"]
    surfaces["stone_1"] = {**surfaces["stone_1"], "piece": None, "corners": corners}
    folder.request["scene"]["obstacles"].remove(stone)
    folder.data["pieces"] = [piece for piece in folder.data["pieces"] if piece["name"] != "stone_1"]
    for phase in folder.phases:
        phase["allowances"] = [a for a in phase["allowances"] if a["second"]["body"] != "stone_1"]
