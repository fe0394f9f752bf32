"""Elements of a URDF beside links, joints and limits: soft limits, friction, masses and angles that cannot be meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from given_mechanisms import bar, drawer_request, drawer_urdf
from heavy_mechanisms import inertial
from robot_files import joint, link, robot, two_links, write_urdf

from costs.robot import LinkInertia, RobotError, RobotModel, load_robot, read_mechanism
from costs.robot.poses import rpy_matrix
from service import RequestError, load_request, parse_request, plan
from service.setup.prepare import prepare

BOX = '<box size="0.1 0.1 0.1"/>'
LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="200"/>'
SOFT_NOTE = "joint 'turn': the soft limits of its <safety_controller> count as its limits"


def _load(folder: Path, text: str) -> RobotModel:
    return load_robot(urdf=write_urdf(folder, text))


def _soften(low: object, high: object) -> str:
    return f'<safety_controller k_position="20" k_velocity="20" soft_lower_limit="{low}" soft_upper_limit="{high}"/>'


def test_a_soft_limit_is_a_limit(tmp_path: Path) -> None:
    model = _load(tmp_path, two_links(LIMIT + _soften(-1.2, 1.0)))
    assert (model.lower[0], model.upper[0]) == (-1.2, 1.0)
    assert model.notes == (SOFT_NOTE,)


@pytest.mark.parametrize(
    ("controller", "note"),
    [
        ('<safety_controller k_velocity="10"/>', ()),
        (_soften(-3, 4), ()),  # wider than the limits
        (_soften(2, -2), ("joint 'turn': its soft limits of 2 to -2 leave it no range and do not count",)),
    ],
)
def test_soft_limits_that_say_nothing_leave_the_limits(tmp_path: Path, controller: str, note: tuple[str, ...]) -> None:
    model = _load(tmp_path, two_links(LIMIT + controller))
    assert (model.lower[0], model.upper[0], model.notes) == (-3.0, 3.0, note)


def test_a_continuous_joint_has_the_soft_limits_that_it_states(tmp_path: Path) -> None:
    limit = '<limit velocity="2" effort="200"/>'
    model = _load(tmp_path, two_links(limit + _soften(-1, 2), kind="continuous"))
    assert (model.lower[0], model.upper[0], model.notes) == (-1.0, 2.0, (SOFT_NOTE,))


def test_many_soft_limits_make_one_note(tmp_path: Path) -> None:
    links = [link(f"l{k}", BOX) for k in range(6)]
    joints = [joint(f"j{k}", f"l{k}", f"l{k + 1}", inside=LIMIT + _soften(-1 - k, 1)) for k in range(5)]
    (note,) = _load(tmp_path, robot(*links, *joints)).notes
    assert note == "joints j0, j1, j2 and 2 more: the soft limits of its <safety_controller> count as its limits"


def test_a_posture_beyond_a_soft_limit_is_put_there_with_a_note(tmp_path: Path) -> None:
    srdf = tmp_path / "robot.srdf"
    states = "".join(
        f'<group_state name="{name}" group="all"><joint name="turn" value="{value}"/></group_state>'
        for name, value in (("near", -1.25), ("inside", 0.5), ("outside", -3.5))
    )
    srdf.write_text(f'<robot name="sample"><group name="all"><joint name="turn"/></group>{states}</robot>')
    model = load_robot(urdf=write_urdf(tmp_path, two_links(LIMIT + _soften(-1.2, 1.0))), srdf=srdf)
    found = {name: float(posture[0]) for name, posture in model.postures.items()}
    assert found == {"near": -1.2, "inside": 0.5, "outside": -3.5}  # beyond the limits themselves a start is refused
    assert model.notes == (SOFT_NOTE, "posture 'near': turn at -1.25 is put at its soft limit -1.2")


def test_a_goal_beyond_a_soft_limit_is_refused(shared_data: Path) -> None:
    path = shared_data.parent / "cases" / "reports" / "c10_soft.yaml"
    if not path.is_file():
        pytest.skip(f"no case at {path}")
    with pytest.raises(RequestError, match=r"pan: 2\.5 is outside the joint's limits; expected -1\.2 to 1\.2"):
        plan(load_request(path))


def test_friction_that_a_motor_cannot_overcome_is_named(tmp_path: Path) -> None:
    strong = LIMIT + '<dynamics friction="250" damping="1"/>'
    (note,) = _load(tmp_path, two_links(strong)).notes
    assert note == (
        "joint 'turn': its friction of 250 N m is above its effort limit of 200 N m, so that its motor could not move "
        "it; motions of it are not covered"
    )


def test_friction_and_damping_that_robots_have_are_read_quietly(tmp_path: Path) -> None:
    assert _load(tmp_path, two_links(LIMIT + '<dynamics friction="1.0" damping="10"/>')).notes == ()
    unlimited = '<limit lower="-1" upper="1" velocity="1" effort="0"/><dynamics friction="1.0"/>'
    assert _load(tmp_path, two_links(unlimited)).notes == ()


@pytest.mark.parametrize("word", ["friction", "damping"])
def test_negative_friction_and_damping_are_refused(tmp_path: Path, word: str) -> None:
    with pytest.raises(RobotError, match=r"joint 'turn': dynamics friction .* must not be negative"):
        _load(tmp_path, two_links(LIMIT + f'<dynamics {word}="-1"/>'))


def test_angles_beyond_a_turn_are_named(tmp_path: Path) -> None:
    turned = two_links(LIMIT).replace('rpy="0 0 0"', 'rpy="0 90 0"')
    (note,) = _load(tmp_path, turned).notes
    assert note == "joint 'turn': an origin's rpy of 90 rad is read as it is; are these degrees?"
    assert _load(tmp_path, two_links(LIMIT).replace('rpy="0 0 0"', 'rpy="0 6.2832 -3.15"')).notes == ()
    shape = '<collision><origin rpy="180 0 0"/><geometry><box size="1 1 1"/></geometry></collision></link>'
    text = two_links(LIMIT).replace('<collision><geometry><box size="1 1 1"/></geometry></collision></link>', shape)
    (note,) = _load(tmp_path, text).notes
    assert note == "link 'arm': an origin's rpy of 180 rad is read as it is; are these degrees?"


def _weigh(mass: float, xx: float, yy: float, zz: float) -> str:
    inertia = f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
    return two_links(LIMIT).replace(
        '<link name="arm">', f'<link name="arm"><inertial><mass value="{mass}"/>{inertia}</inertial>'
    )


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (
            _weigh(2.0, 0.01, 0.01, 0.05),
            "link 'arm': no body has its <inertia>, whose largest principal moment exceeds",
        ),
        (_weigh(2.0, 0.0, 0.0, 0.0), "link 'arm': its mass has no moments of inertia; it counts as a point"),
    ],
)
def test_moments_of_inertia_that_no_body_has_are_named(tmp_path: Path, text: str, note: str) -> None:
    (found,) = _load(tmp_path, text).notes
    assert found.startswith(note)


@pytest.mark.parametrize(
    "text",
    [
        _weigh(2.0, 0.01, 0.02, 0.03),  # a flat body
        _weigh(2.0, 0.01, 0.02, 0.0305),  # as many digits as files write
        _weigh(0.1, 0.0, 0.0, 0.0),  # a frame's placeholder
        _weigh(0.0, 0.0, 0.0, 0.0),
    ],
)
def test_moments_of_inertia_of_bodies_are_read_quietly(tmp_path: Path, text: str) -> None:
    assert _load(tmp_path, text).notes == ()


def test_joined_bodies_have_the_mass_of_both_about_their_common_centre() -> None:
    """Two points of 1 and 3 kg, 2 m apart: centre at 1.5 m, 3 kg m^2 about it (reduced mass 0.75 times 4)."""
    points = [LinkInertia(mass, np.array([at, 0.0, 0.0]), np.zeros((3, 3))) for mass, at in ((1.0, 0.0), (3.0, 2.0))]
    both = points[0].join(points[1])
    assert (both.mass, both.centre[0]) == (4.0, 1.5)
    np.testing.assert_allclose(both.moments, np.diag([0.0, 3.0, 3.0]))


@pytest.mark.parametrize(
    ("mass", "moments"),
    [(-1.0, np.eye(3)), (1.0, np.diag([-0.1, 1.0, 1.0])), (1.0, np.triu(np.ones((3, 3)))), (1.0, np.ones((2, 3)))],
)
def test_an_inertia_that_no_body_has_is_an_error_of_one_line(mass: float, moments: np.ndarray) -> None:
    with pytest.raises(RobotError, match=r"^object 'block': .*") as refused:
        LinkInertia(mass, np.zeros(3), moments).make("object 'block'")
    assert "\n" not in str(refused.value)


def test_a_mechanism_s_masses_are_placed_in_the_world() -> None:
    """Two links that a fixed joint joins, on a slide, with the root turned by 90 deg about z and 1 m up."""
    heavy = drawer_urdf().replace('<link name="drawer">', '<link name="drawer">' + inertial(2.0, (0.1, 0, 0), 0.0))
    heavy = heavy.replace('<link name="handle">', '<link name="handle">' + inertial(2.0, (0, 0.2, 0), 0.0))
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = rpy_matrix(np.array([0.0, 0.0, np.pi / 2])), 1.0
    (slide,) = read_mechanism(heavy, "urdf", "mechanism", "fixture", pose, {}, {}).joints
    assert slide.inertia is not None
    assert slide.inertia.mass == 4.0
    # In the root: (0.1, 0, 0.95) and (-0.06, 0.2, 0.95); x becomes y, y becomes -x.
    np.testing.assert_allclose(slide.inertia.centre, [-0.1, 0.02, 1.95], atol=1e-12)
    assert np.trace(slide.inertia.moments) == pytest.approx(2.0 * 1.0 * (0.16**2 + 0.2**2))


def test_a_weight_of_a_mechanism_counts_without_moments_of_inertia() -> None:
    point = '<link name="drawer"><inertial><origin xyz="0.1 0 0"/><mass value="3"/></inertial>'
    found = read_mechanism(
        drawer_urdf().replace('<link name="drawer">', point), "urdf", "mechanism", "fixture", np.eye(4), {}, {}
    )
    assert found.joints[0].inertia is not None
    assert found.joints[0].inertia.mass == 3.0
    np.testing.assert_allclose(found.joints[0].inertia.centre, [0.1, 0.0, 0.95])
    assert found.notes == (
        "link 'drawer': its mass has no moments of inertia; it counts as a point at its centre of mass",
    )


def test_what_a_mechanism_s_file_leaves_open_is_named() -> None:
    request = drawer_request(
        urdf=drawer_urdf()
        .replace("</link>", '<collision><geometry><sphere radius="0"/></geometry></collision></link>', 1)
        .replace('rpy="1.5707963 0 0"', 'rpy="90 0 0"')
        .replace('velocity="0.5" effort="100"', 'velocity="0"')
    )
    notes = prepare(parse_request(request), checks_start=False).notes
    assert [note.removeprefix("task.mechanism.urdf: ") for note in notes if note.startswith("task.mechanism")] == [
        "all velocity limits are 0 (slide), which counts as not stated: 1 rad/s or m/s are used",
        "link 'cupboard': a sphere of size 0 is left out",
        "link 'handle': an origin's rpy of 90 rad is read as it is; are these degrees?",
    ]


def test_a_soft_limit_of_a_mechanism_is_no_stop() -> None:
    soft = drawer_urdf().replace('effort="100"/>', 'effort="100"/>' + _soften(0, 0.3))
    found = read_mechanism(soft, "urdf", "mechanism", "fixture", np.eye(4), {}, {})
    assert found.joints[0].upper == pytest.approx(0.3, abs=2e-3)
    assert found.stops["slide"] == (0.0, 0.4)


def test_an_ordinary_mechanism_has_no_notes() -> None:
    plain = drawer_urdf().replace(' velocity="0.5" effort="100"', "")
    assert prepare(parse_request(drawer_request(urdf=plain)), checks_start=False).notes == ()


def test_a_joint_that_its_file_stops_is_not_moved() -> None:
    turn = (
        f'<link name="knob">{bar(0.05, (0, 0, 0))}</link><joint name="turn" type="revolute"><parent link="handle"/>'
        '<child link="knob"/><origin xyz="0 .1 0"/><axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1"/></joint>'
        "</robot>"
    )
    text = drawer_urdf().replace('velocity="0.5"', 'velocity="0"').replace("</robot>", turn)
    stopped = " (joint 'slide' has a velocity limit of 0: fixed at 0)"
    on_knob = {"handle": {"link": "knob", "place": [0, 0, 0], "axis": [1, 0, 0]}, "joints": {}}
    for changes, problem in (
        ({}, "joints: unknown joint 'slide'; the mechanism has turn"),
        ({"joints": {}}, "handle.link: no joint moves 'handle'; expected a link that moves"),
        (on_knob, "moves[0].joint: unknown joint 'slide'; the mechanism has turn"),
    ):
        with pytest.raises(RequestError) as caught:
            prepare(parse_request(drawer_request(urdf=text, **changes)))
        assert caught.value.problems[0] == f"task.mechanism.{problem}{stopped}"


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('ixx="0.1"', 'ixx="-1"', "link 'drawer': inertia ixx is -1; a moment of inertia is never negative"),
        ('mass value="2"', 'mass value="-2"', "link 'drawer': mass -2 is negative"),
        ('mass value="2"', 'mass value="heavy"', "link 'drawer': mass: 'heavy' is not a number"),
        ('mass value="2"', "mass", "link 'drawer': <mass> lacks value"),
    ],
)
def test_a_mechanism_with_masses_that_nothing_has_is_refused(old: str, new: str, problem: str) -> None:
    heavy = drawer_urdf().replace('<link name="drawer">', '<link name="drawer">' + inertial(2, moments=0.1))
    with pytest.raises(RequestError) as caught:
        prepare(parse_request(drawer_request(urdf=heavy.replace(old, new))))
    assert caught.value.problems[0].startswith(f"task.mechanism.urdf: {problem}")
