"""Regions, sets of goals, places on the way: from request to replayed certificate, and what is refused at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared_plans import write_undrawn
from stranger import check_folder
from tiny_robots import Segment, chain_urdf

from costs.kinematics import KinematicsEngine, locate_links
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.request.region import RegionRequest, find_gap
from service.request.schema import PlanRequest
from service.result.result import PlanResult
from service.wire.requests import request_from_message, request_to_message

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
ARM = tuple(
    Segment(axis, (0.0 if k == 0 else 0.3, 0.0, 0.0), (0.3, 0.06, 0.06)) for k, axis in enumerate((Z, Y, Y, Z, Y))
)
POST = {"name": "post", "type": "box", "size": [0.08, 0.08, 2.0], "position": [1.2, 0.0, 0.0]}
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


@pytest.fixture(name="arm", scope="module")
def _arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(chain_urdf(ARM))
    return path


def ask(arm: Path, goal: dict[str, Any], *keep: dict[str, Any], start: float = -0.6) -> PlanRequest:
    """The arm beside a post that stands in front of it."""
    joints = {"joint1": start, "joint2": 0.4, "joint3": -0.8}
    data = {"robot": {"urdf": str(arm)}, "start": {"joints": joints}, "scene": {"obstacles": [POST]}}
    return parse_request({**data, "goal": goal, "keep": list(keep), "options": {"timed": False}})


def solve(request: PlanRequest) -> PlanResult:
    """The certified result."""
    result = plan(request)
    assert result.verdict.value == "CERTIFIED", result.explanation
    return result


def ends(result: PlanResult) -> np.ndarray:
    """``pose_world_tip`` at the end."""
    return locate_links(KinematicsEngine(result.robot), result.positions[-1], ["tip"])["tip"]


def test_a_motion_in_regions_passes_a_place_and_ends_at_the_nearest_goal(arm: Path, tmp_path: Path) -> None:
    far = {"poses": [{"link": "tip", "position": [9.0, 0.0, 0.0]}]}
    half_space = {"poses": [{"link": "tip", "region": {"y_min_m": 0.25, "z_max_m": 0.9}}]}
    via = {"poses": [{"link": "tip", "position": [0.9, -0.1, 0.5], "position_tolerance_m": 0.3}]}
    goal = {"any_of": [far, {"joints": {"joint1": 1.9}}, half_space], "via": [via]}
    band = {"link": "tip", "position": [0.0, 0.0, 0.0], "quaternion_wxyz": UPRIGHT, "rotation_tolerance_deg": 180.0}
    request = ask(arm, goal, {**band, "region": {"z_min_m": -0.3, "radius_m": 1.6}, "until": 0.9})
    assert request_from_message(request_to_message(request)) == request
    result = solve(request)
    place = ends(result)[:3, 3]
    assert place[1] >= 0.25
    assert place[2] <= 0.9
    names = {check.name for check in result.certificate.checks} if result.certificate is not None else set()
    assert {"region.reach.tip.world.y", "region.reach.tip.world.0-0.9.radius", "target.reach.tip"} <= names
    tips = [locate_links(KinematicsEngine(result.robot), q, ["tip"])["tip"][:3, 3] for q in result.positions]
    assert min(np.linalg.norm(tip - [0.9, -0.1, 0.5]) for tip in tips) <= 0.3
    speeds = np.linalg.norm(np.diff(result.positions, axis=0), axis=1)
    assert speeds[1:-1].min() > 0.0  # it does not stop on the way
    folder = write_undrawn(result, tmp_path / "out")
    report = verify_result(folder)
    assert report["verdict"] == "CERTIFIED"
    code, said = check_folder(folder)
    assert code == 0, said


@pytest.mark.parametrize(
    "pose",
    [
        {
            "position": [1.0, 0.4, 0.3],
            "position_tolerance_m": 0.05,
            "look_at": [1.5, 0.9, 0.0],
            "rotation_tolerance_deg": 5,
        },
        {"position": [0.9, 0.0, 0.2], "relative_to": "link1", "position_tolerance_m": 0.02},
        {
            "position": [1.0, 0.5, 0.2],
            "quaternion_wxyz": UPRIGHT,
            "region": {"x_min_m": -0.1, "x_max_m": 0.1, "y_min_m": -0.1, "about_y_deg": 20.0, "about_z_deg": 179.0},
        },
    ],
)
def test_a_pose_by_sight_between_links_or_by_axis_is_reached(arm: Path, pose: dict[str, Any]) -> None:
    result = solve(ask(arm, {"poses": [{"link": "tip", **pose}]}))
    assert result.certificate is not None
    assert any(check.name.startswith("region.reach.tip.") for check in result.certificate.checks)


@pytest.mark.parametrize(
    ("goal", "keep", "expected"),
    [
        ({"any_of": []}, None, "exactly one of joints, poses, posture, any_of is needed"),
        ({"poses": [{"link": "tip"}]}, None, "position is missing; only a region or look_at does without"),
        ({"poses": [{"link": "tip", "region": {}}]}, None, "the region limits nothing"),
        ({"poses": [{"link": "tip", "region": {"z_min_m": 3, "z_max_m": 1}}]}, None, "z_min_m 3 to z_max_m 1 is empty"),
        ({"poses": [{"link": "tip", "relative_to": "link5", "position": [0, 0, 0]}]}, None, "link5 moves with tip"),
        ({"joints": {"joint1": 0.1}}, {"region": {"z_max_m": -0.5}}, "at the start the place of tip"),
        ({"joints": {"joint1": 0.1}}, {"after": 0.7, "until": 0.7}, "leave no part of the motion"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_a_line(
    arm: Path, goal: dict[str, Any], keep: dict[str, Any] | None, expected: str
) -> None:
    with pytest.raises(RequestError) as caught:
        plan(ask(arm, goal, *([] if keep is None else [{"link": "tip", **keep}])))
    assert expected in str(caught.value)


bounds = st.tuples(*[st.none() | st.floats(-1.0, 1.0)] * 6).filter(
    lambda b: any(v is not None for v in b) and all(None in b[k : k + 2] or b[k] + 0.01 < b[k + 1] for k in (0, 2, 4))
)


@settings(max_examples=100, deadline=None)
@given(bounds, bounds)
def test_regions_have_a_gap_where_no_place_is_in_both(one: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    names = [f"{axis}_{end}_m" for axis in "xyz" for end in ("min", "max")]
    regions = [RegionRequest(**dict(zip(names, own, strict=True))) for own in (one, other)]
    free = [
        max(own[k] for own in (one, other, (-9.0,) * 6) if own[k] is not None)
        <= min(own[k + 1] for own in (one, other, (9.0,) * 6) if own[k + 1] is not None)
        for k in (0, 2, 4)
    ]
    gap = find_gap(*regions)
    assert (gap is None) == all(free)
    assert gap is None or not free["xyz".index(gap[0])]


def test_kept_regions_that_leave_no_place_are_refused_unless_they_hold_one_after_the_other(arm: Path) -> None:
    goal = {"joints": {"joint1": 0.1}}
    above, below = {"link": "tip", "region": {"z_min_m": 0.1}}, {"link": "tip", "region": {"z_max_m": -0.1}}
    with pytest.raises(RequestError, match=r"keep\[0\].region and keep\[1\].region leave no place for 'tip': z of at"):
        ask(arm, goal, {**above, "after": 0.3}, {**below, "until": 0.5})
    assert len(ask(arm, goal, {**above, "after": 0.6}, {**below, "after": 0.1, "until": 0.5}).keep) == 2


def test_goals_that_break_a_kept_region_are_refused_at_once(arm: Path) -> None:
    goal = {"joints": {f"joint{k}": value for k, value in enumerate((0.5, 0.4, -0.8, 0.0, 0.0), start=1)}}
    result = plan(ask(arm, goal, {"link": "tip", "region": {"about_z_deg": 20.0}}))
    assert result.verdict.value == "INFEASIBLE"
    assert "the goal leaves what keep demands" in result.explanation[0]
    below = {"poses": [{"link": "tip", "region": {"z_max_m": -0.2, "x_min_m": 0.5}}]}
    flat = {"link": "tip", "position": [0, 0, 0], "quaternion_wxyz": UPRIGHT, "rotation_tolerance_deg": 180.0}
    result = plan(ask(arm, below, {**flat, "region": {"z_min_m": 0.1}}))
    assert result.verdict.value == "INFEASIBLE"
    assert result.explanation == ("the goal of tip is 0.300 m outside of the region that keep demands of it",)


def test_a_region_beyond_the_arm_is_out_of_reach(arm: Path) -> None:
    for region in ({"z_min_m": 2.5}, {"x_max_m": -1.9, "radius_m": 3.0}):
        result = plan(ask(arm, {"poses": [{"link": "tip", "region": region}]}))
        assert result.verdict.value == "INFEASIBLE"
        assert "cannot reach its region" in result.explanation[0]


def test_of_several_goals_each_says_why_it_is_out_of_reach(arm: Path) -> None:
    far = [{"poses": [{"link": "tip", "position": [x, 0.0, 0.0]}]} for x in (4.0, 7.0)]
    result = plan(ask(arm, {"any_of": far}))
    assert result.verdict.value == "INFEASIBLE"
    assert [line.split(":")[0] for line in result.explanation] == ["goal.any_of[0]", "goal.any_of[1]"]
