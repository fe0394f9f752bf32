"""Corners between two straight ways that are rounded, so that a frame goes through them without a rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.guide import Guide
from service.demands.steps.phases import Led
from service.errors import RequestError
from service.request.tasks.hand_steps import MoveStep
from service.request.tasks.steps import StepRequest, StepsSection

STRAIGHT_RAD = float(np.deg2rad(0.5))  # least turn of a way that is a corner
SHARPEST_RAD = float(np.deg2rad(150.0))  # largest turn that is rounded: beyond it the arc has hardly a radius
SHARE = 0.45  # of each of both ways that a rounded corner of a path takes at most


def round_corner(
    start: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"],
    before: Float[np.ndarray, "3"],
    after: Float[np.ndarray, "3"],
    cut_m: float,
) -> Guide | None:
    """Return the arc from one line to another, tangent to both; None where the corner is too sharp.

    Args:
        start: where the arc begins, ``cut_m`` before the corner [m].
        rotation: of the frame, which it keeps.
        before, after: directions of the lines, of any length.
        cut_m: from the corner to both ends of the arc [m].
    """
    into, out = before / np.linalg.norm(before), after / np.linalg.norm(after)
    turn = find_turn(into, out)
    if turn < STRAIGHT_RAD:
        return Guide.line(start, rotation, 2.0 * cut_m * into)
    if turn > SHARPEST_RAD:
        return None
    inwards = out - (out @ into) * into
    inwards /= np.linalg.norm(inwards)
    radius = cut_m / np.tan(0.5 * turn)
    return Guide.screw(start, rotation, start + radius * inwards, np.cross(into, inwards), turn, turns=False)


def find_turn(before: Float[np.ndarray, "3"], after: Float[np.ndarray, "3"]) -> float:
    """Return the angle between two directions of any length [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))


def choose_cuts(places: Float[np.ndarray, "P 3"], blend_m: float) -> Float[np.ndarray, "P"]:
    """Return how far before each corner of a path it is left, 0 where the path rests or begins or ends [m]."""
    steps = np.diff(places, axis=0)
    lengths, cuts = np.linalg.norm(steps, axis=1), np.zeros(len(places))
    for k in range(1, len(places) - 1):
        if blend_m and find_turn(steps[k - 1], steps[k]) <= SHARPEST_RAD:
            cuts[k] = min(blend_m, SHARE * lengths[k - 1], SHARE * lengths[k])
    return cuts


def shorten_line(led: Led, entered_m: float, left_m: float) -> Led:
    """Return a frame on the part of a line between the rounded corners at its ends.

    Args:
        led: on the line, from the end of the corner before on.
        entered_m: by which the line begins after that corner, where its length counts from the corner [m].
        left_m: by which it ends before the corner after it [m].

    Raises:
        RequestError: the line is too short for its corners.
    """
    length = float(np.linalg.norm(led.guide.shift))
    rest = length - entered_m - left_m
    if rest <= 1e-3:
        raise RequestError(
            f"move: the line of {led.frame} is {1e3 * length:.0f} mm long, and its rounded corners take "
            f"{1e3 * (entered_m + left_m):.0f} mm; expected a smaller blend_m"
        )
    return replace(led, guide=replace(led.guide, shift=led.guide.shift * (rest / length)))


def list_blend_problems(section: StepsSection) -> Iterator[str]:
    """Yield a line per step with ``blend_m`` that does not lead on into another line of the same frames."""
    for k, step in enumerate(section.steps):
        if step.move is None or not step.move.blend_m:
            continue
        field, after = f"task.steps[{k}].move.blend_m", _find_next_line(section.steps, k)
        if after is None:
            yield f"{field}: the next step is no move along a line; the hand cannot go on into it without a rest"
        elif _list_frames(step.move) != _list_frames(after):
            yield f"{field}: the next step moves another hand or frame; expected the same"
        elif any(_turns(move) for move in (step.move, after)):
            yield f"{field}: a rounded corner keeps the orientation; expected no rotation_deg or quaternion_wxyz there"


def _find_next_line(steps: tuple[StepRequest, ...], index: int) -> MoveStep | None:
    after = steps[index + 1].move if index + 1 < len(steps) else None
    return after if after is not None and after.along == "line" else None


def _list_frames(move: MoveStep) -> tuple[object, ...]:
    return move.hand, move.frame, tuple(pose.link for pose in move.poses)


def _turns(move: MoveStep) -> bool:
    by_turn = move.by is not None and any(move.by.rotation_deg)
    return by_turn or any(pose.quaternion_wxyz is not None for pose in move.poses)
