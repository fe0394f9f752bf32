"""Readers of the costs and constraints of a problem file, one per type."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from service.errors import would_do
from service.trajopt.json_fields import Fields
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
# Files number the evaluators in two ways: SINGLE_TIMESTEP, DISCRETE_CONTINUOUS, CAST_CONTINUOUS (0 to 2), or
# NONE, DISCRETE, LVS_DISCRETE, CONTINUOUS, LVS_CONTINUOUS (0 to 4).  In both, 2 and more check between waypoints.
LAST_EVALUATOR, FIRST_SWEPT_EVALUATOR = 4, 2
QUATERNION_GAIN = 0.5  # the vector part of a quaternion is half of a small rotation's angle
CONSTRAINTS_ONLY = {"joint", "joint_vel_limits", "zmp", "foot_height"}


@dataclass(frozen=True)
class TermHead:
    """Keys of a term beside its parameters.

    Attributes:
        identity: ``path``, ``name`` and ``is_cost`` of ``Term``.
        n_steps: number of waypoints of the problem.
        rate: steps per second; 1 without ``use_time``.
        notes: list that receives a line per parameter without effect.
    """

    identity: tuple[str, str, bool]
    n_steps: int
    rate: float
    notes: list[str]

    def note(self, key: str, text: str) -> None:
        """Add a note on one parameter."""
        self.notes.append(f"{self.identity[0]}.params.{key}: {text}")

    @property
    def last(self) -> int:
        """Last waypoint."""
        return self.n_steps - 1


Reader = Callable[[TermHead, Fields], Term]


def read_term(fields: Fields, is_cost: bool, n_steps: int, rate: float, notes: list[str]) -> Term | None:
    """Read an entry of ``costs`` or ``constraints``; return None if it has findings."""
    before = len(fields.findings)
    kind = fields.text("type")
    name = fields.text("name", kind or "term")
    uses_time = fields.flag("use_time", False)
    if kind not in READERS:
        if kind in NOT_PLANNED:
            fields.refuse(fields.at("type"), f"{kind!r} is not planned with ({NOT_PLANNED[kind]}); leave it out")
        elif kind:
            fields.refuse(fields.at("type"), f"unknown type {kind!r}; expected {would_do(kind, READERS)}")
        fields.has("params")  # not read: only the type tells which keys it may have
        fields.close()
        return None
    if is_cost and kind in CONSTRAINTS_ONLY:
        fields.refuse(fields.at("type"), f"{kind} is a constraint only; list it under constraints")
    if uses_time and kind in ("joint", "joint_pos"):
        notes.append(f"{fields.path}.use_time: positions do not depend on time; without effect")
    elif uses_time and kind != "joint_vel":
        fields.refuse(fields.at("use_time"), f"{kind} does not use time; only joint_vel does")
    head = TermHead((fields.path, name, is_cost), n_steps, rate if uses_time else 1.0, notes)
    params = fields.section("params")
    term = READERS[kind](head, params)
    params.close()
    fields.close()
    return term if len(fields.findings) == before else None


def _pose(head: TermHead, params: Fields) -> Term:
    return replace(_read_pose(head, params, frame_key="link", is_goal_required=True), turn_gain=QUATERNION_GAIN)


def _cart_pose(head: TermHead, params: Fields) -> Term:
    """Read Tesseract's earlier keys (link, xyz, tcp_xyz) or its later ones (source_frame, target_frame)."""
    if params.first_of("link", "source_frame") == "link":
        return _read_pose(head, params, "link", offset="tcp_", is_goal_required=True)
    return _read_pose(
        head, params, "source_frame", "target_frame", goal="target_frame_offset_", offset="source_frame_offset_"
    )


def _dynamic_cart_pose(head: TermHead, params: Fields) -> Term:
    frame_key = params.first_of("link", "source_frame")
    reference_key = params.first_of("target", "target_frame")
    offset = "source_frame_offset_" if frame_key == "source_frame" else "tcp_"
    goal = "target_frame_offset_" if reference_key == "target_frame" else "target_tcp_"
    return _read_pose(head, params, frame_key, reference_key, goal, offset)


