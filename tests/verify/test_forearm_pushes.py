"""A forearm that pushes a leaf: the same contact as a hand's, found from the shapes and proven on the whole curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny_robots import Segment, chain

from costs.allowance import Allowance, BodyRef
from costs.curve import Curve
from costs.robot import Mechanism, MechanismJoint, with_mechanism
from costs.robot.shapes import box
from costs.scene import Scene
from service.demands.holds.pushes import add_pushes
from service.demands.phase import FrameMotion, TaskPhase
from service.verify import Basis, Check, HandContact, HandLoad, Motion, Phase, verify

UP = np.array([0.0, 0.0, 1.0])
FOREARM = chain((Segment((0.0, 0.0, 1.0)),))  # a box of 1 m along x that turns about z, 0.1 m thick
GAP = 5e-4
FRICTION = (0.3, 0.6)


def make_leaf(beyond: float) -> MechanismJoint:
    """A leaf on the same axis, before the forearm's side at y = 0.05 or behind the other one."""
    middle = np.array([0.6, beyond * (0.05 + GAP + 0.02), 0.0])
    bodies = {"leaf/face": middle + box(np.array([0.7, 0.04, 0.4]))}
    return MechanismJoint("hinge", "leaf", np.zeros(3), UP, bodies, lower=-2.0, upper=2.0)


def make_spec() -> TaskPhase:
    held = FrameMotion("link1", "leaf", np.zeros(3), UP, rotation=np.eye(3))
    touch = Allowance(BodyRef.of_link("link1"), BodyRef("mechanism", "leaf", "leaf/face"), 5e-3)
    load = HandLoad("link1", "leaf", np.array([0.6, 0.0, 0.0]), np.array([0.0, 25.0, 0.0]))
    return TaskPhase("push", np.zeros(1), np.array([0.5]), (held,), (touch,), loads=(load,))


def check(beyond: float, spec: TaskPhase, *, turned: float = 0.5) -> dict[str, Check]:
    """Certify that the forearm turns with the leaf, by half a radian."""
    robot = with_mechanism(FOREARM, (make_leaf(beyond),))
    curve = Curve(np.arange(2.0), np.array([[0.0, 0.0], [turned, 0.5]]), np.zeros((2, 2)))
    phase = Phase("push", 0.0, 1.0, allowances=spec.touches, pushes=spec.pushes)
    motion = Motion(robot, Scene(()), curve, None, (phase,), mechanism_links=frozenset({"leaf"}))
    return {found.name: found for found in verify(motion).checks}


def find_pushes(beyond: float) -> TaskPhase:
    joint = make_leaf(beyond)
    (spec,) = add_pushes([make_spec()], with_mechanism(FOREARM, (joint,)), Mechanism("door", (joint,)), FRICTION)
    return spec


def test_the_side_of_a_forearm_that_pushes_a_leaf_is_proven_inside_its_cone() -> None:
    spec = find_pushes(1.0)
    (push,) = spec.pushes
    assert (push.joint, push.sense, push.force_n) == ("hinge", 1.0, 25.0)
    assert [(each.frame, each.surface, each.body) for each in push.contacts] == [("link1", "the link1", "leaf/face")]
    checks = check(1.0, spec)
    for name in ("hand_touch.push.hinge", "hand_contact.push.hinge"):
        assert checks[name].ok
        assert checks[name].basis is Basis.PROOF
    assert "the link1 pushes leaf/face " in checks["hand_contact.push.hinge"].text


def test_a_forearm_behind_a_leaf_would_have_to_pull_it_and_one_that_lags_leaves_it() -> None:
    refused = check(-1.0, find_pushes(-1.0))["hand_contact.push.hinge"]
    assert not refused.ok
    assert "the link1 would have to pull leaf/face" in refused.text
    lagging = check(1.0, find_pushes(1.0), turned=0.45)["hand_touch.push.hinge"]
    assert not lagging.ok
    assert "mm off leaf/face" in lagging.text


def test_a_surface_that_the_forearm_does_not_have_is_refused() -> None:
    spec = find_pushes(1.0)
    (push,) = spec.pushes
    (contact,) = push.contacts
    wider: HandContact = replace(contact, core=2.0 * contact.core)
    with pytest.raises(Exception, match=r"stands .* out of its link.s shapes"):
        check(1.0, replace(spec, pushes=(replace(push, contacts=(wider,)),)))
