"""Reading TrajOpt's problem files: both dialects, defaults, and one line with its JSON path for everything wrong."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import RequestError
from service.trajopt.json_fields import parse_document, read_document
from service.trajopt.problem import (
    CartVelTerm,
    CollisionTerm,
    FootHeightTerm,
    JointStepTerm,
    JointTerm,
    PoseTerm,
    ProblemFile,
    ZmpTerm,
)
from service.trajopt.reader import read_problem

EXAMPLES = Path(__file__).parents[2] / "examples" / "trajopt"

# One of everything, in the words of both families of files.
WHOLE: dict[str, Any] = {
    "basic_info": {
        "n_steps": 5,
        "manip": "right_arm",
        "robot": "arm",
        "fixed_timesteps": [0],
        "fixed_dofs": [6],
        "convex_solver": "AUTO_SOLVER",
        "dt_lower_lim": 0.5,
        "dt_upper_lim": 2.0,
        "use_time": "FALSE",
    },
    "opt_info": {
        "max_iter": 30,
        "max_merit_coeff_increases": 2,
        "trust_box_size": 0.2,
        "initial_merit_error_coeff": 50,
        "cnt_tolerance": 1e-3,
        "max_time": 10,
    },
    "costs": [
        {"type": "joint_vel", "name": "smooth", "use_time": True, "params": {"coeffs": [1, 2, 3, 4, 5, 6, 7]}},
        {
            "type": "joint_acc",
            "params": {"targets": [0], "upper_tols": [0.2], "lower_tols": [-0.1], "first_step": 1, "last_step": 4},
        },
        {"type": "joint_pos", "params": {"vals": [1, 2, 3, 4, 5, 6, 7], "coeffs": [0.5], "timestep": 2}},
        {"type": "joint_pos", "params": {"targs": [0.1]}},
        {
            "type": "collision",
            "params": {
                "coeffs": 20,
                "dist_pen": 0.025,
                "evaluator_type": 4,
                "longest_valid_segment_length": 0.05,
                "pairs": [{"link": "hand", "pair": ["table"], "coeffs": [10], "dist_pen": [0.01]}],
            },
        },
        {
            "type": "dynamic_cart_pose",
            "params": {"link": "hand", "target": "forearm", "target_tcp_xyz": [0, 0, 0.1], "tcp_wxyz": [0, 1, 0, 0]},
        },
    ],
    "constraints": [
        {"type": "pose", "params": {"link": "hand", "xyz": [1, 2, 3], "wxyz": [1, 0, 0, 0], "rot_coeffs": [0, 0, 1]}},
        {
            "type": "cart_pose",
            "params": {
                "source_frame": "hand",
                "target_frame": "world",
                "target_frame_offset_xyz": [1, 0, 0],
                "target_frame_offset_wxyz": [0, 0, 1, 0],
                "source_frame_offset_xyz": [0, 0, 0.2],
                "timestep": 3,
            },
        },
        {"type": "joint", "params": {"vals": [0, 0, 0, 0, 0, 0, 0]}},
        {"type": "joint_vel_limits", "params": {"vals": [0.5], "first_step": 1}},
        {"type": "cart_vel", "params": {"link": "hand", "first_step": 0, "last_step": 4, "max_displacement": 0.05}},
        {"type": "collision", "params": {"coeffs": [1], "dist_pen": [0.01], "continuous": False, "last_step": 3}},
        {"type": "zmp", "params": {"timestep": 4, "planted_links": ["hand"]}},
        {"type": "foot_height", "params": {"timestep": 2, "link": "hand", "height": 0.05}},
    ],
    "init_info": {"type": "joint_interpolated", "endpoint": [0, 0, 0, 0, 0, 0, 0], "dt": 4.0},
}


def read(document: object) -> ProblemFile:
    reading = read_problem(document)
    assert reading.findings == ()
    assert reading.problem is not None
    return reading.problem


def changed(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """A copy of the whole document with one entry replaced; ``...`` removes it."""
    document = copy.deepcopy(WHOLE)
    at: Any = document
    for step in path[:-1]:
        at = at[step]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return document


def small(**terms: list[dict[str, Any]]) -> dict[str, Any]:
    return {"basic_info": {"n_steps": 6, "manip": "arm"}, "init_info": {"type": "STATIONARY"}, **terms}


def test_the_sections_of_both_families_are_read() -> None:
    problem = read(WHOLE)
    basic, opt, init = problem.basic, problem.opt, problem.init
    assert (basic.n_steps, basic.manip, basic.robot, basic.fixed_dofs) == (5, "right_arm", "arm", (6,))
    assert basic.is_start_fixed  # waypoint 0 is among fixed_timesteps
    assert basic.fixed_steps == ()
    assert opt.tolerance == 1e-3
    expected = {"trust_radius": 0.2, "penalty": 50.0, "max_penalty_raises": 2, "max_iterations": 90}
    assert opt.settings == expected  # 30 steps for each of three penalties
    assert (init.kind, init.rate) == ("straight_line", 4.0)
    assert [note.split(":")[0] for note in problem.notes] == [
        "basic_info.convex_solver",
        "basic_info",
        "opt_info.max_time",
        "costs[4].params.longest_valid_segment_length",
    ]


def test_every_type_of_term_is_read_with_its_defaults() -> None:
    vel, acc, original_pos, later_pos, collision, relative, pose, cart, joint, steps, cart_vel, apart, zmp, foot = read(
        WHOLE
    ).terms
    assert isinstance(vel, JointTerm)
    assert (vel.order, vel.name, vel.first, vel.last, vel.rate, vel.targets) == (1, "smooth", 0, 4, 4.0, (0.0,))
    assert isinstance(acc, JointTerm)
    assert (acc.order, acc.first, acc.last, acc.lower_tols, acc.upper_tols) == (2, 1, 4, (-0.1,), (0.2,))
    assert isinstance(original_pos, JointTerm)
    assert (original_pos.first, original_pos.last, original_pos.coeffs) == (2, 2, (0.5,))
    assert isinstance(later_pos, JointTerm)
    assert (later_pos.first, later_pos.last, later_pos.coeffs) == (0, 4, (1.0,))
    assert isinstance(collision, CollisionTerm)
    assert collision.is_swept
    assert (collision.coeffs, collision.dist_pen, collision.pairs[0].others) == ((20.0,), (0.025,), ("table",))
    assert isinstance(relative, PoseTerm)
    assert (relative.reference, relative.xyz, relative.offset_wxyz) == ("forearm", (0, 0, 0.1), (0, 1, 0, 0))
    assert isinstance(pose, PoseTerm)
    assert (pose.step, pose.pos_coeffs, pose.rot_coeffs, pose.turn_gain) == (4, (1, 1, 1), (0, 0, 1), 0.5)
    assert isinstance(cart, PoseTerm)
    assert (cart.step, cart.xyz, cart.offset_xyz, cart.turn_gain) == (3, (1, 0, 0), (0, 0, 0.2), 1.0)
    assert isinstance(joint, JointTerm)
    assert (joint.order, joint.first, joint.last, joint.is_cost) == (0, 4, 4, False)
    assert isinstance(steps, JointStepTerm)
    assert (steps.vals, steps.first, steps.last) == ((0.5,), 1, 4)
    assert isinstance(cart_vel, CartVelTerm)
    assert cart_vel.limit == 0.05
    assert isinstance(apart, CollisionTerm)
    assert (apart.is_swept, apart.first, apart.last) == (False, 0, 3)
    assert isinstance(zmp, ZmpTerm)
    assert (zmp.step, zmp.links) == (4, ("hand",))
    assert isinstance(foot, FootHeightTerm)
    assert (foot.step, foot.height) == (2, 0.05)


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.json")))
def test_the_example_problems_are_read(name: str) -> None:
    assert read(read_document(EXAMPLES / name)).terms


def test_a_start_is_fixed_unless_the_file_says_otherwise() -> None:
    assert read(small()).basic.is_start_fixed
    listed = small()
    listed["basic_info"]["fixed_timesteps"] = [5]
    assert not read(listed).basic.is_start_fixed
    assert read(listed).basic.fixed_steps == (5,)


@pytest.mark.parametrize(("evaluator", "is_swept"), [(0, False), (1, False), (2, True), (3, True), (4, True)])
def test_evaluators_of_either_numbering_look_between_the_waypoints_or_not(evaluator: int, is_swept: bool) -> None:
    params = {"coeffs": [1], "dist_pen": [0.02], "evaluator_type": evaluator}
    (term,) = read(small(costs=[{"type": "collision", "params": params}])).terms
    assert isinstance(term, CollisionTerm)
    assert term.is_swept is is_swept


@pytest.mark.parametrize(
    ("document", "line"),
    [
        (changed(("costs", 0, "params", "coefs"), [1]), "costs[0].params.coefs: unknown key; expected coeffs, …"),
        (changed(("basic_info", "n_step"), 5), "basic_info.n_step: unknown key; expected n_steps, …"),
        (
            changed(("constraint",), []),
            "constraint: unknown key; expected basic_info, init_info",
        ),
        (
            changed(("init_info", "type"), "stationery"),
            "init_info.type: unknown type 'stationery'; expected",
        ),
        (changed(("costs", 4, "type"), "colision"), "costs[4].type: unknown type 'colision'; expected collision, …"),
        (
            changed(("constraints", 6, "params", "timestep"), 5),
            "constraints[6].params.timestep: expected 0 to 4, got 5",
        ),
        (changed(("constraints", 6, "params", "timestep"), ...), "constraints[6].params.timestep: is missing"),
        (changed(("constraints", 4, "params"), ...), "constraints[4].params: is missing"),
        (
            changed(("constraints", 0, "params", "xyz"), [1, 2]),
            "constraints[0].params.xyz: 3 numbers are needed, got 2",
        ),
        (changed(("constraints", 0, "params", "wxyz"), [1, 1, 0, 0]), "constraints[0].params.wxyz: a quaternion (w, x"),
        (changed(("constraints", 0, "params", "xyz", 1), "2"), "constraints[0].params.xyz[1]: a number is needed, got"),
        (changed(("costs", 0, "params", "coeffs", 3), -1), "costs[0].params.coeffs[3]: expected at least 0, got -1"),
        (changed(("costs", 0, "use_time"), "maybe"), "costs[0].use_time: true or false is needed, got 'maybe'"),
        (changed(("costs", 4, "params", "gap"), 2), "costs[4].params.gap: 2 is not planned with; expected 1"),
        (changed(("costs", 4, "params", "dist_pen"), [0.1, 0.2]), "costs[4].params.dist_pen: 1 number or 5 (one per"),
        (changed(("costs", 4, "params", "continuous"), True), "costs[4].params.evaluator_type: says the same as"),
        (changed(("costs", 4, "params", "pairs", 0, "dist_pem"), 0), "costs[4].params.pairs[0].dist_pem: unknown key"),
        (changed(("costs", 2, "params", "targets"), [0]), "costs[2].params.targets: says the same as vals; leave one"),
        (changed(("costs", 1, "params", "lower_tols"), [0.1]), "costs[1].params.lower_tols: expected at most 0"),
        (changed(("costs", 0, "type"), "zmp"), "costs[0].type: zmp is a constraint only; list it under constraints"),
        (changed(("costs", 0, "type"), "total_time"), "costs[0].type: 'total_time' is not planned with"),
        (
            changed(("costs", 1, "use_time"), True),
            "costs[1].use_time: joint_acc does not use time; only joint_vel does",
        ),
        (changed(("costs", 1, "params", "last_step"), 0), "costs[1].params.last_step: 0 is before first_step, 1"),
        (changed(("basic_info", "n_steps"), 0), "basic_info.n_steps: expected 1 to 500, got 0"),
        (changed(("basic_info", "n_steps"), 5.0), "basic_info.n_steps: a whole number is needed, got 5.0"),
        (changed(("basic_info", "dt_upper_lim"), 0.1), "basic_info.dt_upper_lim: 0.1 is below dt_lower_lim, 0.5"),
        (changed(("basic_info",), ...), "basic_info: is missing"),
        (changed(("costs",), {}), "costs: a list of objects is needed, got {}"),
        (changed(("opt_info", "trust_box_size"), 0), "opt_info.trust_box_size: expected 1e-06 to 100, got 0"),
        ([], "the document: an object is needed, got []"),
    ],
)
def test_what_is_wrong_is_said_with_its_path(document: object, line: str) -> None:
    assert any(finding.startswith(line) for finding in read_problem(document).findings), read_problem(document).findings


def test_everything_wrong_is_told_at_once() -> None:
    document = changed(("costs", 0, "params", "coefs"), [1])
    document["constraints"][4]["params"]["link"] = 3
    document["init_info"]["kind"] = "x"
    del document["basic_info"]["manip"]
    assert [finding.split(":")[0] for finding in read_problem(document).findings] == [
        "basic_info.manip",
        "init_info.kind",
        "costs[0].params.coefs",
        "constraints[4].params.link",
    ]


def test_what_can_be_read_is_read_besides_what_is_wrong() -> None:
    reading = read_problem(changed(("costs", 0, "params", "coefs"), [1]))
    assert reading.problem is not None
    assert [each.path for each in reading.problem.terms] == [
        *(f"costs[{k}]" for k in range(1, 6)),
        *(f"constraints[{k}]" for k in range(8)),
    ]
    assert read_problem(changed(("basic_info", "n_steps"), 0)).problem is None
    assert read_problem(changed(("init_info", "type"), "x")).problem is None


def test_rows_of_a_trajectory_are_as_many_as_the_steps() -> None:
    document = small()
    document["init_info"] = {"type": "given_traj", "data": [[0.0], [1.0]]}
    assert read_problem(document).findings == ("init_info.data: 6 rows are needed (n_steps), got 2",)


def key_paths(data: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of all keys of all objects."""
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, value in entries:
        if isinstance(step, str):
            yield (*path, step)
        yield from key_paths(value, (*path, step))


