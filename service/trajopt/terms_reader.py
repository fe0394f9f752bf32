"""One reader per type of term: from the keys of the file to data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from service.errors import would_do
from service.trajopt.fields import Fields
from service.trajopt.problem import (
    ONES,
    UPRIGHT,
    ZEROS,
    CartVelTerm,
    CollisionPair,
    CollisionTerm,
    FootHeightTerm,
    JointStepTerm,
    JointTerm,
    PoseTerm,
    Term,
    Vector,
    ZmpTerm,
)

QUATERNION_NORM_TOLERANCE = 1e-3
# Both numberings of the evaluators that files use: SINGLE_TIMESTEP, DISCRETE_CONTINUOUS, CAST_CONTINUOUS (0 to 2) and
# NONE, DISCRETE, LVS_DISCRETE, CONTINUOUS, LVS_CONTINUOUS (0 to 4).  From 2 on, both look between the waypoints.
LAST_EVALUATOR, FIRST_SWEPT_EVALUATOR = 4, 2
QUATERNION_GAIN = 0.5  # the vector part of a quaternion is half of a small turn's angle
CONSTRAINTS_ONLY = {"joint", "joint_vel_limits", "zmp", "foot_height"}


@dataclass(frozen=True)
class TermHead:
    """What is known of a term before its parameters are read.

    Attributes:
        path, name, is_cost: as in ``Term``.
        n_steps: of the problem.
        rate: of its differences, 1 without ``use_time``.
        notes: lines are added for what has no bearing.
    """

    path: str
    name: str
    is_cost: bool
    n_steps: int
    rate: float
    notes: list[str]

    def note(self, key: str, text: str) -> None:
        """Add a note on one parameter."""
        self.notes.append(f"{self.path}.params.{key}: {text}")


Reader = Callable[[TermHead, Fields], Term]


def read_term(fields: Fields, is_cost: bool, n_steps: int, rate: float, notes: list[str]) -> Term | None:
    """The term in an object of ``costs`` or ``constraints``; None where its lines in the findings say why not."""
    before = len(fields.findings)
    kind = fields.text("type")
    name = fields.text("name", kind or "term")
    uses_time = fields.flag("use_time", False)
    if kind not in READERS:
        if kind in NOT_PLANNED:
            fields.refuse(fields.at("type"), f"{kind!r} is not planned with ({NOT_PLANNED[kind]}); leave it out")
        elif kind:
            fields.refuse(fields.at("type"), f"unknown type {kind!r}; expected {would_do(kind, READERS)}")
        fields.has("params")  # which keys it may have, the type alone tells
        fields.close()
        return None
    if is_cost and kind in CONSTRAINTS_ONLY:
        fields.refuse(fields.at("type"), f"{kind} is a constraint only; list it under constraints")
    if uses_time and kind != "joint_vel":
        fields.refuse(fields.at("use_time"), f"{kind} knows no time; joint_vel alone does")
    head = TermHead(fields.path, name, is_cost, n_steps, rate if uses_time else 1.0, notes)
    params = fields.section("params")
    term = READERS[kind](head, params)
    params.close()
    fields.close()
    return term if len(fields.findings) == before else None


def _pose(head: TermHead, params: Fields) -> Term:
    return PoseTerm(
        head.path,
        head.name,
        head.is_cost,
        frame=params.text("link"),
        step=_step(head, params),
        xyz=params.numbers("xyz", length=3),
        wxyz=_quaternion(params, "wxyz"),
        pos_coeffs=_coefficients(params, "pos_coeffs"),
        rot_coeffs=_coefficients(params, "rot_coeffs"),
        turn_gain=QUATERNION_GAIN,
    )


def _cart_pose(head: TermHead, params: Fields) -> Term:
    """Tesseract's, in its earlier wording (link, xyz, tcp_xyz) or its later one (source_frame, target_frame)."""
    frame_key = params.first_of("link", "source_frame")
    is_later = frame_key == "source_frame"
    reference = params.text("target_frame") if is_later else None
    offset, goal = ("source_frame_offset_", "target_frame_offset_") if is_later else ("tcp_", "")
    return PoseTerm(
        head.path,
        head.name,
        head.is_cost,
        frame=params.text(frame_key),
        step=_step(head, params),
        xyz=params.numbers(f"{goal}xyz", ZEROS if is_later else None, length=3),
        wxyz=_quaternion(params, f"{goal}wxyz", UPRIGHT if is_later else None),
        reference=reference,
        offset_xyz=params.numbers(f"{offset}xyz", ZEROS, length=3),
        offset_wxyz=_quaternion(params, f"{offset}wxyz", UPRIGHT),
        pos_coeffs=_coefficients(params, "pos_coeffs"),
        rot_coeffs=_coefficients(params, "rot_coeffs"),
        frame_key=frame_key,
    )


