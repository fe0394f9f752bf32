"""Edits of planted feet, balance and allowances, with the certificate computed again."""

from __future__ import annotations

from typing import Any

from benchmarks.attack.forgery import Folder, Level, Registry

CONTACTS = Registry()
STANDING = ("reach", "carry", "valve")


def allowance(
    first: tuple[str, str | None, str | None], second: tuple[str, str | None, str | None], depth: float
) -> Any:
    """Return an allowance in the format of a result; each of the two is owner, link and body."""
    one, other = (dict(zip(("owner", "link", "body"), names, strict=True)) for names in (first, second))
    return {"first": one, "second": other, "depth": depth}


def hand_of(folder: Folder) -> tuple[str, str | None, str | None]:
    """Return the link at the end of the robot's arm."""
    return ("robot", "l_hook" if folder.data["robot"]["root"] == "floating" else "hand", None)


def _every_contact(folder: Folder) -> list[dict[str, Any]]:
    return [contact for phase in folder.phases for contact in phase["contacts"]]


@CONTACTS.lie(*STANDING)
def feet_removed_from_contacts(folder: Folder) -> None:
    for phase in folder.phases:
        phase["contacts"] = []


@CONTACTS.lie(*STANDING)
def one_foot_removed_from_contacts(folder: Folder) -> None:
    for phase in folder.phases:
        phase["contacts"] = phase["contacts"][:1]


@CONTACTS.lie("reach", "valve")
def feet_and_balance_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase.update(contacts=[], support=None)


@CONTACTS.lie("reach", "valve")
def contact_tolerance_loosened(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact.update(tolerance_m=0.05, knot_tolerance_m=0.05)


@CONTACTS.lie("reach", stranger=True)
def planted_elsewhere(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["position"][0] += 0.1
        contact["sole"] = [[x + 0.1, y, z] for x, y, z in contact["sole"]]


@CONTACTS.lie("reach", "valve")
def sole_corners_moved_outwards(folder: Folder) -> None:
    for contact in _every_contact(folder):
        x0, y0, _ = contact["position"]
        contact["sole"] = [[x0 + 2.0 * (x - x0), y0 + 2.0 * (y - y0), z] for x, y, z in contact["sole"]]


@CONTACTS.lie("reach")
def sole_reduced_to_one_corner(folder: Folder) -> None:
    for contact in _every_contact(folder):
        contact["sole"] = contact["sole"][:1]


@CONTACTS.lie("reach")
def a_hand_called_planted(folder: Folder) -> None:
    for phase in folder.phases:
        phase["contacts"][1]["link"] = "pelvis"


@CONTACTS.lie("reach", "valve")
def sole_and_polygon_enlarged(folder: Folder) -> None:
    sole_corners_moved_outwards(folder)
    for phase in folder.phases:
        phase["support"]["polygon"] = [[3.0 * x, 3.0 * y] for x, y in phase["support"]["polygon"]]


@CONTACTS.lie(*STANDING)
def support_polygon_enlarged(folder: Folder) -> None:
    for phase in folder.phases:
        phase["support"]["polygon"] = [[3.0 * x, 3.0 * y] for x, y in phase["support"]["polygon"]]


@CONTACTS.lie(*STANDING)
def support_polygon_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["support"] = None


@CONTACTS.lie(*STANDING)
def balance_margin_lowered(folder: Folder) -> None:
    for phase in folder.phases:
        phase["support"]["margin_m"] = 0.0


@CONTACTS.lie("reach")
def balance_margin_negative(folder: Folder) -> None:
    for phase in folder.phases:
        phase["support"]["margin_m"] = -1.0


@CONTACTS.lie("reach")
def zmp_taken_on_another_plane(folder: Folder) -> None:
    for phase in folder.phases:
        phase["support"]["height"] = 0.9


@CONTACTS.lie("arm", "reach", "carry", "valve")
def allowance_added(folder: Folder) -> None:
    piece = ("scene", None, folder.data["pieces"][0]["name"])
    for phase in folder.phases:
        phase["allowances"].append(allowance(hand_of(folder), piece, 0.05))


@CONTACTS.lie("arm", "reach")
def allowance_for_everything(folder: Folder) -> None:
    links = sorted({body["link"] for body in folder.data["bodies"]})
    pieces = [piece["name"] for piece in folder.data["pieces"]]
    for phase in folder.phases:
        phase["allowances"] += [
            allowance(("robot", link, None), ("scene", None, piece), 0.5) for link in links for piece in pieces
        ]


@CONTACTS.lie("arm")
def allowance_between_links(folder: Folder) -> None:
    folder.phases[0]["allowances"].append(allowance(hand_of(folder), ("robot", "upper_arm", None), 0.2))


@CONTACTS.lie("arm", "reach", level=Level.RAW)
def allowance_by_a_pattern(folder: Folder) -> None:
    for phase in folder.phases:
        phase["allowances"].append({"link": "*", "other": "*", "depth": 0.5})


@CONTACTS.lie("reach", "valve")
def allowance_deepened(folder: Folder) -> None:
    for phase in folder.phases:
        for entry in phase["allowances"]:
            entry["depth"] = 0.2


@CONTACTS.lie("reach", "valve")
def allowance_retargeted(folder: Folder) -> None:
    for phase in folder.phases:
        phase["allowances"][-1]["second"] = allowance(
            hand_of(folder), ("scene", None, folder.data["pieces"][0]["name"]), 0.0
        )["second"]


@CONTACTS.lie("valve")
def allowance_of_the_rim_for_the_hub(folder: Folder) -> None:
    for phase in folder.phases[1:]:
        phase["allowances"].append(allowance(hand_of(folder), ("mechanism", "valve", None), 0.03))


@CONTACTS.lie("valve")
def allowance_of_the_hook_for_the_reach_too(folder: Folder) -> None:
    folder.phases[0]["allowances"] = list(folder.phases[1]["allowances"])


@CONTACTS.lie("valve")
def allowance_of_the_wheel_in_a_piece(folder: Folder) -> None:
    piece = ("scene", None, folder.data["pieces"][0]["name"])
    for phase in folder.phases:
        phase["allowances"].append(allowance(("mechanism", "valve", None), piece, 0.1))


@CONTACTS.lie("valve")
def allowance_of_the_other_hook(folder: Folder) -> None:
    for phase in folder.phases[1:]:
        phase["allowances"].append(allowance(("robot", "r_hook", None), ("mechanism", "valve", "valve/rim/9"), 0.03))
