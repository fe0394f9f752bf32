"""Plan the phases in which a hand pushes a part, in a model that has all parts of the steps."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotError
from costs.static_region import StaticRegionError
from service.body.phases import PhaseSolver
from service.body.task_plan import PlannedPhase
from service.demands.mechanism.phases import make_mechanism_phases
from service.demands.mechanism.settling import keep_aside, settle_handle
from service.demands.steps.extent import NamedStep
from service.demands.steps.moved import MovedParts
from service.errors import RequestError
from service.tasks.mechanism.plan import (
    check_hold,
    choose_hands,
    explain_hold,
    find_blocked_move,
    list_clearances,
    make_mechanism_hints,
)
from service.tasks.sequence import PhaseSequence, add_mechanism
from service.tasks.steps.solve import Tried


def plan_part(
    plain: PhaseSolver,
    solver: PhaseSolver,
    parts: MovedParts,
    named: NamedStep,
    at: Float[np.ndarray, "n"],
    values: Float[np.ndarray, "k"],
    busy: Set[str],
) -> tuple[list[PlannedPhase], Tried | None]:
    """Return the phases of a hand that pushes a part, and what was not solved.

    Args:
        plain: solver of the robot without parts.
        solver: of the robot with all parts.
        parts: of all steps.
        named: the step.
        at: (n,) configuration at its beginning, with all parts.
        values: (k,) of the joints of all parts there.
        busy: frames of hands that hold an object.

    Raises:
        RequestError: the robot has no such hand, or it does not touch the part.
    """
    given, mechanism = parts.parts[named.index], parts.mechanism
    assert mechanism is not None
    n = plain.body.robot.n
    own = add_mechanism(replace(plain, body=replace(plain.body, nominal=at[:n])), given.mechanism)
    try:
        chosen = choose_hands(own.body, given)
        hands = tuple(hand for hand in chosen if hand.tool not in busy)
        if not hands:
            sides = " and ".join(hand.side for hand in chosen)
            raise RequestError(f"task.mechanism.hand: the {sides} hand holds an object; expected a hand that is free")
        check_hold(own, hands, given)
    except (RequestError, RobotError) as error:
        raise RequestError(str(error).replace("task.mechanism", f"task.steps[{named.index}]")) from None
    blocked = find_blocked_move(own.body, given)
    if blocked is not None:
        return [], Tried(named.name, blocked.obstacle)
    refusals = [explain_hold(own, given, hand) for hand in hands]
    if all(refusals):
        return [], Tried(named.name, (str(refusals[0]),))
    best: tuple[list[PlannedPhase], Tried | None] | None = None
    friction = solver.hand_friction
    for hand in [hand for hand, refusal in zip(hands, refusals, strict=True) if refusal is None]:
        settled = settle_handle(given, own.body.robot, hand, friction)
        specs = make_mechanism_phases(settled, hand)
        specs = keep_aside(specs, own.body.robot, given.mechanism, friction)
        widened = parts.widen(specs, named.index, named.name, values)
        free = replace(solver, overrides=(*solver.overrides, *list_clearances((hand,), given)))
        try:
            phases, stuck = PhaseSequence.of(free, mechanism, widened, hints=make_mechanism_hints(None)).plan(at)
        except StaticRegionError as error:
            words = f"the ground does not hold the robot under the load ({error})"
            best = best or ([], Tried(named.name, (words,)))
            continue
        if stuck is None:
            return list(phases), None
        if best is None or len(phases) > len(best[0]):
            best = list(phases), Tried(stuck.step, (), stuck.best)
    assert best is not None
    return best
