"""Problem files through the command line to certified motions, and what becomes of those that cannot be had."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_robots import atlas
from trajopt_problems import ARM_FILES, EXAMPLES, arm, document, straight_rows, term
from typer.testing import CliRunner

from costs.kinematics import KinematicsEngine, locate_frame
from service.cli.app import app
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.start.standing import place_bodies
from service.tasks.trajopt.program import ProgramPhase

ARM = ("--robot", EXAMPLES / "arm7.urdf", "--srdf", EXAMPLES / "arm7.srdf")
TABLE = ("--scene", EXAMPLES / "table.yaml")
GOAL = [0.1, -0.4, 0.0, 0.9, 0.0, -0.2, 0.0]
TABLE_TOP = {"name": "table_top", "type": "box", "size": [0.7, 1.0, 0.04], "position": [0.85, 0.0, 0.85]}


def scopt(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def planned(tmp_path: Path, problem: Path, *arguments: object) -> dict[str, Any]:
    """What ``scopt plan --trajopt`` writes; it must be certified, and certified again when it is read."""
    result = scopt("plan", problem, "--trajopt", *arguments, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["verdict"] == "CERTIFIED"
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    assert (tmp_path / "out" / "viewer.html").is_file()
    return json.loads((tmp_path / "out" / "result.json").read_text())


def of_arm(data: dict[str, Any], **more: Any) -> PlanResult:
    request = {"robot": ARM_FILES, "scene": {"obstacles": [TABLE_TOP]}, "task": {"trajopt": data}, **more}
    return plan(parse_request(request))


def waypoints(result: PlanResult) -> np.ndarray:
    assert result.motion is not None
    return result.motion.curve.positions


def origins(robot: Any, link: str, q: np.ndarray) -> np.ndarray:
    kinematics, (joint, pose) = KinematicsEngine(robot)(q), locate_frame(robot, link)
    return kinematics.rotation[:, joint] @ pose[:3, 3] + kinematics.position[:, joint]


def test_an_arm_goes_around_a_table_to_joint_values(tmp_path: Path) -> None:
    data = planned(tmp_path, EXAMPLES / "arm_around_table.json", *ARM, *TABLE)
    names, rows = data["trajectory"]["joint_names"], data["trajectory"]["positions"]
    assert names == list(arm().joint_names)
    np.testing.assert_allclose(rows[0], [-1.1, 1.1, 0.0, -0.3, 0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(rows[-1], GOAL, atol=1e-9)
    assert len(data["waypoints"]) == 10
    assert data["min_clearance_m"] > 0.02  # dist_pen is 25 mm
    assert data["found_from"] == "init_info"
    assert data["request"]["task"]["trajopt"]["basic_info"]["manip"] == "rightarm"


def test_an_arm_brings_its_tool_to_a_pose_slowly(tmp_path: Path) -> None:
    data = planned(tmp_path, EXAMPLES / "arm_pose.json", *ARM, *TABLE)
    rows = np.array(data["trajectory"]["positions"])[data["waypoints"]]
    places = origins(arm(), "tool", rows)
    np.testing.assert_allclose(places[-1], [0.75, 0.2, 0.95], atol=1e-4)
    assert np.abs(np.diff(places[8:], axis=0)).max() < 0.05 + 1e-4
    targets = data["phases"][0]["targets"]
    assert [(target["kind"], target["frame"]) for target in targets] == [("pose", "tool")]
    assert any("no part of the proof: constraints[1]" in note for note in data["notes"])


def test_atlas_reaches_between_boxes_on_planted_feet(tmp_path: Path) -> None:
    data = planned(tmp_path, EXAMPLES / "atlas_reach.json", "--scene", EXAMPLES / "boxes.yaml")
    names = {check["name"] for check in data["checks"]}
    assert {"balance.trajopt", "planted.trajopt.l_foot", "planted.trajopt.r_foot", "target.trajopt.l_tool"} <= names
    assert data["min_balance_margin_m"] > 0.0
    legs = [data["trajectory"]["joint_names"].index(name) for name in ("l_leg_kny", "r_leg_kny")]
    moved = np.ptp(np.array(data["trajectory"]["positions"])[:, legs], axis=0)
    assert np.all(moved > 1e-3)  # with 36 degrees of freedom the knees help


def test_a_straight_line_begins_at_the_start_that_is_given(tmp_path: Path) -> None:
    init = {"type": "straight_line", "endpoint": [0.5] * 7}
    (tmp_path / "start.yaml").write_text("joints: {elbow_pitch: 0.7, wrist_roll: -1.0}\n")
    data = document(constraints=[term("joint", vals=[0.5])], costs=[term("joint_vel", coeffs=[1])], init=init)
    (tmp_path / "problem.json").write_text(json.dumps(data))
    result = planned(tmp_path, tmp_path / "problem.json", *ARM, "--start", tmp_path / "start.yaml")
    np.testing.assert_allclose(result["trajectory"]["positions"][0], [0, 0, 0, 0.7, 0, 0, -1.0], atol=1e-12)
    np.testing.assert_allclose(result["trajectory"]["positions"][-1], 0.5, atol=1e-12)


def test_the_example_of_the_document_is_certified(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(EXAMPLES.parents[1])
    (example,) = re.findall(r"```python\n(.*?)```", Path("docs/trajopt.md").read_text(), flags=re.DOTALL)
    exec(compile(example, "docs/trajopt.md", "exec"), {})
    assert capsys.readouterr().out == "CERTIFIED init_info\n"


def test_a_glass_stays_upright_between_the_waypoints_too() -> None:
    upright = {"link": "tool", "xyz": [0, 0, 0], "wxyz": [1, 0, 0, 0], "pos_coeffs": [0, 0, 0], "rot_coeffs": [9, 9, 0]}
    there = term("cart_pose", link="tool", xyz=[0.1, 0.75, 1.05], wxyz=[1, 0, 0, 0], rot_coeffs=[0, 0, 0])
    terms = [*(term("cart_pose", timestep=t, **upright) for t in range(1, 3)), there]
    result = of_arm(document(n_steps=3, costs=[term("joint_vel", coeffs=[1])], constraints=terms))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate is not None
    (axis,) = [check for check in result.certificate.checks if check.name.startswith("axis.")]
    assert axis.basis.value == "proof"
    assert axis.value < np.deg2rad(0.5)
    assert "constraints[0] cart_pose and its like at every waypoint are held in between, too" in result.notes


def test_another_start_is_found_where_the_files_own_leads_into_the_table() -> None:
    wide = {**TABLE_TOP, "size": [0.7, 1.4, 0.04]}
    start = dict(zip(arm().joint_names, [-0.9, 1.1, 0, -0.3, 0, 0, 0], strict=True))
    terms = [term("joint_vel", coeffs=[1]), term("collision", coeffs=[20], dist_pen=[0.025])]
    init = {"type": "straight_line", "endpoint": GOAL}
    data = document(n_steps=10, costs=terms, constraints=[term("joint", vals=GOAL)], init=init)
    result = of_arm(data, start={"joints": start}, scene={"obstacles": [wide]})
    assert result.verdict is Verdict.CERTIFIED
    assert result.found_from == "path of LBKPIECE1, tree 1"
    alone = of_arm(data, start={"joints": start}, scene={"obstacles": [wide]}, options={"starts": 1})
    assert alone.verdict is Verdict.NOT_FOUND
    assert any("table_top" in line for line in alone.explanation)


def test_a_motion_whose_start_is_free_begins_at_its_own_first_waypoint() -> None:
    terms = [term("joint_pos", targets=[0.3], first_step=0, last_step=0), term("joint", vals=[0.4] * 7, timestep=4)]
    result = of_arm(document(start_fixed=False, constraints=terms, costs=[term("joint_vel", coeffs=[1])]), scene={})
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    np.testing.assert_allclose(waypoints(result)[0], 0.3)
    np.testing.assert_allclose(result.start, 0.0)


def test_an_arm_of_atlas_moves_alone_and_nothing_is_said_of_balance() -> None:
    there = term("pose", link="l_tool", xyz=[0.5, 0.3, 1.0], wxyz=[1, 0, 0, 0], rot_coeffs=[0, 0, 0])
    data = document("leftarm", 6, costs=[term("joint_vel", coeffs=[1])], constraints=[there])
    result = plan(parse_request({"robot": {"name": "atlas"}, "task": {"trajopt": data}}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    q = waypoints(result)
    moved = {atlas().joint_names[i] for i in np.flatnonzero(np.ptp(q, axis=0))}
    assert moved <= set(atlas().groups["left_arm"])
    assert result.certificate is not None
    assert "not checked: balance in 'trajopt'" in result.certificate.notes


def test_a_goal_in_the_table_or_out_of_reach_is_infeasible() -> None:
    inside = of_arm(document(constraints=[term("joint", vals=[0, 0.2, 0, 0.2, 0, 0, 0])]))
    assert inside.verdict is Verdict.INFEASIBLE
    assert inside.explanation[0].startswith("waypoint 4, which is fixed, is in collision: ")
    far = term("pose", link="tool", xyz=[3, 0, 1], wxyz=[1, 0, 0, 0])
    beyond = of_arm(document(constraints=[far]))
    assert beyond.verdict is Verdict.INFEASIBLE
    assert beyond.explanation[0].startswith("constraints[0]: tool cannot reach")


def test_constraints_that_fight_are_named_by_their_path() -> None:
    near, slow = {"link": "tool", "wxyz": [1, 0, 0, 0], "rot_coeffs": [0, 0, 0]}, {"first_step": 0, "last_step": 4}
    terms = [
        term("pose", xyz=[0.7, 0.5, 1.1], **near),
        term("cart_vel", link="tool", max_displacement=0.01, **slow),
    ]
    result = of_arm(document(constraints=terms), options={"starts": 1})
    assert result.verdict is Verdict.NOT_FOUND
    assert any(line.startswith("constraints[0] pose: position of tool is missed by") for line in result.explanation)
    assert any(line.startswith("constraints[1] cart_vel is missed by") for line in result.explanation)


def test_a_motion_that_breaks_what_no_check_stands_for_is_not_certified() -> None:
    # The verifier would find nothing wrong with the straight line, which is 0.1 m too fast for its steps.
    slow = term("cart_vel", link="tool", max_displacement=1e-3, first_step=0, last_step=4)
    result = of_arm(document(constraints=[term("joint", vals=[0.8, *[0.0] * 6]), slow]), options={"starts": 1})
    assert result.verdict is not Verdict.CERTIFIED
    assert any("cart_vel is missed by" in line for line in result.explanation)


def test_a_phase_solved_anew_keeps_its_steps_and_its_promises() -> None:
    data = json.loads((EXAMPLES / "arm_around_table.json").read_text())
    data["constraints"].append(
        term("joint_pos", targets=[-0.5], coeffs=[1, 0, 0, 0, 0, 0, 0], first_step=5, last_step=5)
    )
    result = of_arm(data)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    phase = _phase_of(data)
    denser = np.repeat(phase.q, 2, axis=0)[:-1]
    denser[1::2] = 0.5 * (phase.q[:-1] + phase.q[1:])
    anew = phase.solve_again(denser)
    assert isinstance(anew, ProgramPhase)
    assert anew.timeline is not None
    assert anew.is_feasible
    np.testing.assert_array_equal(anew.timeline.rows, 2 * np.arange(10))
    assert anew.q[10, 0] == pytest.approx(-0.5)
    s = np.linspace(0.0, 1.0, len(anew.q))
    assert {target.at for target in anew.at_waypoints(s)} == {float(s[10]), 1.0}


def _phase_of(data: dict[str, Any]) -> ProgramPhase:
    """The first phase that a problem's task plans."""
    from scopt import Settings
    from service.body.aims import Aims
    from service.body.monitor import Monitor
    from service.body.phases import PhaseSolver
    from service.body.whole_body import WholeBody
    from service.setup.prepare import prepare
    from service.tasks import plan_task

    request = {"robot": ARM_FILES, "scene": {"obstacles": [TABLE_TOP]}, "task": {"trajopt": data}}
    setup = prepare(parse_request(request))
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
    (phase,) = next(plan_task(setup, PhaseSolver(body, Monitor(60.0), Settings()))).phases
    assert isinstance(phase, ProgramPhase)
    return phase