def _read_pose(
    head: TermHead,
    params: Fields,
    frame_key: str,
    reference_key: str | None = None,
    goal: str = "",
    offset: str | None = None,
    is_goal_required: bool = False,
) -> PoseTerm:
    """Read a pose term; ``goal`` and ``offset`` are the prefixes of its keys for xyz and wxyz."""
    term = PoseTerm(
        *head.identity,
        frame=params.text(frame_key),
        step=_step(head, params),
        xyz=params.numbers(f"{goal}xyz", None if is_goal_required else ZEROS, length=3),
        wxyz=_quaternion(params, f"{goal}wxyz", None if is_goal_required else UPRIGHT),
        pos_coeffs=params.numbers("pos_coeffs", ONES, length=3, least=0.0),
        rot_coeffs=params.numbers("rot_coeffs", ONES, length=3, least=0.0),
        frame_key=frame_key,
    )
    if reference_key is not None:
        term = replace(term, reference=params.text(reference_key), reference_key=reference_key)
    if offset is not None:
        xyz, wxyz = params.numbers(f"{offset}xyz", ZEROS, length=3), _quaternion(params, f"{offset}wxyz", UPRIGHT)
        term = replace(term, offset_xyz=xyz, offset_wxyz=wxyz)
    return term


def _joint(head: TermHead, params: Fields) -> Term:
    return _joint_values(head, params, head.last, ONES[:1])


def _joint_pos(head: TermHead, params: Fields) -> Term:
    """Read the original's term at one waypoint (default the last), or Tesseract's at a range (default all)."""
    if params.has("vals"):
        return _joint_values(head, params, head.last, None if head.identity[2] else ONES[:1])
    return _joint_values(head, params, 0, ONES[:1])


def _joint_values(head: TermHead, params: Fields, first_by_default: int, coeffs: Vector | None) -> Term:
    key = params.first_of("vals", "targets", "targs")
    if params.has("timestep"):
        first = last = _step(head, params)
        for other in ("first_step", "last_step"):
            if params.has(other):
                params.refuse(params.at(other), "timestep says which waypoint; leave one of them out")
    else:
        first, last = _range(head, params, first_by_default)
    return _read_joints(head, params, key, 0, None, coeffs, (first, last))


def _joint_rate(order: int) -> Reader:
    def read(head: TermHead, params: Fields) -> Term:
        key = params.first_of("targets", "targs")
        first, last = _range(head, params)
        if params.has("use_time"):
            params.flag("use_time", False)
            head.note("use_time", "counts beside type only, as in the original")
        if head.n_steps <= order:
            params.refuse(head.identity[0], f"{order + 1} waypoints are needed, n_steps is {head.n_steps}")
        if last - first < order:  # as Tesseract does: as many waypoints as one difference needs
            last = min(first + order, head.last)
            first = max(last - order, 0)
        return _read_joints(head, params, key, order, ZEROS[:1], ONES[:1], (first, last))

    return read


def _read_joints(
    head: TermHead,
    params: Fields,
    targets_key: str,
    order: int,
    targets: Vector | None,
    coeffs: Vector | None,
    steps: tuple[int, int],
) -> JointTerm:
    """Read a joint term; ``targets`` and ``coeffs`` are the defaults, None if required."""
    lower = params.numbers("lower_tols", ZEROS[:1])
    if any(value > 0.0 for value in lower):
        params.refuse(params.at("lower_tols"), "expected at most 0: how far below its target a value may lie, negative")
    return JointTerm(
        *head.identity,
        order=order,
        targets=params.numbers(targets_key, targets),
        coeffs=params.numbers("coeffs", coeffs, least=0.0),
        lower_tols=lower,
        upper_tols=params.numbers("upper_tols", ZEROS[:1], least=0.0),
        first=steps[0],
        last=steps[1],
        rate=head.rate,
        targets_key=targets_key,
    )


def _joint_vel_limits(head: TermHead, params: Fields) -> Term:
    first, last = _range(head, params)
    return JointStepTerm(*head.identity, params.numbers("vals", least=0.0), first, last)


