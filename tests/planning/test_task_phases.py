"""Phases as data: what they promise, how they are grouped, and the phases of valves and doors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from given_doors import door_request
from scipy.spatial.transform import Rotation

from service.demands.door.demand import make_door, read_given_door
from service.demands.door.door import Door
from service.demands.door.phases import DoorChoice, make_door_phases
from service.demands.hands import HANDS
from service.demands.phase import FrameMotion, TaskPhase, check_moves, list_work, make_frame_targets
from service.request.file import parse_request
from service.tasks.hints import PhaseHints, count_waypoints, find_anchor, measure_way
from service.tasks.phase_terms import shrink
from service.tasks.sequence import split_groups
from service.verify import JointTarget, RelativePoseTarget

SHUT, OPEN = np.array([0.0]), np.array([0.5])
HAND = FrameMotion("l_tool", "leaf", np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, -1.0]))


def given(**arguments) -> Door:
    """A given door in front of a robot at the origin."""
    task = parse_request(door_request(**arguments)).task
    geometry = read_given_door(task.door, np.zeros(3))
    return make_door(task.door, geometry)


def test_groups_begin_with_their_free_phase_and_lead_a_hand() -> None:
    reach, hold = TaskPhase("reach", SHUT, SHUT), TaskPhase("hold", SHUT, OPEN, (HAND,))
    line = TaskPhase("line", OPEN, OPEN, (replace(HAND, offset=np.ones(3), leaves=True),))
    again = replace(hold, name="hold 2", first=OPEN)
    groups = list(split_groups([reach, hold, line, replace(reach, first=OPEN, last=OPEN), again]))
    assert [[spec.name for spec in group] for group in groups] == [["reach", "hold", "line"], ["reach", "hold 2"]]
    with pytest.raises(ValueError, match="leads a hand among reach"):
        list(split_groups([reach]))


def test_the_work_of_a_hold_is_what_stays_moved_and_the_hand_goes_farthest_in_its_anchor() -> None:
    door = given()
    phases = make_door_phases(door, DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.5))
    assert [phases[k].name for k in list_work(phases)] == ["open"]
    assert phases[1 + find_anchor(phases[1:], door.mechanism)].name == "open"
    handle = [phase for phase in phases if phase.moving == (1,)]  # it is pressed and let go: nothing stays moved
    assert [phase.name for phase in handle] == ["turn the handle", "let the handle go"]
    assert list_work(handle) == (0, 1)
    stays = make_door_phases(door, DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.5, stays=True))
    assert [stays[k].name for k in list_work(stays)] == ["turn the handle", "open"]
    assert stays[find_anchor(stays, door.mechanism)].name == "open"
    # by the arc of the hand: 0.5 rad at its distance from the hinge
    arm = float(np.linalg.norm(np.cross(phases[3].hand.place, door.geometry.hinge_axis)))
    assert measure_way(phases[3], door.mechanism) == pytest.approx(0.5 * arm, rel=1e-3)


def test_waypoints_follow_what_moves() -> None:
    door = given()
    phases = make_door_phases(door, DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.7))
    hints = PhaseHints(free_waypoints=9)
    counts = {phase.name: count_waypoints(phase, door.mechanism, hints) for phase in phases}
    assert counts["reach"] == 9
    assert counts["approach"] == counts["retract"] == 5
    assert counts["open"] == int(np.ceil(np.rad2deg(0.7) / 10.0)) + 1
    assert count_waypoints(phases[3], door.mechanism, PhaseHints(turn_step=0.35)) == 4


def test_a_goal_is_promised_at_the_end_and_a_frame_all_along() -> None:
    goal = (JointTarget("elbow", 0.3, 1e-3, 0.0),)
    phase = TaskPhase("hold", SHUT, OPEN, (HAND,), goal=goal, joints={"finger": (0.0, 0.1)})
    targets = phase.list_targets(("elbow", "finger", "leaf_joint"), 7.0)
    assert [(t.joint, t.value, t.at) for t in targets if isinstance(t, JointTarget)] == [
        ("leaf_joint", 0.5, 7.0), ("finger", 0.1, 7.0), ("elbow", 0.3, 7.0),
    ]  # fmt: skip
    assert isinstance(targets[0], RelativePoseTarget)
    np.testing.assert_allclose(targets[0].position, HAND.place)


def test_a_line_is_promised_only_where_it_is_kept() -> None:
    line = replace(HAND, offset=np.array([0.0, 0.0, 0.4]), rotation=np.eye(3))
    assert make_frame_targets(line) == ()
    (target,) = make_frame_targets(replace(line, keeps_line=True))
    np.testing.assert_allclose(target.position, [0.1, 0.2, 0.5])
    np.testing.assert_allclose(target.slide, [0.0, 0.0, 0.2])


def test_a_mechanism_that_jumps_between_phases_is_refused() -> None:
    with pytest.raises(ValueError, match="jumps between the phases 'reach' and 'hold'"):
        check_moves([TaskPhase("reach", SHUT, SHUT), TaskPhase("hold", OPEN, OPEN, (HAND,))])


def test_a_line_ends_at_its_place_or_leaves_it() -> None:
    line = replace(HAND, offset=np.array([0.0, 0.0, 0.4]))
    np.testing.assert_allclose(line.places(3)[:, 2], [0.7, 0.5, 0.3])
    np.testing.assert_allclose(replace(line, leaves=True).places(3)[:, 2], [0.3, 0.5, 0.7])


def test_the_promised_axis_is_the_hands_z_axis() -> None:
    (target,) = make_frame_targets(HAND)
    np.testing.assert_allclose(target.rotation @ [0.0, 0.0, 1.0], HAND.axis, atol=1e-12)
    place, lean = make_frame_targets(replace(HAND, axis_link="frame"))
    assert (place.reference, lean.reference) == ("leaf", "frame")
    assert place.rotation_tolerance_rad == pytest.approx(np.pi)


def test_the_waypoints_leave_some_of_each_allowance_to_the_curve() -> None:
    touches = make_door_phases(given(), DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.5))[1].touches
    assert {touch.depth for touch in touches} == {6e-3}
    assert all(touch.depth == pytest.approx(3e-3) for touch in shrink(touches))


@pytest.mark.parametrize("opens", ["push", "pull"])
def test_positive_angles_open_the_leaf_and_turn_the_lever_down(opens: str) -> None:
    door = given(opens=opens)
    leaf, lever = door.mechanism.joints
    edge = door.geometry.width * door.geometry.along
    moved = Rotation.from_rotvec(0.1 * leaf.axis).apply(edge) - edge
    assert np.sign(moved @ door.geometry.normal) == (-1.0 if opens == "push" else 1.0)
    end = door.handle.length * door.handle.direction
    assert (Rotation.from_rotvec(0.1 * lever.axis).apply(end) - end)[2] < 0.0
    assert lever.parent == leaf.link


@pytest.mark.parametrize("opens", ["push", "pull"])
def test_the_phases_of_a_latched_door_release_before_they_open(opens: str) -> None:
    door = given(opens=opens)
    phases = make_door_phases(door, DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.5))
    check_moves(phases)
    assert [phase.name for phase in phases] == [
        "reach", "approach", "turn the handle", "open", "let the handle go", "retract",
    ]  # fmt: skip
    opening = phases[3]
    assert opening.first[1] >= door.release
    assert opening.last[1] >= door.release
    assert opening.moving == (0,)
    assert JointTarget("door_opening", 0.5, 1e-3, 7.0) in opening.list_targets(
        ("base_x", "door_opening", "door_handle"), 7.0
    )
    moment = sum(
        float(np.cross(load.place, load.force) @ door.geometry.hinge_axis)
        for load in opening.loads
        if load.link == "door/leaf"
    )
    assert moment == pytest.approx(door.hinge_nm)


def test_the_hand_meets_the_leaf_where_it_was_at_the_handle() -> None:
    """The hold on the leaf during the opening is where the hold on the lever ends."""
    door = given()
    phases = make_door_phases(door, DoorChoice(HANDS["left"], 0.065, 0.1, 1.0, 0.5))
    press, opening = phases[2].hand, phases[3].hand
    turned = Rotation.from_rotvec(phases[2].last[1] * door.spindle_axis).apply(press.place)
    np.testing.assert_allclose(door.handle.centre + turned, door.geometry.hinge + opening.place, atol=1e-12)
