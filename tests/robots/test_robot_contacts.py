"""Contact patches: on the surfaces of the robot's bodies, with data of the robot or of a request."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from tiny_robots import SPATIAL, atlas, chain_urdf
from typer.testing import CliRunner

from costs.contact import Contact
from costs.robot import PATCH_DEFAULTS, PatchData, RobotError, bundled_contacts, with_contacts
from costs.robot.contact_patches import SURFACE_TOLERANCE_M, find_surface_problems
from service.cli.app import app
from service.errors import RequestError
from service.proto.planner.v1 import planner_pb2
from service.request.file import parse_request, request_hash
from service.setup.prepare import prepare
from service.start.robot import add_contact_patches, load_requested_robot
from service.wire.requests import request_from_message, request_to_message
from service.work.look import describe_robots

PATCHES = sorted(bundled_contacts("atlas"))


def read(contacts, robot=None):
    return parse_request(
        {"robot": {**(robot or {"name": "atlas"}), "contacts": contacts}, "goal": {"posture": "stand"}}
    )


def refuse(contacts):
    with pytest.raises(RequestError) as caught:
        add_contact_patches(atlas(), read(contacts))
    (problem,) = caught.value.problems
    return problem


def test_atlas_brings_the_patches_that_it_names():
    wanted = {
        f"{side}_{part}" for side in ("left", "right") for part in ("foot", "toe", "heel", "wrist", "forearm", "hook")
    }
    assert wanted | {"hip", "chest"} == set(PATCHES) == set(atlas().contacts)


@pytest.mark.parametrize("name", PATCHES)
def test_every_point_lies_on_the_surface_of_a_body_of_its_link(name):
    robot, contact = atlas(), atlas().contacts[name]
    placement = robot.model.frames[robot.model.getFrameId(contact.link)].placement
    planes = [ConvexHull(body.vertices).equations for body in robot.bodies if body.link == contact.link]
    for point, normal in zip(contact.points, contact.normals, strict=True):
        at, outward = placement.act(point), -placement.rotation @ normal
        # The deepest plane of the body that the point is on; a plane there faces the surroundings.
        values = min((hull[:, :3] @ at + hull[:, 3] for hull in planes), key=lambda value: abs(value.max()))
        assert abs(values.max()) < SURFACE_TOLERANCE_M
        hull = min(planes, key=lambda hull: abs((hull[:, :3] @ at + hull[:, 3]).max()))
        facing = hull[np.abs(values) < 1e-3, :3]
        assert (facing @ outward).max() > np.cos(np.deg2rad(20.0))
    assert not list(find_surface_problems(robot, contact))
    assert 0.0 < contact.force_cap_n < np.inf
    np.testing.assert_array_equal(contact.normals, np.tile(contact.normals[0], (len(contact.points), 1)))


@pytest.mark.parametrize("part", ["foot", "toe", "heel", "wrist", "forearm"])
def test_right_patches_mirror_left_ones(part):
    left, right = (atlas().contacts[f"{side}_{part}"] for side in ("left", "right"))
    mirrored = np.sort((left.points * [1, -1, 1]).round(6), axis=0)
    np.testing.assert_allclose(mirrored, np.sort(right.points.round(6), axis=0))
    np.testing.assert_allclose(left.normals[0] * [1, -1, 1], right.normals[0])
    assert (left.friction, left.force_cap_n) == (right.friction, right.force_cap_n)


def test_undersides_of_the_forearms_face_down_where_the_forearms_point_forward():
    robot = atlas()
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.postures["reach_ready"])
    for name in ("left_wrist", "right_wrist", "left_forearm", "right_forearm"):
        contact = robot.contacts[name]
        placement = data.oMf[robot.model.getFrameId(contact.link)]
        assert (placement.rotation @ contact.normals[0])[2] > 0.9


def test_a_force_at_the_wrist_patch_loads_the_wrist_with_less_than_its_torque():
    # All three axes of the wrist meet at the origin of the link, and their torque is 25 N m each.
    contact = atlas().contacts["left_wrist"]
    cap = contact.force_cap_n
    sides = np.array([[cap * contact.friction, 0, cap], [0, cap * contact.friction, cap], [0, 0, cap]])
    assert np.abs(np.cross(contact.points[0], sides)).max() < 0.2 * 25.0


def test_a_request_changes_only_what_it_names_of_a_known_patch():
    known = atlas().contacts["hip"]
    patched = add_contact_patches(atlas(), read({"hip": {"force_cap_n": 500.0}})).contacts
    assert patched["hip"].force_cap_n == 500.0
    assert patched["hip"].friction == known.friction
    np.testing.assert_array_equal(patched["hip"].points, known.points)
    np.testing.assert_array_equal(patched["chest"].points, atlas().contacts["chest"].points)
    by_kind = add_contact_patches(atlas(), read({"hip": {"kind": "arm"}})).contacts["hip"]
    assert (by_kind.friction, by_kind.force_cap_n) == (0.4, 150.0)


def test_a_new_patch_has_the_defaults_of_its_kind_and_a_unit_normal():
    knee = {"link": "l_lleg", "points": [[0.068, 0.0, -0.02]], "normal": [-3.0, 0.0, 0.0]}
    for kind, default in PATCH_DEFAULTS.items():
        contact = add_contact_patches(atlas(), read({"knee": {**knee, "kind": kind}})).contacts["knee"]
        assert (contact.friction, contact.force_cap_n) == (default.friction, default.force_cap_n)
        np.testing.assert_allclose(contact.normals, [[-1.0, 0.0, 0.0]])
    assert (
        add_contact_patches(atlas(), read({"knee": knee})).contacts["knee"].force_cap_n
        == PATCH_DEFAULTS["arm"].force_cap_n
    )


def test_a_point_off_the_surface_is_refused_with_patch_point_and_distance():
    hip = atlas().contacts["hip"].points
    low = (hip - [0, 0, 0.005]).tolist()
    words = (
        "robot.contacts.hip.points[0]: lies 5.0 mm outside the bodies of pelvis; expected on the surface within 2 mm"
    )
    assert refuse({"hip": {"points": low}}) == words
    high = [*hip[:2].tolist(), [-0.04, 0.0, -0.09], hip[3].tolist()]
    assert "robot.contacts.hip.points[2]: lies 5.0 mm inside" in refuse({"hip": {"points": high}})


def test_a_point_on_one_body_and_inside_another_is_refused():
    # The top of the block between the thighs, inside the waist.
    assert "inside the bodies of pelvis" in refuse({"hip": {"points": [[0.0, 0.0, 0.08]], "normal": [0, 0, -1]}})


def test_a_normal_that_pulls_is_refused():
    problem = refuse({"hip": {"normal": [0, 0, -1]}})
    assert problem.startswith("robot.contacts.hip.normal: is 90 deg off the surface of pelvis at points[0]")
    assert problem.endswith("into the link, expected [0.00, 0.00, 1.00] within 15 deg")


@pytest.mark.parametrize(
    ("contacts", "problem"),
    [
        ({"knee": {"link": "l_lleg"}}, "robot.contacts.knee.points: is missing"),
        ({"knee": {"points": [[0, 0, 0]], "normal": [0, 0, 1]}}, "robot.contacts.knee.link: is missing"),
        ({"hip": {"link": "pelvi"}}, "robot.contacts.hip.link: unknown link 'pelvi'; atlas has pelvis"),
        ({"hip": {"link": "l_tool"}}, "robot.contacts.hip.link: 'l_tool' has no body to touch with"),
    ],
)
def test_a_patch_that_cannot_be_made_is_refused_by_name(contacts, problem):
    assert refuse(contacts).startswith(problem)


@pytest.mark.parametrize(
    ("patch", "problem"),
    [
        ({"normal": [0, 0, 0]}, "robot.contacts.hip: normal has no length"),
        ({"force_cap_n": 0}, "robot.contacts.hip.force_cap_n: more than 0 is needed"),
        ({"force_cap_n": float("inf")}, "robot.contacts.hip.force_cap_n: a finite number is needed"),
        ({"kind": "hand"}, "robot.contacts.hip.kind: expected 'foot', 'trunk' or 'arm'"),
        ({"points": []}, "robot.contacts.hip.points: at least 1 entries are needed"),
        ({"mu": 1.0}, "robot.contacts.hip: unknown key 'mu'"),
    ],
)
def test_a_wrong_value_is_refused_by_its_field(patch, problem):
    with pytest.raises(RequestError) as caught:
        read({"hip": patch})
    assert caught.value.problems[0].startswith(problem)


def test_patches_of_any_robot_travel_with_the_request_and_its_hash(tmp_path):
    (tmp_path / "arm.urdf").write_text(chain_urdf(SPATIAL))
    robot = {"urdf": str(tmp_path / "arm.urdf")}
    top = {"link": "link1", "points": [[0.1, 0.0, 0.06]], "normal": [0, 0, -1]}
    request = read({"top": top}, robot)
    assert request_from_message(request_to_message(request)) == request
    assert request_hash(request) != request_hash(read({"top": {**top, "force_cap_n": 99}}, robot))
    assert load_requested_robot(request).contacts["top"].link == "link1"
    assert not load_requested_robot(read({}, robot)).contacts


def test_patches_stay_with_a_robot_that_carries_something():
    carried = {"type": "box", "name": "case", "size": [0.05, 0.05, 0.05], "link": "l_tool", "position": [0, 0, 0.05]}
    data = {"robot": {"name": "atlas", "contacts": {"hip": {"friction": 0.3}}}, "attached": [carried]}
    setup = prepare(parse_request({**data, "goal": {"posture": "stand"}}), checks_start=False)
    assert setup.robot.contacts["hip"].friction == 0.3
    assert set(setup.robot.contacts) == set(PATCHES)


@settings(max_examples=40, deadline=None)
@given(
    corner=st.integers(0, 3),
    shift=st.tuples(*[st.floats(-0.02, 0.02)] * 3).map(np.array),
)
def test_points_are_accepted_exactly_within_the_tolerance_of_a_box(tmp_path_factory, corner, shift):
    # A box of 0.3 x 0.1 x 0.12, whose distance to a point is known in closed form.
    robot = box_robot(tmp_path_factory)
    half = np.array([0.15, 0.05, 0.06])
    signs = np.array([[1, 1, 1], [1, -1, 1], [-1, 1, -1], [1, 0, 0]][corner])
    local = signs * half + shift
    beyond = np.abs(local) - half
    signed = float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(beyond.max(), 0.0))
    contact = Contact("link1", [local + np.array([0.15, 0, 0])], [-signs / np.linalg.norm(signs)], 0.5, 100.0)
    problems = list(find_surface_problems(robot, contact))
    is_off = any("lies" in problem for problem in problems)
    if abs(abs(signed) - SURFACE_TOLERANCE_M) > 1e-9:
        assert is_off == (abs(signed) > SURFACE_TOLERANCE_M)
    if is_off:
        assert f"lies {1e3 * abs(signed):.1f} mm {'outside' if signed > 0 else 'inside'}" in problems[0]


_MADE = {}


def box_robot(tmp_path_factory):
    if "robot" not in _MADE:
        path = tmp_path_factory.mktemp("box") / "arm.urdf"
        path.write_text(chain_urdf(SPATIAL))
        _MADE["robot"] = load_requested_robot(read({}, {"urdf": str(path)}))
    return _MADE["robot"]


@settings(max_examples=40, deadline=None)
@given(angle=st.floats(-np.pi, np.pi), along=st.floats(0.011, 0.064), off=st.floats(-0.008, 0.02))
def test_round_shapes_count_as_they_are(angle, along, off):
    # The hook: a cylinder of 9 mm radius along z of its link, with a prism around it; its ends are farther than 10 mm.
    radial = np.array([np.cos(angle), np.sin(angle), 0.0])
    point = (0.009 + off) * radial + [0.0, 0.0, along]
    problems = list(find_surface_problems(atlas(), Contact("l_hook", [point], [-radial], 0.5, 100.0)))
    assert bool(problems) == (abs(off) > SURFACE_TOLERANCE_M)
    if problems:
        assert f"lies {1e3 * abs(off):.1f} mm {'outside' if off > 0 else 'inside'}" in problems[0]
    else:
        turned = np.array([-radial[1], radial[0], 0.0])
        (tangential,) = find_surface_problems(atlas(), Contact("l_hook", [point], [turned], 0.5, 100.0))
        assert "90 deg off" in tangential


def test_a_patch_without_a_robot_of_that_name_names_the_patch():
    with pytest.raises(RobotError, match=r"^knee\.link: is missing"):
        with_contacts(replace(atlas(), contacts={}), {"knee": PatchData(points=[[0, 0, 0]])})


def test_a_server_describes_the_patches_of_a_robot():
    (row,) = describe_robots({})
    info = planner_pb2.RobotInfo(**row)
    (hip,) = (contact for contact in info.contacts if contact.name == "hip")
    assert (hip.link, hip.friction, hip.force_cap_n) == ("pelvis", 0.4, 800.0)
    np.testing.assert_array_equal([point.value for point in hip.points], atlas().contacts["hip"].points)


def test_robots_lists_patches_with_friction_and_caps():
    text = CliRunner().invoke(app, ["robots"]).stdout
    line = next(line for line in text.splitlines() if line.startswith("hip"))
    assert line.split() == ["hip", "atlas", "pelvis", "4", "0.4", "800", "N"]
    assert any(line.split() == ["arm", "0.4", "150", "N"] for line in text.splitlines())
    listed = json.loads(CliRunner().invoke(app, ["robots", "--json"]).stdout)
    assert listed["robots"][0]["contacts"]["chest"]["link"] == "utorso"
    assert listed["contact_defaults"]["foot"] == {"friction": 0.6, "force_cap_n": 1600.0}
