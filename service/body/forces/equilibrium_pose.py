"""Poses in static equilibrium, with the contact forces as variables of the same problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.contact import Contact
from costs.contact_points import ContactPoints, Load, measure_weight
from costs.state import LoadedState, MotionState
from costs.terms import (
    ContactForce,
    Equilibrium,
    FrictionPyramid,
    JointTorque,
    MechanismBalance,
    StaticTorque,
    Widened,
)
from scopt import Constraint, Cost, Problem, Result, Sense, Settings, TrustRegionSQP
from service.body.effort import FORCE_SETTINGS
from service.body.forces.contact_forces import ForceRows
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody

BALANCE_TOLERANCE = 1e-5  # per row of force and moment [weight, weight times m]; forces are balanced exactly afterwards
FORCE_RESERVE = 1e-4  # inside pyramids and caps [weight]: room for the exact balance
TORQUE_RESERVE = 2e-3  # of the joint limits, for the same
FORCE_WEIGHT = 0.01  # of the sum of squares of all forces [cost/weight^2]: without it they are not unique
FORCE_STEP = 2.0  # of a force [weight] relative to the trust radius


@dataclass(frozen=True)
class EquilibriumPose:
    """A configuration with forces that hold it.

    Attributes:
        q: (n,) configuration.
        points: of the contacts, in their order.
        places: (C, 3) the contact points in the world [m].
        forces_n: (C, 3) force of the surroundings on each point, in world axes [N]: of all that hold the configuration
            within the limits those with the least sum of squares, or those nearest to the optimiser's where the caller
            has terms of forces; those of the optimiser where none hold it.
        misfit_n: largest component of force and moment that they leave unbalanced [N, N m].
        torque_nm: (n,) generalised forces of the joints at rest under these forces [N m, N].
        most_loaded_joint: the joint that uses most of its limit; empty for a robot without torque limits.
        torque_share: of its limit that it uses.
        is_feasible: whether all constraints are kept and forces hold the configuration within all limits.
        violations: what is violated, in sentences; empty for a feasible pose.
        result: of the optimiser, its variables the configuration and the forces in units of the robot's weight.
        rows: what forces at the contact points do in this configuration.
        allowed_torque: share of each torque limit that may be used; None for any torque.
    """

    q: Float[np.ndarray, "n"]
    points: ContactPoints
    places: Float[np.ndarray, "C 3"]
    forces_n: Float[np.ndarray, "C 3"]
    misfit_n: float
    torque_nm: Float[np.ndarray, "n"]
    most_loaded_joint: str
    torque_share: float
    is_feasible: bool
    violations: tuple[str, ...]
    result: Result
    rows: ForceRows
    allowed_torque: float | None

    @property
    def shortfall(self) -> float:
        """Number of constraints that it violates."""
        return float(len(self.violations))

    @cached_property
    def least_torque_share(self) -> float:
        """``torque_share`` under the forces that spread torque best; ``inf`` where none hold the pose."""
        return self.rows.spread_torque()[0]

    @cached_property
    def reserve_n(self) -> float:
        """How far inside friction and caps the forces at all contact points can be at once [N].

        Errors up to it make no contact slip, lift or press too hard.  Negative where no forces hold the configuration.
        """
        return self.rows.measure_reserve(self.allowed_torque)


@dataclass(frozen=True)
class ForceLimits:
    """Limits of the forces that hold a pose.

    Attributes:
        torque_share: of each joint's torque limit that may be used; None for any torque.
        margin_n: error that the force at every contact point may have without leaving friction and cap [N].
        loads: given forces and moments on links.
        mechanism_loads: by joint of a touched mechanism: what the robot has to exert along it [N m, N].  A mechanism
            that is touched and has no load here is free: it supports nobody.
        world_normals: by index of a contact: its normal in the world, or those of its points, for a link that may turn
            on what it touches.
    """

    torque_share: float | None = 1.0
    margin_n: float = 0.0
    loads: tuple[Load, ...] = ()
    mechanism_loads: Mapping[str, float] | None = None
    world_normals: Mapping[int, Float[np.ndarray, "3"] | Float[np.ndarray, "C 3"]] | None = None


def make_planted_contacts(body: WholeBody, friction: float, force_cap_n: float) -> tuple[Contact, ...]:
    """Return the planted links' soles as contacts with level ground; the cap is that of a sole's corner [N]."""
    return tuple(
        Contact(
            foot.link,
            foot.sole,
            np.tile(foot.pose_world_link[2, :3], (len(foot.sole), 1)),  # the world's z axis in the link's frame
            friction,
            force_cap_n,
        )
        for foot in body.planted
    )


def solve_equilibrium_pose(
    body: WholeBody,
    contacts: Sequence[Contact],
    guess: Float[np.ndarray, "n"],
    limits: ForceLimits = ForceLimits(),
    costs: Sequence[Cost[MotionState]] = (),
    constraints: Sequence[Constraint[MotionState]] = (),
    *,
    force_terms: Sequence[Cost[LoadedState] | Constraint[LoadedState]] = (),
    allowances: Sequence[Allowance] = (),
    ends: Sequence[Float[np.ndarray, "n"]] = (),
    fixed: Mapping[int, float] | None = None,
    settings: Settings = FORCE_SETTINGS,
    should_stop: Callable[[], bool] | None = None,
) -> EquilibriumPose:
    """Solve for a configuration near the nominal posture and forces at the contacts that hold it.

    Eq. 1 of Liu et al., Humanoids 2015, with friction pyramids in place of boxes.  The body's terms stay: planted
    links, kept poses, clearance, nominal posture and upright links; its support polygon is left out.  Contacts say
    where forces may act on the robot; ``constraints`` (``ContactPlace``) or planted links put them in their places.

    Args:
        body: the robot in its scene.
        contacts: where forces may act.
        guess: configuration to start from.
        limits: of the forces.
        costs, constraints: of the configuration, at waypoint 0.
        force_terms: of configuration and forces, at waypoint 0.
        allowances: pairs that may touch.
        ends: configurations whose distances limit the required clearance.
        fixed: value by coordinate index.
        settings: of the optimiser.
        should_stop: called before every trial step; True ends the solve.

    Raises:
        KeyError: a link or joint is unknown.
        ValueError: the guess has a wrong shape or is not finite, there is no contact, the robot has a fixed base or no
            mass, or a contact or a load is refused.
    """
    if guess.shape != (body.robot.n,) or not np.isfinite(guess).all():
        raise ValueError(f"guess must be finite with shape ({body.robot.n},), got shape {guess.shape}")
    if not contacts:
        raise ValueError("a pose in equilibrium needs at least one contact")
    if not body.robot.is_floating:
        raise ValueError(f"robot '{body.robot.name}' has a fixed base, which holds it; equilibrium needs a free one")
    free = replace(body, polygon=None)
    lower, upper = free.bounds(1, {})
    for index, value in (fixed or {}).items():
        lower[0, index] = upper[0, index] = value
    narrow = free.make_problem(lower, upper, free.make_checker(allowances, ends), costs, constraints)
    points = ContactPoints.of(body.robot, contacts, _fix_normals(body, contacts, limits))
    points = points.lean_up(body.engine(guess[None]))
    problem = add_forces(narrow, points, (*_make_force_terms(body, points, guess, limits), *force_terms))
    rows = ForceRows.at(body.engine, guess, points, limits.loads, limits.mechanism_loads)
    start = np.concatenate([guess, rows.guess().ravel() / rows.weight_n])[None]
    result = TrustRegionSQP(settings).solve(problem, start, should_stop=should_stop)
    own = tuple(term for term in force_terms if isinstance(term, Constraint))
    return _describe(_Attempt(free, narrow, points, limits, result, own, has_own_terms=bool(force_terms)))


def _fix_normals(
    body: WholeBody, contacts: Sequence[Contact], limits: ForceLimits
) -> dict[int, Float[np.ndarray, "3"] | Float[np.ndarray, "C 3"]]:
    """Return the given normals in the world and those of planted links, which a perturbed guess does not turn."""
    poses = {foot.link: foot.pose_world_link for foot in body.planted}
    planted = {k: c.normals @ poses[c.link][:3, :3].T for k, c in enumerate(contacts) if c.link in poses}
    return {**planted, **(limits.world_normals or {})}


def add_forces(
    problem: Problem[MotionState],
    points: ContactPoints,
    terms: Sequence[Cost[LoadedState] | Constraint[LoadedState]],
) -> Problem[LoadedState]:
    """Return a problem of configurations with a force per contact point and waypoint as further variables.

    Waypoints become ``n + 3 C`` wide.  Forces of points whose cap is zero are fixed at zero.
    """
    n_waypoints, n = problem.lower.shape
    count = len(points)
    most = np.tile(np.repeat(points.cap * np.hypot(1.0, points.friction), 3), (n_waypoints, 1))

    def state(x: Float[np.ndarray, "T N"]) -> LoadedState:
        q, forces = LoadedState.split(x, count)
        return LoadedState(problem.state(q), forces)

    def smooth_state(x: Float[np.ndarray, "T N"]) -> LoadedState:
        q, forces = LoadedState.split(x, count)
        return LoadedState((problem.smooth_state or problem.state)(q), forces)

    def extend(values: Float[np.ndarray, "n"] | None, value: float) -> Float[np.ndarray, "N"]:
        return np.concatenate([np.ones(n) if values is None else values, np.full(3 * count, value)])

    return Problem(
        np.concatenate([problem.lower, -most], axis=1),
        np.concatenate([problem.upper, most], axis=1),
        (
            *(Cost(cost.name, Widened(cost.residual), cost.weight, cost.penalty) for cost in problem.costs),
            *(term for term in terms if isinstance(term, Cost)),
        ),
        (
            *(_widen(constraint) for constraint in problem.constraints),
            *(term for term in terms if isinstance(term, Constraint)),
        ),
        state,
        extend(problem.step_scale, FORCE_STEP),
        smooth_state,
        extend(problem.mobility, 1.0),
    )


def _widen(constraint: Constraint[MotionState]) -> Constraint[LoadedState]:
    return Constraint(
        constraint.name,
        Widened(constraint.residual),
        constraint.sense,
        constraint.tolerance,
        constraint.scale,
        constraint.unit,
        constraint.acceptable,
    )


def _make_force_terms(
    body: WholeBody, points: ContactPoints, guess: Float[np.ndarray, "n"], limits: ForceLimits
) -> tuple[Cost[LoadedState] | Constraint[LoadedState], ...]:
    """Return equilibrium, friction, torque and the cost of forces at waypoint 0."""
    robot = body.robot
    about = points.places.locate(body.engine(guess[None]), np.arange(1))[0].mean(axis=0)
    margin = limits.margin_n / measure_weight(robot) + FORCE_RESERVE
    terms: list[Cost[LoadedState] | Constraint[LoadedState]] = [
        Cost("contact forces", ContactForce(points, [0]), FORCE_WEIGHT),
        Constraint(
            "equilibrium",
            Equilibrium(robot, points, [0], limits.loads, about),
            Sense.EQUAL_ZERO,
            BALANCE_TOLERANCE,
            unit="of the weight",
        ),
        Constraint(
            "friction and caps",
            FrictionPyramid(points, [0], margin),
            tolerance=0.5 * FORCE_RESERVE,
            unit="of the weight",
        ),
    ]
    if points.reference_joint.any():
        mechanism = MechanismBalance(robot, points, [0], limits.mechanism_loads)
        terms.append(Constraint("mechanism load", mechanism, Sense.EQUAL_ZERO, BALANCE_TOLERANCE, unit="of the weight"))
    if limits.torque_share is not None:
        torque = JointTorque(robot, points, [0], limits.loads, limits.torque_share - TORQUE_RESERVE)
        terms.append(Constraint("joint torque", torque, tolerance=0.5 * TORQUE_RESERVE, unit="of the limit"))
    return tuple(terms)


@dataclass(frozen=True)
class _Attempt:
    """A solved problem; ``own`` are the caller's constraints of forces."""

    body: WholeBody
    problem: Problem[MotionState]
    points: ContactPoints
    limits: ForceLimits
    result: Result
    own: tuple[Constraint[LoadedState], ...]
    has_own_terms: bool


