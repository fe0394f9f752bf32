"""Padding of links and obstacles: planned for, proven, and held against a record."""

from __future__ import annotations

import dataclasses

import pytest
from planar_arm import write_planar_arm

from service.demands import hold_to_request
from service.errors import RequestError
from service.planner import plan
from service.replay.rebuild import make_setup_demands
from service.request.file import parse_request
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.verify import NO_SWAY, verify


def pass_a_block(folder, **options):
    """A bent arm whose tip passes some centimetres from a block, in the middle of the motion."""
    urdf = write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0)
    size, position = [0.1, 0.1, 0.1], [0.68, 0.0, 0.0]
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {
                "floor": False,
                "obstacles": [{"name": "block", "type": "box", "size": size, "position": position}],
            },
            "start": {"joints": {"j0": -1.0, "j1": 0.6}},
            "goal": {"joints": {"j0": 0.2, "j1": 0.6, "j2": 0.0}},
            "options": options,
        }
    )


def measure_least(motion):
    """Least clearance of a motion from which nothing but what touches is refused [m]."""
    return verify(dataclasses.replace(motion, padding={}, sway=NO_SWAY)).min_clearance_m


def test_link_and_obstacle_add_their_padding_and_the_certificate_proves_the_sum(tmp_path):
    request = pass_a_block(tmp_path, padding={"block": 0.03, "l2": 0.05})
    plain = plan(pass_a_block(tmp_path))
    padded = plan(request)
    assert padded.verdict is Verdict.CERTIFIED, padded.explanation
    assert plain.certificate.min_clearance_m < 0.075
    assert padded.certificate.min_clearance_m >= 0.08 - 1e-6
    refused = verify(dataclasses.replace(plain.motion, padding=dict(request.options.padding)))
    assert any(check.name == "clearance" and not check.ok for check in refused.checks)
    held = hold_to_request(make_setup_demands(prepare(request)), plain.motion)
    assert "the record demands another padding than the request" in held.differences
    assert held.motion.padding == request.options.padding


def test_the_sway_of_a_base_comes_on_top_of_padding(tmp_path):
    padding = {"block": 0.03, "l2": 0.03}
    swaying = plan(pass_a_block(tmp_path, padding=padding, sway_m=0.03))
    assert swaying.verdict is Verdict.CERTIFIED, swaying.explanation
    assert measure_least(swaying.motion) >= 0.09 - 1e-6
    assert measure_least(plan(pass_a_block(tmp_path, padding=padding)).motion) < 0.09


def test_a_goal_inside_the_padding_is_not_certified(tmp_path):
    request = pass_a_block(tmp_path, padding={"block": 0.1}, starts=1)
    goal = dataclasses.replace(request.goal, joints={"j0": -0.4, "j1": 0.6, "j2": 0.0})
    result = plan(dataclasses.replace(request, goal=goal))
    assert result.verdict is not Verdict.CERTIFIED
    assert any("100 mm are demanded" in line for line in result.explanation), result.explanation


def test_padding_of_an_unknown_name_is_refused(tmp_path):
    with pytest.raises(RequestError, match=r"options.padding: 'blok' is no link with a shape, .*block"):
        prepare(pass_a_block(tmp_path, padding={"blok": 0.1}))