def test_the_optimum_of_a_small_problem_is_that_of_its_own_costs_alone() -> None:
    # With the middle at m: m^2 / 2 + (1 - m)^2 / 2 + 2 (m - 0.3)^2 is least at m = 2.2 / 6.
    pull = term("joint_pos", targets=[0.3], coeffs=[2], first_step=2, last_step=2)
    data = document(
        "shoulder_yaw",
        costs=[term("joint_vel", coeffs=[1]), pull],
        constraints=[term("joint", vals=[1.0])],
        init={"type": "straight_line", "endpoint": [1.0]},
    )
    data["opt_info"] = {"min_approx_improve": 1e-9, "min_approx_improve_frac": 1e-9}
    result = of_arm(data, scene={})
    assert result.verdict is Verdict.CERTIFIED
    middle = 2.2 / 6.0
    np.testing.assert_allclose(waypoints(result)[:, 0], [0, middle / 2, middle, (1 + middle) / 2, 1], atol=1e-4)


def test_a_demanded_clearance_is_certified_for_problem_files_too() -> None:
    data = document("shoulder_yaw", costs=[term("joint_vel", coeffs=[1])], constraints=[term("joint", vals=[0.3])])
    result = of_arm(data, options={"clearance_m": 0.01})
    assert result.verdict is Verdict.CERTIFIED
    assert result.motion is not None
    assert result.motion.clearance_m == 0.01


