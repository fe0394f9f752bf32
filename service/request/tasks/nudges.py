"""Keys that nudge a hand, both hands or the neck: each is a step of ``task.steps``, as fast as the robot may move.

The keys are those of the operator's console: arrows, i and o translate in the world; e, d, s, f, w, r turn a hand about
its own axes, as capitals about those of the world; q and a turn the neck.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from service.errors import RequestError, would_do
from service.request.fields import Point
from service.request.tasks.hand_steps import FreeAxis, HandChoice, OtherHand

NUDGE_M, NUDGE_RAD = 0.01, 0.02
# Direction by key, in the world.
TRANSLATIONS: Mapping[str, Point] = MappingProxyType(
    {
        "Up": (0.0, 0.0, 1.0),
        "Down": (0.0, 0.0, -1.0),
        "Left": (0.0, 1.0, 0.0),
        "Right": (0.0, -1.0, 0.0),
        "i": (-1.0, 0.0, 0.0),
        "o": (1.0, 0.0, 0.0),
    }
)
# Axis by key, about which the hand turns by the right hand: pitch up and down, yaw left and right, roll left and right.
ROTATIONS: Mapping[str, Point] = MappingProxyType(
    {
        "e": (0.0, -1.0, 0.0),
        "d": (0.0, 1.0, 0.0),
        "s": (0.0, 0.0, 1.0),
        "f": (0.0, 0.0, -1.0),
        "w": (-1.0, 0.0, 0.0),
        "r": (1.0, 0.0, 0.0),
    }
)
# Sign by key of a neck that nods about its y axis: up, down.
NECK: Mapping[str, float] = MappingProxyType({"q": -1.0, "a": 1.0})
KEYS = (*TRANSLATIONS, *ROTATIONS, *(key.upper() for key in ROTATIONS), *NECK)


@dataclass(frozen=True)
class Touch:
    """What a hand may touch while it is nudged.

    Attributes:
        pieces: of the scene.
        force_n: at which the motion stops [N].
    """

    pieces: tuple[str, ...]
    force_n: float


@dataclass(frozen=True)
class NudgeSettings:
    """What a key moves, and what the rest does meanwhile.

    Attributes:
        hand: that moves.
        other_hand: whether the hand that does not move keeps its pose, or the joints of its arm are locked.
        free_axis: axis of the hand about which it may turn on its way.
        middle: point between both hands, about which both turn [m]; needed to turn both.
        neck: joint of the neck and its position [rad]; needed for the keys of the neck.
        duration_s: of the nudge; the shortest within the robot's limits by default.
        touch: what the hand may touch; None for nothing.
    """

    hand: HandChoice = "right"
    other_hand: OtherHand = "keep"
    free_axis: FreeAxis = "none"
    middle: Point | None = None
    neck: tuple[str, float] | None = None
    duration_s: float | None = None
    touch: Touch | None = None


def make_nudge(key: str, settings: NudgeSettings) -> dict[str, Any]:
    """Return the step of a key, as data of ``task.steps``.

    Raises:
        RequestError: there is no such key, or a setting that it needs is missing.
    """
    if settings.touch is not None:
        return _make_touch(key, settings, settings.touch)
    if key in TRANSLATIONS:
        shift = {"translation": [NUDGE_M * way for way in TRANSLATIONS[key]]}
        return {"move": {**_list_fields(settings), "by": shift, "along": "line"}}
    if key in NECK:
        if settings.neck is None:
            raise RequestError(f"key {key}: turns the neck; expected its joint and position in neck")
        joint, position = settings.neck
        joints = {joint: position + NUDGE_RAD * NECK[key]}
        return {"move": {"joints": joints, "along": "joint_cubic", **_list_duration(settings)}}
    if key.lower() not in ROTATIONS:
        raise RequestError(f"key: there is no {key!r}; expected {would_do(key, KEYS)}")
    axis = ROTATIONS[key.lower()]
    if settings.hand == "both":
        if settings.middle is None:
            raise RequestError(f"key {key}: turns both hands about the point between them; expected it in middle")
        turn: dict[str, Any] = {
            "axis": list(axis),
            "centre": list(settings.middle),
            "rotation_deg": math.degrees(NUDGE_RAD),
        }
        return {"screw": {**_list_fields(settings), **turn}}
    axes = "world" if key.isupper() else "hand"
    turned: dict[str, Any] = {"rotation_deg": [math.degrees(NUDGE_RAD) * part for part in axis], "axes": axes}
    return {"move": {**_list_fields(settings), "by": turned, "along": "line"}}


def _make_touch(key: str, settings: NudgeSettings, touch: Touch) -> dict[str, Any]:
    """Return the step of a key that may end at a contact: a guarded move of one hand along the key's direction.

    Raises:
        RequestError: the key does not translate, or both hands are nudged.
    """
    if key not in TRANSLATIONS:
        raise RequestError(f"key {key}: touches nothing; expected {', '.join(TRANSLATIONS)}, or no touch")
    if settings.hand == "both":
        raise RequestError(f"key {key}: one hand touches at a time; expected hand left or right")
    kept = {"hand": settings.hand, "other_hand": settings.other_hand, "free_axis": settings.free_axis}
    window = {"direction": list(TRANSLATIONS[key]), "window_m": [0.0, NUDGE_M]}
    return {"touch": {**kept, **window, "force_n": touch.force_n, "pieces": list(touch.pieces)}}


def _list_fields(settings: NudgeSettings) -> dict[str, Any]:
    return {
        "hand": settings.hand,
        "other_hand": settings.other_hand,
        "free_axis": settings.free_axis,
        **_list_duration(settings),
    }


def _list_duration(settings: NudgeSettings) -> dict[str, float]:
    return {} if settings.duration_s is None else {"duration_s": settings.duration_s}
