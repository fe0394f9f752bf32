"""Refusal of moves whose object would move by itself where no hand holds it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from service.demands.moved_object.loads import MovedObject, UnheldJoint
from service.errors import RequestError

Values = Float[np.ndarray, "k"]
FIELD = "task.mechanism"


def check_rest(
    moved: MovedObject,
    moves: Sequence[tuple[str, Values, Values]],
    list_carriers: Callable[[str], tuple[str, ...]],
    handled: str,
    *,
    stays: bool,
) -> None:
    """Refuse an object that does not stay where it is before the hand comes, beside its hold, or after it has left.

    Args:
        moved: the object, with the limits that its loads are made for.
        moves: per move, the joint that moves, and the values of all joints before and after it.
        list_carriers: returns a joint and the joints that carry it.
        handled: the joint whose link the hand holds.
        stays: whether the hand stays at the end.

    Raises:
        RequestError: one line with the joint, what pulls it, and what holds it.
    """
    unheld = moved.find_unheld(moved.start, moved.start)
    if unheld is not None:
        words = "expected a start where it rests, friction, a stop or a latch"
        at = _show_value(moved, unheld.joint, moved.start)
        raise RequestError(
            f"{FIELD}: {unheld.joint} does not rest at its start ({at}): {_explain(moved, unheld)}; {words}"
        )
    carriers = list_carriers(handled)
    for k, (moving, first, last) in enumerate(moves):
        above = list_carriers(moving)[1:]
        unheld = moved.find_unheld(first, last, above)
        if unheld is not None:
            raise RequestError(
                f"{FIELD}.joints.{unheld.joint}: {unheld.cause} pulls while the hand moves {moving} below it with "
                f"{_show_force(moved, unheld.joint, unheld.pull)}, {_name_hold(moved, unheld)}; expected no spring or "
                f"weight, more friction, or {unheld.joint} moved after {moving}"
            )
        beside = [joint.name for joint in moved.joints if joint.name not in (*carriers, moving)]
        unheld = moved.find_unheld(first, last, beside)
        if unheld is not None:
            raise RequestError(
                f"{FIELD}.moves[{k}]: nothing holds {unheld.joint} while the hand moves {moving}: "
                f"{_explain(moved, unheld)}; expected friction or a latch"
            )
    if stays or not moves:
        return
    values = moves[-1][2]
    unheld = moved.find_unheld(values, values)
    if unheld is not None:
        at = _show_value(moved, unheld.joint, values)
        raise RequestError(
            f"{FIELD}: {unheld.joint} does not rest where the hand lets go ({at}): {_explain(moved, unheld)}; expected "
            f"{FIELD}.stays: true, friction, a latch, or a last move to where it rests"
        )
    loose = moved.find_loose(values, [joint for joint in carriers if joint != moves[-1][0]])
    if loose is not None:
        raise RequestError(
            f"{FIELD}.joints.{loose}.friction: the hand presses on {loose} while it moves {moves[-1][0]}, and nothing "
            f"brings {loose} to rest once the hand has gone; expected its friction, a latch, or {FIELD}.stays: true"
        )


def _explain(moved: MovedObject, unheld: UnheldJoint) -> str:
    pull = _show_force(moved, unheld.joint, unheld.pull)
    verb = "turns" if _is_turning(moved, unheld.joint) else "moves"
    return f"{unheld.cause} {verb} it with {pull}, {_name_hold(moved, unheld)}"


def _name_hold(moved: MovedObject, unheld: UnheldJoint) -> str:
    spring = moved.springs.get(unheld.joint)
    has_spring = spring is not None and spring.preload > 0.0 and "spring" not in unheld.cause
    return f"its friction {'and spring hold' if has_spring else 'holds'} {unheld.held:.3g}"


def _show_force(moved: MovedObject, joint: str, force: float) -> str:
    return f"{abs(force):.3g} {'N m' if _is_turning(moved, joint) else 'N'}"


def _show_value(moved: MovedObject, joint: str, values: Values) -> str:
    value = float(values[[known.name for known in moved.joints].index(joint)])
    return f"{np.rad2deg(value):.3g} deg" if _is_turning(moved, joint) else f"{value:.3g} m"


def _is_turning(moved: MovedObject, joint: str) -> bool:
    return next(known.kind for known in moved.joints if known.name == joint) == "revolute"
