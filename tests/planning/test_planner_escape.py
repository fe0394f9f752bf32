"""A start in collision: told with pair and depth, and left first when that is asked for, with an honest certificate."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from planar_arm import write_planar_arm
from rich.console import Console
from shared_plans import write_undrawn
from small_plan import small_plan
from small_robots import box
from stranger import Stranger

from costs.allowance import Allowance, BodyRef
from costs.robot import load_robot
from costs.scene import Scene
from service.body.aims import Aims
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.cli.report import print_figures, print_findings, print_verdict
from service.demands.stance import DEPTH_ROUNDING
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request
from service.result.attempt import list_shortfalls
from service.result.result import Verdict
from service.result.result_json import summary_json
from service.setup.prepare import prepare
from service.start.overlaps import Overlap, find_overlaps
from service.tasks.leave_start import LeavingBody
from service.verify import Basis, Status, verify

BLOCK = {"name": "block", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 0.06, 0.0]}


def arm_request(folder, goal=None, block=BLOCK, **options):
    """A straight arm of 0.6 m whose outer link is 10 mm deep in a block beside it."""
    urdf = write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0)
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"obstacles": [block], "floor": False},
            "start": {"joints": {"j0": 0.0, "j1": 0.0, "j2": 0.0}},
            "goal": {"joints": goal or {"j0": -1.0, "j1": 0.0, "j2": 0.0}},
            "options": options,
        }
    )


def atlas_request(obstacles=(), start=None, **options):
    return parse_request(
        {
            "robot": {"name": "atlas"},
            "start": {"posture": "stand", "joints": start or {}},
            "scene": {"obstacles": list(obstacles)},
            "goal": {"joints": {"back_bkz": 0.2}},
            "options": options,
        }
    )


@pytest.fixture(scope="module")
def escaped(tmp_path_factory):
    """A plan that begins in a block, and its folder."""
    result = plan(arm_request(tmp_path_factory.mktemp("arm"), escape=True))
    folder = tmp_path_factory.mktemp("escape") / "out"
    write_undrawn(result, folder)
    return result, Stranger(folder)


def test_a_start_in_collision_is_refused_with_pair_and_depth_and_told_what_would_do(tmp_path):
    with pytest.raises(RequestError) as caught:
        prepare(arm_request(tmp_path))
    assert caught.value.problems == (
        "start is in collision: l2 is 10 mm inside block (obstacle)",
        "options.escape: false; true would plan a way out of the collision first",
    )


def test_the_first_phase_leaves_and_the_rest_is_certified_as_ever(escaped):
    result, _ = escaped
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    first, second = result.motion.phases
    assert (first.name, second.name) == ("escape", "reach")
    assert [(a.first, a.second) for a in first.allowances] == [(BodyRef.of_link("l2"), BodyRef.of_piece("block"))]
    assert first.allowances[0].depth == pytest.approx(0.01, abs=2e-4)
    assert second.allowances == ()
    (exempt,) = result.certificate.exempt
    assert (exempt.pair, exempt.phase) == (("l2", "block"), "escape")
    assert exempt.deepest_m == pytest.approx(0.01, abs=1e-6)
    assert exempt.proven_m <= exempt.allowed_m


def test_no_claim_of_the_result_calls_the_motion_clear(escaped):
    result, _ = escaped
    assert "start is in collision: l2 is 10 mm inside block (obstacle); the first phase leaves it" in result.notes
    (start,) = [check for check in result.certificate.checks if check.name.startswith("start.")]
    assert start.text == ("starts in collision: l2 is 10.0 mm inside block, which 'escape' allows down to 10.1 mm")
    assert start.value == pytest.approx(-0.01, abs=1e-6)
    assert start.where.s == result.motion.phases[0].first
    (clearance,) = [check for check in result.certificate.checks if check.name == "clearance"]
    assert clearance.text.endswith(", pairs that may touch aside")
    screen = Console(file=StringIO(), width=160)
    print_findings(screen, summary_json(result))
    print_figures(screen, summary_json(result))
    print_verdict(screen, summary_json(result))
    printed = screen.file.getvalue()
    assert "l2 and block" in printed.split("CERTIFIED")[0]  # the table of pairs that may touch
    assert "note: start is in collision: l2 is 10 mm inside block" in printed
    assert ", pairs that may touch aside" in printed.split("clearance     ")[-1]


def test_the_depth_falls_to_nothing_within_the_phase_and_every_other_pair_is_clear(escaped):
    result, _ = escaped
    first = result.motion.phases[0]
    found = []
    for s in np.linspace(first.first, result.motion.phases[-1].last, 400):
        inside = find_overlaps(result.robot, result.motion.curve(np.array([s]))[0], result.scene, ())
        assert {(one.link, one.other) for one in inside} <= ({("l2", "block")} if s < first.last else set())
        found += [inside[0].depth if inside else 0.0] if s <= first.last else []
    assert found[0] == pytest.approx(0.01, abs=1e-6)
    assert max(np.diff(found)) <= 1e-6
    assert found[-1] == 0.0


def test_a_stranger_finds_the_start_in_the_block_and_the_second_phase_clear(escaped):
    result, stranger = escaped
    border = int(stranger.data["phases"][0]["last"])
    nothing = lambda body, link, piece: False  # noqa: E731
    begins, pair = stranger.closest(stranger.positions[:1], nothing)
    assert begins == pytest.approx(-0.01, abs=1e-6)
    assert pair == ("l2", "block")
    after, _ = stranger.closest(stranger.positions[border:], nothing)
    assert after >= result.certificate.min_clearance_m - 1e-6


def test_without_its_allowance_or_with_a_smaller_one_the_same_motion_is_refuted(escaped):
    result, _ = escaped
    first, second = result.motion.phases
    l1, l2, block = BodyRef.of_link("l1"), BodyRef.of_link("l2"), BodyRef.of_piece("block")
    for allowances in ((), (Allowance(l2, block, 0.009),), (Allowance(l1, block, 0.02),)):
        certificate = verify(replace(result.motion, phases=(replace(first, allowances=allowances), second)))
        assert certificate.status is Status.VIOLATED
        line = next(line for line in list_shortfalls(certificate) if line.startswith("l2 penetrates block by "))
        assert line.endswith(" s)")
    assert verify(result.motion).status is Status.CERTIFIED


def test_links_that_are_in_each_other_at_the_start_come_apart():
    result = plan(atlas_request(start={"l_arm_elx": 2.3, "l_arm_shz": -1.0}, escape=True))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    own = [
        exempt for exempt in result.certificate.exempt if exempt.pair != ("l_foot", "floor") and exempt.deepest_m > 1e-6
    ]
    assert [(set(exempt.pair), exempt.phase) for exempt in own] == [({"l_uarm", "l_ufarm"}, "escape")]
    assert "start is in collision: l_uarm is 2.5 mm inside l_ufarm; the first phase leaves it" in result.notes
    assert [check.where.names for check in result.certificate.checks if check.name.startswith("start.")] == [
        own[0].pair
    ]


def test_a_robot_on_its_feet_leaves_a_crate_and_keeps_standing():
    crate = {"name": "crate", "type": "box", "size": [0.2, 0.2, 0.2], "position": [0.42, 0.28, 0.95]}
    result = plan(atlas_request([crate], escape=True))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert [phase.name for phase in result.motion.phases] == ["escape", "reach"]
    assert {contact.link for contact in result.motion.phases[0].contacts} == {"l_foot", "r_foot"}
    assert result.motion.phases[0].support.margin_m == result.request.options.balance_margin_m
    assert all("start is in collision: " in note for note in result.notes[:1])


def test_nothing_to_escape_changes_nothing(tmp_path):
    clear = {**BLOCK, "position": [0.5, 0.3, 0.0]}
    plans = [plan(arm_request(tmp_path, block=clear, escape=escape)) for escape in (False, True)]
    assert [phase.name for phase in plans[1].motion.phases] == ["reach"]
    np.testing.assert_array_equal(*(one.motion.curve.positions for one in plans))
    assert not any(check.name.startswith("start.") for check in plans[1].certificate.checks)


def test_what_is_caught_for_good_is_not_found_and_told(tmp_path):
    # the first link turns about its end only: a block around the joint cannot be left
    around = {**BLOCK, "position": [0.0, 0.0, 0.0]}
    result = plan(arm_request(tmp_path, block=around, escape=True))
    assert result.verdict is Verdict.NOT_FOUND
    assert result.conflict.step == "escape"
    assert [demand.name for demand in result.conflict.demands] == ["block"]
    assert result.explanation[0].startswith("escape: ")


def test_a_piece_may_be_called_anything_that_no_link_is_called(tmp_path):
    result = plan(arm_request(tmp_path, block={**BLOCK, "name": "l*"}, escape=True))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    with pytest.raises(RequestError) as caught:
        prepare(arm_request(tmp_path, block={**BLOCK, "name": "l0"}, escape=True))
    assert caught.value.problems == ("scene.obstacles[0].name: 'l0' is a link of arm; expected another name",)


def test_a_planted_foot_cannot_leave_the_floor():
    request = parse_request(
        {
            "robot": {"name": "atlas"},
            "scene": {"floor": 0.05},
            "goal": {"posture": "stand"},
            "options": {"escape": True},
        }
    )
    with pytest.raises(RequestError) as caught:
        prepare(request)
    assert caught.value.problems == tuple(
        f"start is out of balance: the ground is 50.0 mm above the sole of {foot}; expected at most 3 mm: "
        "move start.base, or leave it out"
        for foot in ("l_foot", "r_foot")
    )


def test_feet_that_stand_in_a_scanned_floor_are_not_told_as_a_collision():
    motion = small_plan().motion
    floor = next(piece for piece in motion.scene.pieces if piece.name == "floor")
    raised = replace(floor, vertices=floor.vertices + np.array([0.0, 0.0, 0.0025]))
    pieces = tuple(raised if piece is floor else piece for piece in motion.scene.pieces)
    certificate = verify(replace(motion, scene=Scene(pieces)))
    assert certificate.status is Status.CERTIFIED
    assert max(exempt.deepest_m for exempt in certificate.exempt) > 2e-3
    assert not any(check.name.startswith("start.") for check in certificate.checks)
    (clearance,) = [check for check in certificate.checks if check.name == "clearance"]
    assert "aside" not in clearance.text
    # the same plate under the feet, were it no floor, is told
    box_below = replace(raised, kind="obstacle")
    pieces = tuple(box_below if piece is floor else piece for piece in motion.scene.pieces)
    told = [
        check.where.names for check in verify(replace(motion, scene=Scene(pieces))).checks if "start." in check.name
    ]
    assert sorted(told) == [("l_foot", "floor"), ("r_foot", "floor")]


def test_what_is_asked_of_the_overlapping_pair_rises_from_its_depth_to_the_margin(tmp_path):
    robot = load_robot(urdf=write_planar_arm(tmp_path, 3, 0.2, 0.04, limit=3.0))
    scene = Scene(
        (box("block", (0.5, 0.06, 0.0), (0.05, 0.05, 0.05)), box("other", (0.5, -0.06, 0.0), (0.05, 0.035, 0.05)))
    )
    start = np.zeros(3)
    body = LeavingBody.of(
        WholeBody.standing(robot, scene, start, (), Aims()), (Overlap("l2", "block", 0.01, "obstacle"),)
    )
    problem = body.make_problem(*body.bounds(5, {0: start}), body.make_checker((), [start]))
    contacts = problem.state(np.zeros((5, 3))).contacts
    name = np.array([scene.pieces[other].name for other in contacts.other])
    outer = np.array([robot.bodies[one].link == "l2" for one in contacts.body])
    block = contacts.where((name == "block") & ~contacts.is_self & outer)
    np.testing.assert_array_equal(block.first, range(4))
    rounding = CLEARANCE_TOLERANCE - 0.5 * DEPTH_ROUNDING
    np.testing.assert_allclose(block.margin, [-0.01 + rounding, -0.02 / 3 + rounding, -0.01 / 3 + rounding, 0.02])
    # another pair that is near at the start is asked for what it has there, as in every phase
    other = contacts.where((name == "other") & ~contacts.is_self & outer)
    np.testing.assert_allclose(other.margin, 0.005 - CLEARANCE_TOLERANCE, atol=1e-9)


def test_the_check_of_the_start_is_measured_not_proven(escaped):
    result, _ = escaped
    (start,) = [check for check in result.certificate.checks if check.name.startswith("start.")]
    assert start.basis is Basis.SAMPLES
