"""A hand that leaves what it pressed, worked out by hand: what it may drag along, and how far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from service.verify import HandContact, HandPush, HeldJoint
from service.verify.forces.hand_balance import Meeting
from service.verify.forces.letting_go import MOST_DRAG_M, JointDrag

ALONG, AWAY = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class StraightPath:
    """A rod that leaves a face with normal -y at the origin, by a straight line: ``velocity`` [m per unit]."""

    velocity: np.ndarray

    def meet(self, s: float) -> tuple[Meeting, ...]:
        gap = float(s * self.velocity[1])
        return (Meeting(0.014 + gap, gap, -AWAY, -AWAY, ALONG[None], np.zeros(3)),)

    def place_cores(self, s: float) -> tuple[np.ndarray, ...]:
        return (s * self.velocity + np.array([[0.0, 0.009, 0.0], [0.0, 0.009, 0.05]]),)

    def bound_travel(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return 0.5 * np.linalg.norm(self.velocity) * (last - first)[None]


def make_drag(velocity: np.ndarray, low: float, high: float, force: float = 8.0) -> JointDrag:
    contact = HandContact("tool", "the rod", np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]), 0.009, "m/link", "m/body")
    push = HandPush("turn", 1.0, force, (contact,), (0.3, 0.6), (HeldJoint("slide", low, high),))
    return JointDrag(StraightPath(velocity), push, 0, 0.0)


@pytest.mark.parametrize(("bears", "is_possible"), [(4.7, True), (4.9, False)])
def test_a_joint_that_bears_the_friction_of_the_pressure_is_not_dragged(bears: float, is_possible: bool) -> None:
    """8 N along the normal, which drag with 0.6 of it."""
    assert make_drag(ALONG, -bears, bears).is_possible is is_possible


def test_only_the_sense_that_the_joint_does_not_bear_counts() -> None:
    """A stop against smaller values: a hand that leaves that way drags nothing."""
    for sense, most in ((1.0, 0.1), (-1.0, 0.0)):
        bound, at_first, at_last = make_drag(0.1 * sense * ALONG, -np.inf, 0.0).bound(np.zeros(1), np.ones(1))
        assert (at_first[0], at_last[0]) == pytest.approx((0.0, most))
        assert bound[0] >= at_last[0]


def test_a_hand_that_leaves_the_face_first_drags_nothing() -> None:
    s = np.linspace(0.0, 1.0, 201)
    slanted, straight = 0.1 * ALONG + 0.025 * AWAY, 0.1 * AWAY + 0.02 * ALONG
    for velocity, far in ((slanted, 0.04), (straight, 0.002)):  # along, until 10 mm away
        drag = make_drag(velocity, -1.0, 1.0)
        bound, at_first, _ = drag.bound(s[:-1], s[1:])
        assert at_first.max() == pytest.approx(far, abs=6e-4)
        assert far <= bound.max() <= far + 2e-3
        assert bool(bound.max() > MOST_DRAG_M) is (velocity is slanted)


def test_a_hand_that_leaves_straight_off_a_face_does_not_pull_it_along() -> None:
    """The held joint moves the face along its normal: a contact only pushes."""

    class SquarePath(StraightPath):
        def meet(self, s: float) -> tuple[Meeting, ...]:
            (met,) = super().meet(s)
            return (replace(met, held=AWAY[None]),)

    contact = HandContact("tool", "the rod", np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]), 0.009, "m/link", "m/body")
    push = HandPush("turn", 1.0, 8.0, (contact,), (0.3, 0.6), (HeldJoint("slide", -np.inf, 0.1),))
    assert not JointDrag(SquarePath(0.1 * AWAY), push, 0, 0.0).is_possible
    pushed = replace(push, held=(HeldJoint("slide", -0.1, np.inf),))
    into = JointDrag(SquarePath(-0.1 * AWAY), pushed, 0, 0.0)
    assert into.bound(np.zeros(1), np.ones(1))[2][0] == pytest.approx(0.1)