def _dynamic_cart_pose(head: TermHead, params: Fields) -> Term:
    frame_key = params.first_of("link", "source_frame")
    reference_key = params.first_of("target", "target_frame")
    offset = "source_frame_offset_" if frame_key == "source_frame" else "tcp_"
    goal = "target_frame_offset_" if reference_key == "target_frame" else "target_tcp_"
    return PoseTerm(
        head.path,
        head.name,
        head.is_cost,
        frame=params.text(frame_key),
        step=_step(head, params),
        xyz=params.numbers(f"{goal}xyz", ZEROS, length=3),
        wxyz=_quaternion(params, f"{goal}wxyz", UPRIGHT),
        reference=params.text(reference_key),
        offset_xyz=params.numbers(f"{offset}xyz", ZEROS, length=3),
        offset_wxyz=_quaternion(params, f"{offset}wxyz", UPRIGHT),
        pos_coeffs=_coefficients(params, "pos_coeffs"),
        rot_coeffs=_coefficients(params, "rot_coeffs"),
        frame_key=frame_key,
        reference_key=reference_key,
    )


def _joint(head: TermHead, params: Fields) -> Term:
    return _joint_values(head, params, default_range="last", coeffs=ONES[:1])


def _joint_pos(head: TermHead, params: Fields) -> Term:
    """The original's speaks of one waypoint (the last by default), tesseract's of a range (all by default)."""
    if params.has("vals"):
        return _joint_values(head, params, default_range="last", coeffs=None if head.is_cost else ONES[:1])
    return _joint_values(head, params, default_range="all", coeffs=ONES[:1])


def _joint_values(head: TermHead, params: Fields, default_range: str, coeffs: Vector | None) -> Term:
    key = params.first_of("vals", "targets", "targs")
    if params.has("timestep"):
        first = last = _step(head, params)
        for other in ("first_step", "last_step"):
            if params.has(other):
                params.refuse(params.at(other), "timestep says which waypoint; leave one of them out")
    else:
        first, last = _range(head, params, 0 if default_range == "all" else head.n_steps - 1)
    return JointTerm(
        head.path,
        head.name,
        head.is_cost,
        order=0,
        targets=params.numbers(key),
        coeffs=params.numbers("coeffs", coeffs, least=0.0),
        lower_tols=_lower_tolerances(params),
        upper_tols=params.numbers("upper_tols", ZEROS[:1], least=0.0),
        first=first,
        last=last,
        targets_key=key,
    )


def _joint_rate(order: int) -> Reader:
    def read(head: TermHead, params: Fields) -> Term:
        key = params.first_of("targets", "targs")
        first, last = _range(head, params, 0)
        if params.has("use_time"):
            params.flag("use_time", False)
            head.note("use_time", "counts beside type only, as in the original")
        if head.n_steps <= order:
            params.refuse(head.path, f"{order + 1} waypoints are needed, n_steps is {head.n_steps}")
        if last - first < order:  # as tesseract does: as many waypoints as one difference needs
            last = min(first + order, head.n_steps - 1)
            first = max(last - order, 0)
        return JointTerm(
            head.path,
            head.name,
            head.is_cost,
            order=order,
            targets=params.numbers(key, ZEROS[:1]),
            coeffs=params.numbers("coeffs", ONES[:1], least=0.0),
            lower_tols=_lower_tolerances(params),
            upper_tols=params.numbers("upper_tols", ZEROS[:1], least=0.0),
            first=first,
            last=last,
            rate=head.rate,
            targets_key=key,
        )

    return read


def _lower_tolerances(params: Fields) -> Vector:
    lower = params.numbers("lower_tols", ZEROS[:1])
    if any(value > 0.0 for value in lower):
        params.refuse(params.at("lower_tols"), "expected at most 0: how far below its target a value may lie, negative")
    return lower


def _joint_vel_limits(head: TermHead, params: Fields) -> Term:
    first, last = _range(head, params, 0)
    return JointStepTerm(head.path, head.name, head.is_cost, params.numbers("vals", least=0.0), first, last)


def _cart_vel(head: TermHead, params: Fields) -> Term:
    first = params.whole("first_step", least=0, most=head.n_steps - 2)
    last = params.whole("last_step", least=first + 1, most=head.n_steps - 1)
    limit = params.number("max_displacement", least=0.0)
    return CartVelTerm(head.path, head.name, head.is_cost, params.text("link"), first, last, limit)


