"""Reader of a whole problem file; collects all findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from service.trajopt.json_fields import Fields
from service.trajopt.problem import (
    ZEROS,
    BasicInfo,
    CollisionTerm,
    FootHeightTerm,
    InitInfo,
    JointTerm,
    OptInfo,
    PoseTerm,
    ProblemFile,
    Term,
    ZmpTerm,
)
from service.trajopt.terms_reader import read_term

MOST_STEPS = 500
IK_STEPS = 8  # waypoints of the way to the configuration of a problem with one step
WAY_WEIGHT = (1e-3,)  # of the displacement on that way
UNKNOWN_STEPS = 10**9  # replaces an invalid number of waypoints: then no step is out of range
INIT_KINDS: Mapping[str, Literal["stationary", "straight_line", "given_traj"]] = {
    "stationary": "stationary",
    "straight_line": "straight_line",
    "joint_interpolated": "straight_line",
    "given_traj": "given_traj",
}
# Name in the file, name here, least and greatest value.
OPT_KEYS: tuple[tuple[str, str, float, float], ...] = (
    ("improve_ratio_threshold", "accept_ratio", 0.0, 1.0),
    ("min_trust_box_size", "min_trust_radius", 1e-12, 10.0),
    ("min_approx_improve", "min_improvement", 0.0, 1e9),
    ("min_approx_improve_frac", "min_improvement_fraction", 0.0, 1.0),
    ("trust_shrink_ratio", "shrink", 1e-3, 0.999),
    ("trust_expand_ratio", "expand", 1.0, 100.0),
    ("merit_coeff_increase_ratio", "penalty_factor", 1.001, 1e6),
    ("trust_box_size", "trust_radius", 1e-6, 100.0),
    ("merit_error_coeff", "penalty", 1e-6, 1e9),
    ("initial_merit_error_coeff", "penalty", 1e-6, 1e9),
)


@dataclass(frozen=True)
class Reading:
    """Problem of a document, or as much of it as could be read.

    Attributes:
        problem: with the readable terms only; None if ``basic_info`` or ``init_info`` is invalid.
        findings: one line per error of the document.
    """

    problem: ProblemFile | None
    findings: tuple[str, ...]


def read_problem(document: object) -> Reading:
    """Read a document of plain mappings, lists and scalars; errors become findings."""
    findings: list[str] = []
    notes: list[str] = []
    root = Fields(document, "", findings)
    basic = _basic_info(root.section("basic_info"), notes)
    is_basic_sound = not findings
    n_steps = basic.n_steps if is_basic_sound else UNKNOWN_STEPS
    before = len(findings)
    init = _init_info(root.section("init_info"), n_steps)
    is_sound = is_basic_sound and len(findings) == before
    opt = _opt_info(root.section("opt_info", is_required=False), notes)
    terms: list[Term] = []
    for key, is_cost in (("costs", True), ("constraints", False)):
        for fields in root.sections(key):
            term = read_term(fields, is_cost, n_steps, init.rate, notes)
            if term is not None:
                terms.append(term)
    root.close()
    problem = ProblemFile(basic, init, opt, tuple(terms), tuple(notes)) if is_sound else None
    if problem is not None and n_steps == 1:
        problem = _lead_to_configuration(problem, findings)
    return Reading(problem, tuple(findings))


def _lead_to_configuration(problem: ProblemFile, findings: list[str]) -> ProblemFile:
    """Return a problem whose motion leads from the robot's start to the configuration of a problem with one step.

    The file's configuration is the last waypoint: its terms hold there, and its initial value is only a guess.
    """
    basic, init = problem.basic, problem.init
    if basic.fixed_steps or basic.is_step_fixed:
        findings.append("basic_info.fixed_timesteps: n_steps is 1, and its only waypoint is fixed; leave it out")
    last = IK_STEPS - 1
    if init.data:
        init = replace(init, kind="straight_line", endpoint=init.data[0], data=())
    way = JointTerm("basic_info.n_steps", "way", True, 1, ZEROS[:1], WAY_WEIGHT, ZEROS[:1], ZEROS[:1], 0, last)
    note = (
        "basic_info: n_steps is 1, which is inverse kinematics; the motion leads from the start to the configuration, "
        "at which all terms hold"
    )
    return replace(
        problem,
        basic=replace(basic, n_steps=IK_STEPS, is_start_fixed=True),
        init=init,
        terms=(*(_move_term(term, last) for term in problem.terms), way),
        notes=(*problem.notes, note),
    )


def _move_term(term: Term, step: int) -> Term:
    """Return a term of the only step at another one."""
    if isinstance(term, PoseTerm | ZmpTerm | FootHeightTerm):
        return replace(term, step=step)
    if isinstance(term, JointTerm | CollisionTerm):
        return replace(term, first=step, last=step)
    return term


def read_robot_name(document: Mapping[str, Any]) -> str:
    """Return the robot that a document names, or ""."""
    basic = document.get("basic_info")
    name = basic.get("robot", "") if isinstance(basic, Mapping) else ""
    return name if isinstance(name, str) else ""


def _basic_info(fields: Fields, notes: list[str]) -> BasicInfo:
    n_steps = fields.whole("n_steps", least=1, most=MOST_STEPS)
    manip = fields.text("manip")
    steps = fields.wholes("fixed_timesteps", 0, n_steps - 1)
    # A file that lists its fixed waypoints fixes the first one only if it is among them.
    is_start_fixed = fields.flag("start_fixed", not fields.has("fixed_timesteps"))
    dofs_key = fields.first_of("dofs_fixed", "fixed_dofs")
    dofs = fields.wholes(dofs_key, 0, 10**6)
    robot = fields.text("robot", "")
    if fields.has("convex_solver"):
        fields.text("convex_solver")
        notes.append("basic_info.convex_solver: options.qp of a request chooses the solver here")
    _time(fields, notes)
    fields.close()
    is_start_fixed = is_start_fixed or 0 in steps
    others = tuple(sorted(set(steps) - {0}))
    return BasicInfo(n_steps, manip, is_start_fixed, robot, dofs, others, dofs_key, is_step_fixed=0 in steps)


def _time(fields: Fields, notes: list[str]) -> None:
    """Check the keys about time; they have no effect, since time is no variable here."""
    lower = fields.number("dt_lower_lim", 1.0, least=1e-9)
    upper = fields.number("dt_upper_lim", max(lower, 1.0), least=1e-9)
    if upper < lower:
        fields.refuse(fields.at("dt_upper_lim"), f"{upper:g} is below dt_lower_lim, {lower:g}")
    if fields.flag("use_time", False) or fields.has("dt_lower_lim") or fields.has("dt_upper_lim"):
        notes.append(
            "basic_info: time is no variable here; terms with use_time use init_info.dt, and the motion is "
            "timed afterwards within the robot's limits"
        )


def _init_info(fields: Fields, n_steps: int) -> InitInfo:
    kind = fields.choice("type", INIT_KINDS)
    rate = fields.number("dt", 1.0, least=1e-9)
    endpoint = fields.numbers("endpoint") if kind in ("straight_line", "joint_interpolated") else ()
    data = fields.rows("data") if kind == "given_traj" else ()
    if kind == "given_traj" and n_steps != UNKNOWN_STEPS and fields.has("data") and len(data) != n_steps:
        fields.refuse(fields.at("data"), f"{n_steps} rows are needed (n_steps), got {len(data)}")
    fields.close()
    return InitInfo(INIT_KINDS[kind or "stationary"], endpoint, data, rate)


def _opt_info(fields: Fields, notes: list[str]) -> OptInfo:
    settings: dict[str, float] = {}
    for key, name, least, most in OPT_KEYS:
        if fields.has(key):
            settings[name] = fields.number(key, least=least, most=most)
    raises = fields.whole("max_merit_coeff_increases", 5, least=0, most=100)
    if fields.has("max_merit_coeff_increases"):
        settings["max_penalty_raises"] = raises
    if fields.has("max_iter"):  # TrajOpt counts per penalty value, scopt in all
        settings["max_iterations"] = fields.whole("max_iter", least=1, most=100_000) * (raises + 1)
    if fields.has("max_time"):
        fields.number("max_time", least=0.0)
        notes.append("opt_info.max_time: the time limit is that of the whole plan (--time-limit)")
    if fields.has("inflate_constraints_individually"):
        fields.flag("inflate_constraints_individually", True)
        notes.append("opt_info.inflate_constraints_individually: all constraints share one penalty")
    tolerance = fields.number("cnt_tolerance", 1e-4, least=1e-9, most=0.1)
    fields.close()
    return OptInfo(settings, tolerance)