def test_an_unknown_pair_is_refused_by_its_path() -> None:
    pair = {"link": "hand", "pair": ["table_top", "tabel_top"], "coeffs": [1], "dist_pen": [0.01]}
    collision = term("collision", coeffs=[1], dist_pen=[0.02], pairs=[pair])
    with pytest.raises(RequestError, match=r"costs\[0\]\.params\.pairs\[0\]\.pair\[1\]: 'tabel_top' is no link"):
        of_arm(document(costs=[collision]))


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"waypoints": 5}, "options.waypoints: basic_info.n_steps says how many; leave it out"),
        ({"feet": ["l_foot"]}, "options.feet: pose constraints and zmp of the problem say what is planted"),
    ],
)
def test_options_that_the_problem_decides_are_refused(options: dict[str, Any], line: str) -> None:
    with pytest.raises(RequestError) as error:
        of_arm(document(), options=options)
    assert error.value.problems[0].startswith(line)


def test_everything_wrong_with_a_problem_is_one_line_each_and_exit_code_3(tmp_path: Path) -> None:
    data = document(costs=[term("joint_vel", coefs=[1])], constraints=[term("joint", vals=[1, 2])])
    data["constraints"].append(term("pose", link="tol", xyz=[1, 0, 1], wxyz=[1, 0, 0, 0]))
    (tmp_path / "problem.json").write_text(json.dumps(data))
    result = scopt("plan", tmp_path / "problem.json", "--trajopt", *ARM, "--out", tmp_path / "out")
    assert result.exit_code == 3
    lines = [line for line in result.stderr.splitlines() if "[" in line]
    assert lines == [
        "costs[0].params.coefs: unknown key; expected coeffs, …",
        "constraints[1].params.link: arm7 has no link 'tol'; expected tool, …",
        "constraints[0].params.vals: 7 numbers are needed (one per degree of freedom of manip), got 2",
    ]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((), "--robot is missing: expected a bundled robot (atlas) or a URDF"),
        (("--robot", "atlass"), "--robot: 'atlass' is neither a bundled robot nor a file; expected atlas"),
        (("--robot", "atlas", "--srdf", "x"), "--srdf and --package-root go with a URDF; atlas brings its own"),
        ((*ARM, "--scene", "nowhere.yaml"), "nowhere.yaml: cannot be read: No such file or directory"),
    ],
)
def test_files_that_do_not_fit_are_one_line(tmp_path: Path, arguments: tuple[object, ...], line: str) -> None:
    (tmp_path / "problem.json").write_text(json.dumps(document()))
    result = scopt("plan", tmp_path / "problem.json", "--trajopt", *arguments, "--out", tmp_path / "out")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1] == line