def shown_path(path: tuple[str | int, ...]) -> str:
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


PATHS = sorted(key_paths(WHOLE), key=str)
SWAPS = st.integers(0, 30).flatmap(lambda k: st.tuples(st.just(k), st.characters(codec="ascii")))


@given(path=st.sampled_from(PATHS), swap=SWAPS, keeps=st.booleans())
def test_a_mistyped_key_is_always_refused_by_its_path(
    path: tuple[str | int, ...], swap: tuple[int, str], keeps: bool
) -> None:
    key = str(path[-1])
    at, letter = swap[0] % len(key), swap[1]
    mistyped = key[:at] + letter + key[at + 1 :] if keeps else key[:at] + key[at + 1 :]
    document = copy.deepcopy(WHOLE)
    owner: Any = document
    for step in path[:-1]:
        owner = owner[step]
    if mistyped in owner:
        return
    owner[mistyped] = owner.pop(key)
    findings = read_problem(document).findings
    where = shown_path((*path[:-1], mistyped)) if mistyped.isprintable() else shown_path(path[:-1])
    assert any(finding.startswith(where) and "unknown key" in finding for finding in findings), findings


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(path=st.sampled_from(PATHS), value=JSON)
def test_any_value_anywhere_is_read_or_refused_by_its_path(path: tuple[str | int, ...], value: object) -> None:
    document = changed(path, value)
    reading = read_problem(document)
    for finding in reading.findings:
        assert "\n" not in finding
        assert finding.split(":")[0].split(".")[0].split("[")[0] in {*WHOLE, "the document"}
    if not reading.findings:
        assert reading.problem is not None


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('{"a": 1,}', "p.json: line 1: no valid JSON"),
        ('{"a": 1, "a": 2}', "p.json: key 'a' is given twice"),
        ('{"a": NaN}', "p.json: NaN is no number that JSON has"),
        ("[1]", "p.json: an object is needed, got [1]"),
        ('{"a":' + "[" * 50 + "]" * 50 + "}", "p.json: nested deeper than 20 levels"),
        ("[" * 100_000, "p.json: "),
        ("", "p.json: line 1: no valid JSON"),
    ],
)
def test_a_text_that_is_no_problem_is_refused_in_one_line(text: str, line: str) -> None:
    with pytest.raises(RequestError) as error:
        parse_document(text, "p.json")
    (problem,) = error.value.problems
    assert problem.startswith(line)


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"is not a file; a TrajOpt problem \(JSON\) is needed"):
        read_document(tmp_path)
    (tmp_path / "p.json").write_bytes(b"\xff\xfe{}")
    with pytest.raises(RequestError, match=r"p\.json: is no UTF-8 text"):
        read_document(tmp_path / "p.json")
    (tmp_path / "p.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(small()).encode())
    assert read(read_document(tmp_path / "p.json")).basic.manip == "arm"
