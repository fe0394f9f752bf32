"""Handle of a given mechanism as a hand best holds it: touching, its rod leant so that its side faces the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from costs.robot import Mechanism, RobotModel
from service.demands.hands import Hand
from service.demands.holds.leaving import LET_GO, SET_ON
from service.demands.holds.pushes import NominalPush, find_nominal_pushes, find_side
from service.demands.mechanism.given import GivenMechanism
from service.demands.mechanism.phases import make_mechanism_phases
from service.demands.phase import TaskPhase
from service.verify import LEAST_APART_M, measure_excess

SETTLED_GAP, SETTLED_DIGITS = 5e-4, 6  # between a hand and what it holds, and decimals of its place [m]
SIDE_GAP = -1e-3  # of the side of a peg, which leaves the face by some tenths of a millimetre as its lean changes [m]
ENOUGH_ROOM = float(np.deg2rad(12.0))  # of the angles that friction permits: a rod is leant no further for more
LEAST_TILT = float(np.deg2rad(8.0))  # of a leant rod, for the pose of the robot
LEAN_STEP = float(np.deg2rad(4.0))
LAST_SHARE = 0.2  # of a line to the handle, for the hand that sets on where there is no room beside the face


def settle_handle(
    given: GivenMechanism, robot: RobotModel, hand: Hand, friction: tuple[float, float]
) -> GivenMechanism:
    """Return the mechanism with the handle as the hand best holds it.

    A rod whose side presses beside the way is leant, as far as the request permits, until friction permits the rest.
    Its place is moved along the contact's normal until the hand touches: one in a request is off by some
    millimetres, by which the mechanism would lag behind the hand.

    Args:
        robot: augmented by the mechanism.
        hand: at the handle.
        friction: least and largest coefficient.
    """
    found = _list_pushes(given, robot, hand, friction)
    best = _touch(given, found)
    excess = _measure_worst(_list_pushes(best, robot, hand, friction))
    for leant in _list_leant(given, hand, found) if excess > -ENOUGH_ROOM else ():
        touching = _touch(leant, _list_pushes(leant, robot, hand, friction))
        left = _measure_worst(_list_pushes(touching, robot, hand, friction))
        if left < excess:
            best, excess = touching, left
        if excess <= -ENOUGH_ROOM:
            break
    return best


def keep_aside(
    specs: Sequence[TaskPhase], robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]
) -> tuple[TaskPhase, ...]:
    """Return phases whose lines lead to the handle, and away from it, beside the face that the hand presses.

    A rod that slides along a face drags it along: a hand that sets on or lets go first moves straight between the face
    and a place beside it.
    """
    moving = [k for k, spec in enumerate(specs) if spec.moving]
    sides = [find_side(specs[k], robot, mechanism, friction) for k in (moving[0], moving[-1])]
    sets_on = any(spec.name == SET_ON for spec in specs[: moving[0]])
    kept, is_off = list[TaskPhase](), False
    for k, spec in enumerate(specs):
        hand = spec.hand
        if hand is None:
            kept.append(spec)
            continue
        if hand.offset is not None:
            side = sides[0] if k < moving[0] else sides[1]
            if k < moving[0] and sets_on:
                beside = side if side.any() else LAST_SHARE * hand.offset
                onto = spec.name == SET_ON
                hand = replace(hand, offset=beside) if onto else replace(hand, place=hand.place + beside)
            elif spec.name == LET_GO and side.any():
                hand, is_off = replace(hand, offset=side), True
            elif is_off:
                hand = replace(hand, place=hand.place + side)
            else:
                hand = replace(hand, offset=hand.offset + side)
        kept.append(spec.with_hand(hand))
    return tuple(kept)


def _touch(given: GivenMechanism, pushes: Sequence[NominalPush]) -> GivenMechanism:
    """Return the handle moved along the normal of its first contact until the hand touches."""
    settled = SETTLED_GAP if given.request.handle.tool == "stub" else SIDE_GAP
    for nominal in pushes:
        for contact, meeting in zip(nominal.push.contacts, nominal.met, strict=True):
            if contact.link == given.handle.link and meeting.apart >= LEAST_APART_M:
                shift = np.round((meeting.gap - settled) * meeting.normal, SETTLED_DIGITS)
                return replace(given, handle=replace(given.handle, place=given.handle.place + shift))
    return given


def _list_leant(given: GivenMechanism, hand: Hand, found: Sequence[NominalPush]) -> Iterator[GivenMechanism]:
    """Yield handles whose rod leans, further and further, towards square to the way of the hardest push.

    What is left of the permitted lean stays the hand's.  Its line leans with it, so that the rod comes along itself.
    """
    handle = given.handle
    pushes = [
        nominal for nominal in found
        if len(nominal.met) == 1 and nominal.push.contacts[0].link == handle.link
    ]  # fmt: skip
    if given.request.handle.tool == "tip" or hand.closed or not pushes:
        return
    way = max(pushes, key=lambda nominal: measure_excess(nominal.push, nominal.met)).met[0].way
    along = float(way @ handle.axis)
    turn = np.cross(handle.axis, -np.sign(along) * way)
    size = float(np.linalg.norm(turn))
    if size < 1e-9:
        return
    most = min(float(np.arcsin(min(abs(along), 1.0))), handle.tilt - LEAST_TILT)
    for lean in np.arange(LEAN_STEP, most + LEAN_STEP, LEAN_STEP).clip(max=most):
        rotation = pin.exp3(lean * turn / size)
        leant = replace(
            handle, axis=rotation @ handle.axis, approach=rotation @ handle.approach, tilt=handle.tilt - float(lean)
        )
        yield replace(given, handle=leant)


def _measure_worst(pushes: Sequence[NominalPush]) -> float:
    """Return the largest excess of all pushes [rad]."""
    return max((measure_excess(nominal.push, nominal.met) for nominal in pushes), default=-np.inf)


def _list_pushes(
    given: GivenMechanism, robot: RobotModel, hand: Hand, friction: tuple[float, float]
) -> list[NominalPush]:
    """Return the pushes of all phases at the poses that the hand aims at."""
    specs = make_mechanism_phases(given, hand)
    return [push for spec in specs for push in find_nominal_pushes(spec, robot, given.mechanism, friction)]