def test_the_flags_of_problems_go_with_problems_only(tmp_path: Path) -> None:
    result = scopt("plan", tmp_path / "request.yaml", "--robot", "atlas")
    assert result.exit_code == 2
    assert "go with --trajopt" in result.stderr


def test_a_problem_may_stand_in_a_request(tmp_path: Path) -> None:
    init = {"type": "given_traj", "data": straight_rows([0.0] * 7, [0.2] * 7, 3)}
    data = document(n_steps=3, constraints=[term("joint", vals=[0.2])], init=init)
    request = {"robot": ARM_FILES, "task": {"trajopt": data}}
    (tmp_path / "request.yaml").write_text(json.dumps(request))
    result = scopt("plan", tmp_path / "request.yaml", "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.output


def _mistyped(key: str, at: int, letter: str) -> str:
    return key[: at % len(key)] + letter + key[at % len(key) + 1 :]


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pick=st.integers(0, 10**6), at=st.integers(0, 20), letter=st.sampled_from("abcxyz_09 é"))
def test_a_mistyped_key_ends_in_one_line_with_its_path_and_no_traceback(
    tmp_path: Path, pick: int, at: int, letter: str
) -> None:
    data = json.loads((EXAMPLES / "arm_pose.json").read_text())
    owners = [("", data), *((f"{key}.", data[key]) for key in ("basic_info", "init_info"))]
    for section in ("costs", "constraints"):
        for k, each in enumerate(data[section]):
            owners += [(f"{section}[{k}].", each), (f"{section}[{k}].params.", each["params"])]
    path, owner = owners[pick % len(owners)]
    key = sorted(owner)[pick // len(owners) % len(owner)]
    mistyped = _mistyped(key, at, letter)
    if mistyped in owner:
        return
    owner[mistyped] = owner.pop(key)
    (tmp_path / "problem.json").write_text(json.dumps(data))
    result = scopt("plan", tmp_path / "problem.json", "--trajopt", *ARM, *TABLE, "--out", tmp_path / "out")
    assert result.exit_code == 3, result.output
    assert any(line.startswith(f"{path}{mistyped}: unknown key; ") for line in result.stderr.splitlines()), (
        result.stderr
    )
    assert "Traceback" not in result.output


def test_a_fixed_waypoint_nearer_than_the_hulls_resolve_is_told_and_not_infeasible() -> None:
    robot, q = arm(), np.array([0.0, 0.2, 0.0, 0.2, 0.0, 0.0, 0.0])
    tip = max((placed for _, placed in place_bodies(robot, q)), key=lambda placed: placed[:, 0].max())
    x, y, z = tip[tip[:, 0].argmax()]
    ball = {"name": "ball", "type": "sphere", "radius": 10.0, "position": [x + 10.012, y, z]}
    data = document(constraints=[term("joint", vals=q.tolist())])
    start = dict(zip(robot.joint_names, [-1.5, 0.9, 0.0, 0.9, 0.0, 0.0, 0.0], strict=True))
    result = of_arm(data, scene={"obstacles": [ball]}, start={"joints": start})
    assert result.verdict is Verdict.NOT_FOUND
    assert result.explanation[0].startswith("waypoint 4, which is fixed, is too near to plan through: ")
    assert "from ball (obstacle), nearer than the planner's hulls resolve" in result.explanation[0]