def _collision(head: TermHead, params: Fields) -> Term:
    first, last = _range(head, params, 0)
    count = last - first + 1
    if params.first_of("continuous", "evaluator_type") == "evaluator_type":
        is_swept = params.whole("evaluator_type", least=0, most=LAST_EVALUATOR) >= FIRST_SWEPT_EVALUATOR
    else:
        is_swept = params.flag("continuous", True)
    gap = params.whole("gap", 1, least=0)
    if gap > 1:
        params.refuse(params.at("gap"), f"{gap} is not planned with; expected 1 (from waypoint to waypoint)")
    for key, text in _COLLISION_ASIDES.items():
        if params.has(key):
            head.note(key, text)
    return CollisionTerm(
        head.path,
        head.name,
        head.is_cost,
        is_swept=is_swept and gap > 0 and count > 1,
        first=first,
        last=last,
        coeffs=_per_step(params, "coeffs", count, least=0.0),
        dist_pen=_per_step(params, "dist_pen", count),
        pairs=tuple(_collision_pair(pair, count) for pair in params.sections("pairs")),
    )


def _collision_pair(fields: Fields, count: int) -> CollisionPair:
    pair = CollisionPair(
        fields.path,
        fields.text("link"),
        fields.texts("pair"),
        _per_step(fields, "coeffs", count, least=0.0),
        _per_step(fields, "dist_pen", count),
    )
    fields.close()
    return pair


def _zmp(head: TermHead, params: Fields) -> Term:
    return ZmpTerm(head.path, head.name, head.is_cost, _required_step(head, params), params.texts("planted_links"))


def _foot_height(head: TermHead, params: Fields) -> Term:
    step = _required_step(head, params)
    return FootHeightTerm(head.path, head.name, head.is_cost, step, params.text("link"), params.number("height"))


def _step(head: TermHead, params: Fields) -> int:
    last = head.n_steps - 1
    step = params.whole("timestep", last, least=-1, most=last)
    return last if step < 0 else step


def _required_step(head: TermHead, params: Fields) -> int:
    return params.whole("timestep", least=0, most=head.n_steps - 1)


def _range(head: TermHead, params: Fields, first_by_default: int) -> tuple[int, int]:
    """First and last waypoint, inclusive; a last one of -1 is the last of all."""
    end = head.n_steps - 1
    first = params.whole("first_step", first_by_default, least=0, most=end)
    last = params.whole("last_step", end, least=-1, most=end)
    last = end if last < 0 else last
    if last < first:
        params.refuse(params.at("last_step"), f"{last} is before first_step, {first}")
        return first, first
    return first, last


def _per_step(fields: Fields, key: str, count: int, least: float = -1.0) -> Vector:
    values = fields.numbers(key, least=least)
    if values and len(values) not in (1, count):
        fields.refuse(fields.at(key), f"1 number or {count} (one per waypoint) are needed, got {len(values)}")
    return values


def _coefficients(params: Fields, key: str) -> Vector:
    return params.numbers(key, ONES, length=3, least=0.0)


def _quaternion(params: Fields, key: str, fallback: Vector | None = None) -> Vector:
    values = params.numbers(key, fallback, length=4)
    norm = math.hypot(*values)
    if len(values) != 4:
        return UPRIGHT
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        params.refuse(params.at(key), f"a quaternion (w, x, y, z) needs length 1, not {norm:.6g}")
        return UPRIGHT
    return tuple(value / norm for value in values)


_COLLISION_ASIDES: Mapping[str, str] = {
    "fixed_steps": "waypoints that are fixed are known from basic_info",
    "longest_valid_segment_length": "the swept hull is looked at as a whole, however long the step",
    "safety_margin_buffer": "contacts are looked for as far as a step may bring them",
    "contact_test_type": "every pair has one contact, the nearest",
    "use_weighted_sum": "every pair has one contact, the nearest",
}
READERS: Mapping[str, Reader] = {
    "pose": _pose,
    "cart_pose": _cart_pose,
    "dynamic_cart_pose": _dynamic_cart_pose,
    "joint": _joint,
    "joint_pos": _joint_pos,
    "joint_vel": _joint_rate(1),
    "joint_acc": _joint_rate(2),
    "joint_jerk": _joint_rate(3),
    "joint_vel_limits": _joint_vel_limits,
    "cart_vel": _cart_vel,
    "collision": _collision,
    "zmp": _zmp,
    "foot_height": _foot_height,
}
NOT_PLANNED: Mapping[str, str] = {
    "total_time": "the motion is timed afterwards, as fast as the robot's limits and its balance allow",
    "static_torque": "joint torques are checked along the timed motion instead",
    "potential_energy": "the original sums heights without masses",
}
