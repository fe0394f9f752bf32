"""The verifier decides on every motion that does its whole request, whatever the optimiser says of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands import compare_pace
from service.planner import plan
from service.replay.whole import certify_whole
from service.request.file import parse_request
from service.result.attempt import Attempt
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.verify import Motion, Status, verify

LINK = 0.04  # edge of the sliding link [m]
WALL = 0.2


def slider(tmp_path, gap_m: float, **options):
    """Slide a box between two walls, with half of the gap free on each side."""
    urdf = tmp_path / "slider.urdf"
    urdf.write_text(
        '<robot name="slider"><link name="base"/><link name="box"><collision>'
        f'<geometry><box size="{LINK} {LINK} {LINK}"/></geometry></collision></link>'
        '<joint name="slide" type="prismatic"><parent link="base"/><child link="box"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="10"/></joint></robot>'
    )
    aside = 0.5 * (LINK + gap_m + WALL)
    walls = [
        {"name": name, "type": "box", "size": [0.1, WALL, 0.2], "position": [0.0, side * aside, 0.0]}
        for name, side in (("left", 1.0), ("right", -1.0))
    ]
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"obstacles": walls, "floor": False},
            "start": {"joints": {"slide": -0.5}},
            "goal": {"joints": {"slide": 0.5}},
            "options": {"timed": False, **options},
        }
    )


def test_a_gap_below_the_aims_of_the_optimiser_is_passed_with_a_certificate(tmp_path):
    # 1.5 mm on each side; the optimiser is content with 3 mm.
    result = plan(slider(tmp_path, 3e-3))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate.status is Status.CERTIFIED
    assert 0.0 < result.certificate.min_clearance_m <= 1.5e-3
    assert result.explanation == ()
    assert result.conflict is None
    assert result.unsolved == ()


def test_a_gap_narrower_than_the_link_is_not(tmp_path):
    result = plan(slider(tmp_path, -1e-3, starts=3))
    assert result.verdict is Verdict.NOT_FOUND
    assert result.certificate.status is Status.VIOLATED


def test_the_first_motion_that_may_hold_is_verified_before_the_search_goes_on(tmp_path, monkeypatch):
    def search_on(*args, **kwargs):
        raise AssertionError("the straight line is certified")

    monkeypatch.setattr(PhaseSolver, "sample", search_on)
    result = plan(slider(tmp_path, 3e-3))
    assert result.verdict is Verdict.CERTIFIED
    assert result.found_from == "straight line"


@pytest.fixture(scope="module")
def reached(tmp_path_factory):
    """A certified reach with an orientation, its setup and its motion."""
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_quat(scalar_first=True).tolist()
    urdf = tmp_path_factory.mktemp("arm") / "arm.urdf"
    joints = "".join(
        f'<link name="l{k}"><collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/></geometry>'
        f'</collision></link><joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k else "base"}"/>'
        f'<child link="l{k}"/><origin xyz="{0.2 if k else 0} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="20"/></joint>'
        for k in range(3)
    )
    urdf.write_text(f'<robot name="arm"><link name="base"/>{joints}</robot>')
    request = parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"floor": False},
            "start": {"joints": {"j0": 0.3, "j1": 0.9, "j2": -0.4}},
            "goal": {"poses": [{"link": "l2", "position": [0.3, 0.2, 0.0], "quaternion_wxyz": turn}]},
        }
    )
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED
    return prepare(request), result.motion


def test_a_whole_reach_is_certified_for_its_request(reached):
    setup, motion = reached
    certificate = certify_whole(setup, motion)
    assert certificate is not None
    assert certificate.status is Status.CERTIFIED
    assert not list(compare_pace(setup.request, certificate))


def test_a_reach_without_its_turn_is_not_whole_though_all_that_it_promises_holds(reached):
    setup, motion = reached
    (phase,) = motion.phases
    (target,) = phase.targets
    loose = replace(target, rotation=None, rotation_tolerance=np.full(3, np.inf))
    for targets in ((loose,), ()):
        less = replace(motion, phases=(replace(phase, targets=targets),))
        assert verify(less).status is Status.CERTIFIED
        assert certify_whole(setup, less) is None


def test_a_reach_that_stops_on_its_way_is_not_whole(reached):
    setup, motion = reached
    middle = motion.curve.knots[len(motion.curve.knots) // 2]
    (phase,) = motion.phases
    curve = motion.curve.cut(motion.curve.find_knots(motion.curve.knots[0], middle))
    part = Motion(
        motion.robot,
        motion.scene,
        curve,
        phases=(replace(phase, last=float(middle), targets=()),),
        waived=motion.waived,
    )
    assert certify_whole(setup, part) is None


def test_a_plan_that_is_called_infeasible_keeps_its_verdict_if_it_is_not_whole(reached):
    _, motion = reached
    task = TaskPlan(None, (), ("an aim is missed",))
    attempt = Attempt()
    attempt.begin(task)
    attempt.keep_better(task, motion, verify(motion))
    assert attempt.certificate.status is Status.CERTIFIED
    assert attempt.verdict is Verdict.NOT_FOUND
    assert attempt.explanation == ("an aim is missed",)
