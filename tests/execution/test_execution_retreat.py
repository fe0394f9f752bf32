"""Where a robot can go back to with its hands and feet as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.execution.reference import ReferencePhase, find_retreats
from service.verify import Carrier, HandLoad, Phase, PlantedContact

LOAD = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([40.0, 0.0, 0.0]))
FEET = tuple(PlantedContact(link, np.eye(4), np.zeros((4, 3))) for link in ("l_foot", "r_foot"))


def retreats_of(*phases: Phase, passes: tuple[int, ...] = ()) -> list[float | None]:
    spans = [
        ReferencePhase(phase.name, float(k), k + 1.0, phase.contacts, (), k not in passes)
        for k, phase in enumerate(phases)
    ]
    return [own.retreat_s for own in find_retreats(phases, spans)]


def phase(*contacts: PlantedContact, holds: str | None = None, loads: tuple[HandLoad, ...] = ()) -> Phase:
    carriers = (Carrier("cup", holds),)
    return Phase("act", 0.0, 1.0, contacts or FEET, loads=loads, carriers=carriers)


def test_before_anything_is_pressed_the_way_back_leads_to_the_start() -> None:
    assert retreats_of(phase(), phase(), phase(loads=(LOAD,))) == [0.0, 0.0, None]


def test_after_a_hand_has_pressed_it_leads_to_the_first_rest_off_what_it_pressed() -> None:
    assert retreats_of(phase(), phase(loads=(LOAD,)), phase(), phase(), phase()) == [0.0, None, None, 3.0, 3.0]
    assert retreats_of(phase(loads=(LOAD,)), phase(), phase(), phase(), passes=(1,)) == [None, None, None, 3.0]


def test_a_grasp_or_a_step_is_not_undone() -> None:
    held, left = phase(holds="l_hand"), (FEET[0],)
    assert retreats_of(phase(), held, held, phase(), phase()) == [0.0, None, 2.0, None, 4.0]
    moved = np.eye(4)
    moved[0, 3] = 0.2
    ahead = (FEET[0], replace(FEET[1], pose_world_link=moved))
    assert retreats_of(phase(), phase(*left), phase(*ahead), phase(*ahead)) == [0.0, None, None, 3.0]