def _describe(attempt: _Attempt) -> EquilibriumPose:
    """Return a pose with forces that hold its configuration exactly."""
    body, points, limits, result = attempt.body, attempt.points, attempt.limits, attempt.result
    robot = body.robot
    x, proposed = LoadedState.split(result.x, len(points))
    rows = ForceRows.at(body.engine, x[0], points, limits.loads, limits.mechanism_loads)
    near = rows.weight_n * proposed[0] if attempt.has_own_terms else None
    held = rows.find_least(limits.torque_share, limits.margin_n, near)
    forces = rows.weight_n * proposed[0] if held is None else held
    motion = attempt.problem.state(x)
    state = LoadedState(motion, forces[None] / rows.weight_n)
    shares = rows.measure_shares(forces)
    most = int(shares.argmax()) if len(shares) else -1
    solved = Solved(replace(result, x=x), attempt.problem, body)
    violations = () if solved.is_feasible else solved.describe_violations("pose")
    for term in attempt.own:
        worst = float(term.measure_violation(term.residual.value(state)).max(initial=0.0))
        if worst > term.tolerance:
            violations = (*violations, f"pose: '{term.name}' is off by {worst:.3g} {term.unit}".rstrip())
    if held is None:
        violations = (*violations, _explain_forces(rows, limits, robot.joint_names))
    return EquilibriumPose(
        x[0],
        points,
        points.places.locate(motion.kinematics, np.arange(1))[0],
        forces,
        rows.measure_misfit(forces),
        rows.weight_n * StaticTorque(robot, points, limits.loads).measure(state, np.arange(1))[0],
        robot.joint_names[rows.limited[most]] if len(shares) else "",
        float(shares[most]) if len(shares) else 0.0,
        not violations,
        violations,
        result,
        rows,
        limits.torque_share,
    )


def _explain_forces(rows: ForceRows, limits: ForceLimits, joint_names: Sequence[str]) -> str:
    """Return a sentence why no forces hold the configuration."""
    reserve = rows.measure_reserve(limits.torque_share)
    if reserve >= 0.0:
        return f"contact forces can err by {reserve:.3g} N at most, {limits.margin_n:.3g} N are required"
    missing = rows.measure_reserve(None)
    if missing == -np.inf:
        return "no forces at the contacts balance the weight and the loads, whatever friction and caps are"
    if missing < 0.0:
        return f"no forces at the contacts hold the pose; they would leave friction or caps by {-missing:.3g} N"
    share, forces = rows.spread_torque()
    joint = joint_names[rows.limited[int(rows.measure_shares(forces).argmax())]]
    allowed = 100.0 * (limits.torque_share or 0.0)
    return f"{joint} needs {100.0 * share:.1f} % of its torque, {allowed:.0f} % are allowed"
