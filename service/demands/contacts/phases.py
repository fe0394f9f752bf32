"""Phases that lead from stance to stance: weight shifted over what stays, links lifted, moved and set down."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from service.demands.contacts.stances import ContactChange, ContactStance, StanceContact, make_contact_allowances
from service.demands.phase import FrameMotion, TaskPhase

FINISH = "finish"
LINE_M = 0.02  # of a link that leaves a surface or arrives there, straight along the surface's normal
LINE_TOLERANCE_M, LINE_TILT_RAD = 0.012, float(np.deg2rad(7.0))  # of a link on its line along the normal


def list_contact_phases(stances: Sequence[ContactStance], *, has_finish: bool) -> tuple[TaskPhase, ...]:
    """Return the phases that lead from the first stance through all others, and perhaps to a posture on the last."""
    phases = [phase for before, after in pairwise(stances) for phase in list_change_phases(before, after)]
    if has_finish:
        phases.append(_stand(FINISH, stances[-1].contacts))
    return tuple(phases)


def list_change_phases(before: ContactStance, after: ContactStance) -> tuple[TaskPhase, ...]:
    """Return the phases from one stance to the next.

    ``shift`` moves the body over what stays, ``lift`` and ``land`` move what leaves or arrives straight along its
    normal, ``swing`` is free, and ``move`` leads to another pose where both stances have the same contacts.
    """
    change, name = ContactChange.between(before, after), after.name
    kept = change.kept
    phases: list[TaskPhase] = []
    if not change.leaving and not change.arriving:
        phases.append(_stand(f"{name}: move", kept))
    if change.leaving:
        phases.append(_stand(f"{name}: shift", before.contacts))
        phases.append(_stand(f"{name}: lift", kept, leaving=change.leaving))
    if change.arriving:
        phases.append(_stand(f"{name}: swing", kept))
        phases.append(_stand(f"{name}: land", kept, arriving=change.arriving))
    return tuple(phases)


def _stand(
    name: str,
    contacts: tuple[StanceContact, ...],
    leaving: tuple[StanceContact, ...] = (),
    arriving: tuple[StanceContact, ...] = (),
) -> TaskPhase:
    """Return a phase on contacts, in which others leave or arrive; links on their lines may touch as if in contact."""
    frames = (
        *(_follow_normal(contact, leaves=True) for contact in leaving),
        *(_follow_normal(contact, leaves=False) for contact in arriving),
    )
    touches = make_contact_allowances((*contacts, *leaving, *arriving))
    return TaskPhase(name, frames=frames, touches=touches, contacts=contacts)


def _follow_normal(contact: StanceContact, *, leaves: bool) -> FrameMotion:
    """Return the line of a link that leaves its place, or arrives there; one with few points may turn about them."""
    planted = contact.planted
    pose, keeps_line = planted.pose_world_link, len(planted.sole) >= 3
    return FrameMotion(
        planted.link,
        None,
        pose[:3, 3],
        pose[:3, 2],
        offset=LINE_M * contact.surface.normal,
        leaves=leaves,
        rotation=pose[:3, :3],
        tolerance_m=LINE_TOLERANCE_M,
        tilt_rad=LINE_TILT_RAD if keeps_line else np.pi,
        keeps_line=keeps_line,
        point=planted.sole.mean(axis=0),
    )