def _cart_vel(head: TermHead, params: Fields) -> Term:
    first = params.whole("first_step", least=0, most=head.last - 1)
    last = params.whole("last_step", least=first + 1, most=head.last)
    limit = params.number("max_displacement", least=0.0)
    return CartVelTerm(*head.identity, params.text("link"), first, last, limit)


def _collision(head: TermHead, params: Fields) -> Term:
    return _read_collision(head, params)


def _read_collision(head: TermHead, params: Fields) -> CollisionTerm:
    first, last = _range(head, params)
    count = last - first + 1
    if params.first_of("continuous", "evaluator_type") == "evaluator_type":
        is_swept = params.whole("evaluator_type", least=0, most=LAST_EVALUATOR) >= FIRST_SWEPT_EVALUATOR
    else:
        is_swept = params.flag("continuous", True)
    gap = params.whole("gap", 1, least=0)
    if gap > 1:
        params.refuse(params.at("gap"), f"{gap} is not planned with; expected 1 (from waypoint to waypoint)")
    for key, text in _UNUSED_COLLISION_KEYS.items():
        if params.has(key):
            head.note(key, text)
    return CollisionTerm(
        *head.identity,
        is_swept=is_swept and gap > 0 and count > 1,
        first=first,
        last=last,
        coeffs=_per_step(params, "coeffs", count, least=0.0),
        dist_pen=_per_step(params, "dist_pen", count),
        pairs=tuple(_collision_pair(pair, count) for pair in params.sections("pairs")),
    )


def _continuous_collision(head: TermHead, params: Fields) -> Term:
    """Read the original's term of motions between waypoints, which has no key to say so."""
    return replace(_read_collision(head, params), is_swept=head.n_steps > 1)


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
    return ZmpTerm(*head.identity, _required_step(head, params), params.texts("planted_links"))


def _foot_height(head: TermHead, params: Fields) -> Term:
    step = _required_step(head, params)
    return FootHeightTerm(*head.identity, step, params.text("link"), params.number("height"))


def _step(head: TermHead, params: Fields) -> int:
    step = params.whole("timestep", head.last, least=-1, most=head.last)
    return head.last if step < 0 else step


def _required_step(head: TermHead, params: Fields) -> int:
    return params.whole("timestep", least=0, most=head.last)


def _range(head: TermHead, params: Fields, first_by_default: int = 0) -> tuple[int, int]:
    """Read first and last waypoint, inclusive; -1 stands for the last of all."""
    first = params.whole("first_step", first_by_default, least=0, most=head.last)
    last = params.whole("last_step", head.last, least=-1, most=head.last)
    last = head.last if last < 0 else last
    if last < first:
        params.refuse(params.at("last_step"), f"{last} is before first_step, {first}")
        return first, first
    return first, last


def _per_step(fields: Fields, key: str, count: int, least: float = -1.0) -> Vector:
    values = fields.numbers(key, least=least)
    if values and len(values) not in (1, count):
        fields.refuse(fields.at(key), f"1 number or {count} (one per waypoint) are needed, got {len(values)}")
    return values


def _quaternion(params: Fields, key: str, fallback: Vector | None = None) -> Vector:
    values = params.numbers(key, fallback, length=4)
    norm = math.hypot(*values)
    if len(values) != 4:
        return UPRIGHT
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        params.refuse(params.at(key), f"a quaternion (w, x, y, z) needs length 1, not {norm:.6g}")
        return UPRIGHT
    return tuple(value / norm for value in values)


_UNUSED_COLLISION_KEYS: Mapping[str, str] = {
    "fixed_steps": "basic_info says which waypoints are fixed",
    "longest_valid_segment_length": "the swept hull is checked as a whole, however long the step",
    "safety_margin_buffer": "contacts are searched as far as a step may bring them",
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
    "continuous_collision": _continuous_collision,
    "zmp": _zmp,
    "foot_height": _foot_height,
}
NOT_PLANNED: Mapping[str, str] = {
    "total_time": "the motion is timed afterwards, as fast as the robot's limits and its balance allow",
    "static_torque": "joint torques are checked along the timed motion instead",
    "potential_energy": "the original sums heights without masses",
}
