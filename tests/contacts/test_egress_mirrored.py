"""Phases mirrored for the other side of a vehicle: the same poses in a mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from egress_car import car, phases
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.kinematics import KinematicsEngine, locate_links
from service.demands.egress.mirrored_phases import mirror_phases, swap_sides
from service.request.tasks.contacts import PostureRequest
from service.start.configuration import make_posture

MIRROR = np.diag([1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("right foot out", "left foot out"),
        ("l_arm_shz", "r_arm_shz"),
        ("foot_left", "foot_right"),
        ("left_wrist", "right_wrist"),
        ("hip", "hip"),
        ("bar_back", "bar_back"),
        ("pelvis", "pelvis"),
        ("upright", "upright"),
    ],
)
def test_names_change_sides_only_where_they_name_one(name, other):
    assert swap_sides(name) == other
    assert swap_sides(other) == name


def test_phases_mirrored_twice_are_the_same():
    robot, _ = car()
    assert mirror_phases(robot, mirror_phases(robot, phases())) == phases()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_links_of_a_mirrored_posture_are_where_a_mirror_shows_them(seed):
    robot, _ = car()
    q = np.random.default_rng(seed).uniform(-0.5, 0.5, robot.n)
    joints = dict(zip(robot.joint_names[6:], q[6:].tolist(), strict=True))
    posture = PostureRequest((q[0], q[1], q[2], *q[3:6].tolist()), joints)
    phase = replace(phases()[0], postures=(posture,))
    (mirrored,) = mirror_phases(robot, [phase])
    here, there = (make_posture(robot, one.postures[0], "postures") for one in (phase, mirrored))
    links = ("r_foot", "r_lleg", "r_hand", "r_lfarm", "utorso", "pelvis", "head")
    engine = KinematicsEngine(robot)
    seen, counterparts = (
        locate_links(engine, here, links),
        locate_links(engine, there, [swap_sides(link) for link in links]),
    )
    for link in links:
        place, other = seen[link][:3, 3], counterparts[swap_sides(link)][:3, 3]
        np.testing.assert_allclose(other, MIRROR @ place, atol=2e-3, err_msg=link)
