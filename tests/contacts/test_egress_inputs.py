"""Phases and surfaces of an egress: what is read, what is kept, and what is said of input that cannot be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from egress_car import REQUEST, car, phases, stages, task

from service.demands.contacts.surfaces import make_surfaces
from service.demands.egress.demand import load_phases
from service.errors import RequestError
from service.request.file import load_request, parse_section
from service.request.tasks.egress import ContactRequest, EgressRequest, PhasesFile
from service.start.configuration import make_start_configuration
from service.tasks.egress.plan import make_all_stages
from service.tasks.egress.stages import list_lasting, make_stages

BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.3, 0.3) for z in (0.0, 0.2)])


def refuse(changed, *words):
    """The message with which the phases are refused."""
    robot, scene = car()
    with pytest.raises(RequestError) as caught:
        make_stages(robot, make_surfaces(task().surfaces, scene, "surfaces"), changed, path="task.egress.phases")
    message = str(caught.value)
    assert all(word in message for word in words), message


def change(k, **contacts):
    """The shipped phases with other contacts in phase ``k``; None takes one away."""
    new = {**phases()[k].contacts, **contacts}
    changed = replace(phases()[k], contacts={name: entry for name, entry in new.items() if entry is not None})
    return (*phases()[:k], changed, *phases()[k + 1 :])


def test_an_unknown_patch_is_refused_by_name():
    refuse(change(2, left_knee=ContactRequest("seat")), "task.egress.phases[2].contacts", "left_knee", "left_heel")


def test_an_unknown_surface_is_refused_by_name():
    refuse(change(1, right_foot=ContactRequest("platfrom")), "'platfrom'", "platform")


def test_an_unknown_link_joint_or_posture_is_refused_by_name():
    first = phases()[0]
    posture = first.postures[0]
    for bad, word in (
        (replace(first, postures=(replace(posture, posture="lie"),)), "'lie'"),
        (replace(first, postures=(replace(posture, joints={"l_leg_xyz": 0.1}),)), "'l_leg_xyz'"),
        (replace(first, sides=(replace(phases()[1].sides[0], link="l_shin"),)), "'l_shin'"),
        (replace(first, postures=()), "needs a nominal pose"),
    ):
        refuse((bad, *phases()[1:]), word)


def test_phases_that_share_no_contact_are_refused_by_name():
    refuse((phases()[0], phases()[9]), "'left foot out' shares no contact", "'sit'")


def test_two_patches_of_one_link_are_refused():
    refuse(change(0, left_toe=ContactRequest("floor")), "left_foot and left_toe", "l_foot")


def test_a_place_beyond_its_surface_is_told_in_metres():
    refuse(
        change(0, right_foot=ContactRequest("floor", toe=(0.37, -1.5, 0.4), yaw_deg=0.0)), "m beyond the edges", "floor"
    )


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"surfaces": {"a": {"friction": 0.5}}}, "give either piece or corners"),
        ({"surfaces": {"a": {"piece": "x", "normal": [0, 0, 0]}}}, "normal has no length"),
        ({"surfaces": {"a": {"corners": [[0, 0, 0], [1, 0, 0]]}}}, "at least 3"),
        ({"phases": [{"name": "sit", "contacts": {}}]}, "at least one"),
        (
            {"phases": [{"name": "a", "contacts": {"hip": {"surface": "s", "region": [0.1, 0.1]}}}]},
            "region needs a place",
        ),
        ({"samples": 0}, "at least 1"),
        ({"phase_file": "x"}, "unknown key 'phase_file'"),
    ],
)
def test_a_section_that_cannot_be_used_is_refused(data, words):
    with pytest.raises(RequestError, match=words):
        parse_section(EgressRequest, data)


def test_two_phases_of_one_name_are_refused():
    twice = {"phases": [{"name": "a", "contacts": {"hip": {"surface": "s"}}}] * 2}
    with pytest.raises(RequestError, match="given twice"):
        parse_section(PhasesFile, twice)


def test_phases_of_a_file_are_read_beside_the_request(tmp_path):
    text = "phases: [{name: sit, contacts: {hip: {surface: seat, at: [0.0, 0.0, 0.86]}}}]"
    (tmp_path / "mine.yaml").write_text(text)
    (phase,) = load_phases(EgressRequest(phases_file="mine.yaml"), car()[0], tmp_path)
    assert phase.contacts["hip"].at == (0.0, 0.0, 0.86)


def test_phases_end_with_the_one_that_is_wanted():
    wanted = load_phases(replace(task(), until="stand up inside"), car()[0])
    assert [phase.name for phase in wanted] == [phase.name for phase in phases()][:5]


@pytest.mark.parametrize("until", ["sit", "stand up insid"])
def test_an_unknown_last_phase_is_refused_by_name(until):
    with pytest.raises(RequestError, match=r"task\.egress\.until: no phase .* expected .*stand up inside"):
        load_phases(replace(task(), until=until), car()[0])


def test_a_contact_without_a_place_stays_where_it_was():
    left = [next((aim for aim in stage.aims if aim.patch == "left_foot"), None) for stage in stages()]
    assert all(aim is left[0] for aim in left[:9])
    assert left[9] is not left[0]
    assert list_lasting(stages(), 0, "left_foot") == tuple(range(9))
    assert "left_foot" not in stages()[9].kept


def test_a_drawn_place_moves_every_contact_with_a_region_alike():
    robot, scene = car()
    for drawn in make_all_stages(robot, scene, replace(task(), samples=4), phases()):
        out, turned = (next(a for a in drawn[k].aims if a.patch == "right_foot") for k in (1, 7))
        np.testing.assert_allclose(out.place, turned.place)
        assert (np.abs(out.place[:2] - [0.34, -0.73]) <= 0.1).all()


def test_a_foot_drawn_near_an_edge_is_turned_no_more_than_brings_its_sole_onto_the_surface():
    robot, scene = car()
    surfaces = make_surfaces(task().surfaces, scene, "surfaces")
    sole, asked = robot.contacts["right_foot"].points, np.deg2rad(-42)
    turned = 0
    for y in np.linspace(-0.5, 0.5, 11):
        drawn = make_stages(robot, surfaces, phases()[:2], (0.0, float(y)), "phases")[1]
        aim = next(aim for aim in drawn.aims if aim.patch == "right_foot")
        assert aim.place is not None
        assert aim.yaw_rad is not None
        flat = (sole - aim.mark)[:, :2]

        def beyond(yaw, flat=flat, aim=aim):
            rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
            points = np.column_stack([aim.place[:2] + flat @ rotation.T, np.full(len(flat), aim.place[2])])
            return float(aim.surface.measure_outside(points).max())

        assert beyond(aim.yaw_rad) <= 1e-9
        assert (beyond(asked) > 0.0) == (abs(aim.yaw_rad - asked) > 1e-9)
        turn = aim.yaw_rad - asked
        assert all(beyond(asked + share * turn) > 0.0 for share in (0.0, 0.5, -0.5, -0.9) if turn)
        turned += bool(turn)
    assert 0 < turned < 11


def test_the_start_has_the_contacts_of_the_first_phase_in_place():
    robot, _ = car()
    q, _ = make_start_configuration(robot, load_request(REQUEST).start)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    for aim in stages()[0].aims:
        patch = robot.contacts[aim.patch]
        pose = data.oMf[robot.model.getFrameId(patch.link)]
        points = np.array([pose.act(point) for point in patch.points])
        assert np.abs(aim.surface.measure_height(points)).max() < 1e-4
        assert aim.surface.measure_outside(points).max() < 1e-4
