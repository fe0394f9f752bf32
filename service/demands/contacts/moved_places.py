"""Places of contacts that are moved along their surfaces, as far as the request leaves slack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from costs.scene import Scene
from service.demands.contacts.contact_task import face_pieces, find_off
from service.demands.contacts.stances import SAME_PLACE_M, ContactStance
from service.verify import Motion, PlantedContact

FINISH = "finish"


def list_movable(stances: Sequence[ContactStance]) -> tuple[tuple[int, str], ...]:
    """Return stance and patch of each place with slack that a later phase stands on, where it is made."""
    return tuple(
        (k, contact.patch)
        for k, (before, after) in enumerate(pairwise(stances[:-1]), start=1)
        for contact in after.contacts
        if contact.slack_m > 0.0 and not contact.is_kept_in(before) and contact.is_kept_in(stances[k + 1])
    )


def move_place(
    stances: Sequence[ContactStance], made: int, patch: str, by_m: float, scene: Scene
) -> tuple[ContactStance, ...]:
    """Return stances with the contact that one of them makes moved along its surface, as long as it stays.

    What is left of its slack on the nearer side stays its slack.

    Args:
        stances: that of the start first.
        made: stance that makes it.
        patch: of the robot.
        by_m: along ``Surface.along`` [m].
        scene: all pieces.
    """
    own = next(contact for contact in stances[made].contacts if contact.patch == patch)
    left = max(own.slack_m - abs(by_m), 0.0)
    moved = replace(face_pieces(own.move(by_m * own.surface.along), scene), slack_m=left)
    result, stays = list(stances[:made]), True
    for stance in stances[made:]:
        stays = stays and own.is_kept_in(stance)
        contacts = tuple(moved if stays and contact.patch == patch else contact for contact in stance.contacts)
        result.append(replace(stance, contacts=contacts))
    return tuple(result)


def take_recorded_places(
    stances: Sequence[ContactStance], scene: Scene, recorded: Motion
) -> tuple[tuple[ContactStance, ...], tuple[str, ...]]:
    """Return stances with the places that a record chose within their slack, and a sentence for each beyond it."""
    made, problems = tuple(stances), list[str]()
    for k, patch in list_movable(stances):
        contact = next(contact for contact in made[k].contacts if contact.patch == patch)
        later = {stance.name for stance in stances[k + 1 :]} | {FINISH}
        planted = find_recorded(recorded, contact.planted.link, later)
        if planted is None or planted.sole.shape != contact.planted.sole.shape:
            continue  # phases or contacts are not the request's, which is said elsewhere
        by = float(contact.surface.along @ (planted.points - contact.points).mean(axis=0))
        words = f"{patch} in '{stances[k].name}'"
        if not abs(by) <= contact.slack_m + SAME_PLACE_M:
            problems.append(
                f"{words} is {abs(by):.3f} m along {contact.surface.name} from its place; "
                f"the request leaves {contact.slack_m:g} m of slack"
            )
            continue
        made = move_place(made, k, patch, by, scene)
        moved = next(contact for contact in made[k].contacts if contact.patch == patch)
        off = find_off(moved, scene, words)
        problems += [off] if off else []
    return made, tuple(problems)


def find_recorded(recorded: Motion, link: str, stances: set[str]) -> PlantedContact | None:
    """Return a link's contact in the first recorded phase that leads to one of some stances; None if it has none."""
    for phase in recorded.phases:
        if phase.name.split(": ")[0] in stances:
            return next((contact for contact in phase.contacts if contact.link == link), None)
    return None
