"""What a motion is in when it begins: pairs that its first phase allows to touch, told one by one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.verify.certificate import Basis, Check, Where
from service.verify.couples import Couples
from service.verify.motion import Motion, Phase
from service.verify.narrow import Narrow
from service.verify.settings import VerifySettings
from service.verify.timeline import time_of
from service.verify.track import Track

FLOOR_KIND = "floor"


def start_checks(track: Track, couples: Couples, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """One check for each pair that is in collision at the first pose, as its allowance lets it.

    Planted links that rest on the floor are not told.

    Args:
        track: the motion whose first pose is looked at.
        couples: its pairs.
        phase: the first one.
        settings: how deep a touch is a collision.
    """
    motion, s = track.motion, float(track.motion.curve.knots[0])
    placed, row = track.at(np.array([s]))
    narrow = Narrow()
    for couple in np.flatnonzero(~np.isnan(couples.allowed[:, 0])).tolist():
        if rests_on_floor(motion, couples, couple, phase):
            continue
        mover, holder = couples.solids[couples.mover[couple]], couples.solids[couples.holder[couple]]
        distances, _ = narrow.closest([mover.convex], *placed.relative(holder.joint, mover.joint, row), [holder.convex])
        distance = float(distances[0])
        if distance >= -settings.contact_tolerance_m:
            continue
        allowed = float(couples.allowed[couple, 0])
        names = couples.names(couple)
        text = (
            f"starts in collision: {names[0]} is {-1e3 * distance:.1f} mm inside {names[1]}, "
            f"which '{phase.name}' allows down to {1e3 * allowed:.1f} mm"
        )
        is_ok = distance >= -allowed - settings.contact_tolerance_m
        where = Where(s, time_of(motion.law, s), None, names)
        name = f"start.{names[0]}.{names[1]}"
        yield Check(name, is_ok, distance, -allowed, "m", text, where, Basis.SAMPLES)


def rests_on_floor(motion: Motion, couples: Couples, couple: int, phase: Phase) -> bool:
    """Whether a pair is a planted link and a floor."""
    mover, holder = couples.mover[couple], int(couples.holder[couple]) - couples.n_bodies
    planted = {contact.link for contact in phase.contacts}
    return holder >= 0 and couples.solids[mover].link in planted and motion.scene.pieces[holder].kind == FLOOR_KIND
