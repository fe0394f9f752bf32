"""Contacts of hands at the waypoints, with normals, ways and friction as the verifier measures them, for the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from service.verify import (
    HandContact,
    HandPush,
    Meeting,
    Motion,
    Phase,
    PreparedMotion,
    PushPath,
    VerifySettings,
    find_pushed_body,
)

DIGITS = 5  # of places in metres and of unit vectors


def trace_hand_contacts(
    motion: Motion, samples: Float[np.ndarray, "S"], result: Mapping[str, Any]
) -> tuple[tuple[dict[str, Any], ...], ...]:
    """Return the contacts of the hands in each phase of a result, JSON-ready.

    An entry is a surface that presses a body.  Its rows are of the waypoints and ends of the phase: ``times`` [s, or
    path parameters of an untimed motion], ``points`` in the world [m], ``normals`` and ``ways`` in the world, and
    ``touches``.  ``check`` is the index of the check of its push in the result's checks, or None.

    Args:
        motion: the result's motion.
        samples: path parameters of its samples.
        result: a parsed ``result.json``.

    Raises:
        VerifyError: a push names a joint, link, body or frame that the motion does not have.
    """
    if not any(phase.pushes for phase in motion.phases):
        return tuple(() for _ in motion.phases)
    prepared = PreparedMotion(motion)
    times = np.asarray((result.get("trajectory") or {}).get("times") or samples, dtype=float)
    waypoints = samples[np.array([i for i in result.get("waypoints") or [] if 0 <= i < len(samples)], dtype=int)]
    traced = []
    for phase in motion.phases:
        inside = waypoints[(waypoints > phase.first) & (waypoints < phase.last)]
        s = np.unique([phase.first, *inside, phase.last])
        at = np.interp(s, samples, times)
        traced.append(
            tuple(entry for push in phase.pushes for entry in _trace_push(prepared, phase, push, s, at, result))
        )
    return tuple(traced)


def _trace_push(
    prepared: PreparedMotion,
    phase: Phase,
    push: HandPush,
    s: Float[np.ndarray, "W"],
    times: Float[np.ndarray, "W"],
    result: Mapping[str, Any],
) -> list[dict[str, Any]]:
    path = PushPath(prepared, push, VerifySettings().rounding)
    names = [check["name"] for check in result.get("checks") or []]
    name = f"hand_contact.{phase.name}.{push.joint}"
    rows = [path.meet(at) for at in s.tolist()]
    entries = []
    for column, contact in enumerate(push.contacts):
        meetings = [row[column] for row in rows]
        entries.append(
            {
                "joint": push.joint,
                "surface": contact.surface,
                "body": contact.body,
                "friction": list(push.friction),
                "force_n": push.force_n,
                "check": names.index(name) if name in names else None,
                "times": times.tolist(),
                "touches": [meeting.is_touching for meeting in meetings],
                **_turn_to_world(prepared, contact, meetings, s),
            }
        )
    return entries


def _turn_to_world(
    prepared: PreparedMotion, contact: HandContact, meetings: list[Meeting], s: Float[np.ndarray, "W"]
) -> dict[str, Any]:
    """Return points, normals and ways in the world."""
    placed, rows = prepared.at(s)
    rotation, translation = placed.relative(0, find_pushed_body(prepared.motion, contact).joint, rows)
    points, normals, ways = (
        np.einsum("wij,wj->wi", rotation, np.array([getattr(meeting, name) for meeting in meetings]))
        for name in ("point", "normal", "way")
    )
    return {
        "points": np.round(points + translation, DIGITS).tolist(),
        "normals": np.round(normals, DIGITS).tolist(),
        "ways": np.round(ways, DIGITS).tolist(),
    }
