"""The robot on its planted links in a scene, with the terms that every phase of a motion has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance, BodyRef
from costs.collision import (
    Contacts,
    PairMargins,
    PoseChecker,
    SearchChecker,
    SweptCollisionChecker,
    make_search_checker,
)
from costs.kinematics import KinematicsEngine
from costs.robot import BASE_NAMES, Release, RobotModel
from costs.scene import Scene
from costs.state import MotionState
from costs.support import SupportPolygon
from costs.terms import (
    CentreOfMassAt,
    CentreOfMassInPolygon,
    ContactPlace,
    FramePose,
    Joined,
    RollingBase,
    Room,
    SweptClearance,
)
from costs.terms.rolling import FEWEST_INTERVALS
from scopt import Constraint, Cost, Problem, Residual, Sense
from service.body.aims import Aims
from service.body.comfort import keep_balanced, keep_in_region, keep_upright, smooth_joints
from service.body.forces.loaded_regions import PlannedRegion, plan_contact_region
from service.body.holds import CONTACT_DRIFT, DRIFT, Hold, project_onto_holds
from service.body.kept import Kept
from service.demands.stance import BALANCE_RESERVE, are_level, make_standing_allowances, plant_feet
from service.verify import PlantedContact

BASE_SPEED = 0.5  # natural speed of a coordinate without a velocity limit [m/s, rad/s]
FOOT_TOLERANCE = 2e-5  # per row [m, rad]: the sole's corners stay within 0.1 mm
ROLLING_TOLERANCE = 1e-5  # per row [m, rad]; the curve is made without these errors
CLEARANCE_TERMS = ("collision", "self-collision")
SELF_SHARE = 0.5  # of the margin between the robot's own links: their distance is known better than the world's
CLEARANCE_TOLERANCE = 2e-3  # of the clearance margin [m]
LEAST_APART = 5e-4  # between waypoints of pairs that are farther apart than the tolerance at an end [m]
TOUCHING_SHARE = 0.9  # of that tolerance by which an end may be deeper than a pair that may touch is aimed at
ACCEPTABLE_SHARE = 0.3  # of the margin that may be missing when a solve takes long
LIMIT_RESERVE = 0.01  # kept from the joint limits at free waypoints, for the curve between them [rad, m]
ROOM_WEIGHT = 300.0  # of what is missing of the room, averaged over the waypoints [cost/m^2]
LEAST_SEEN = 1e-4  # distance of links from which single poses count as apart [m]
SAMPLING_CLEARANCE = 5e-3  # of a sampled start; the optimiser adds the rest of the margin [m]
BASE_MOBILITY = 0.01  # of the base when a step is corrected: legs and arms move instead
BASE_STEP = np.array([0.5, 0.5, 0.5, 0.5, 0.5, 0.5])  # the base carries every link: smaller trust box


MOST_CHECKERS = 8  # that a body keeps: the phases of a hold ask for the same few
_Asked = tuple[tuple[Allowance, ...], tuple[tuple[BodyRef, BodyRef, float], ...]]
"""Pairs that may touch, and pairs with a margin of their own."""


@dataclass(frozen=True)
class WholeBody:
    """A robot on its planted links in a scene.

    Attributes:
        robot: possibly augmented by a mechanism, whose coordinates come last.
        scene: of convex pieces.
        engine: kinematics of ``robot``.
        planted: links that do not move.
        polygon: support polygon of the planted links; None for a fixed base, and where a region holds the robot.
        nominal: (n,) the posture to stay near.
        aims: margins.
        kept: relative poses that hold in every phase.
        has_default_costs: whether to move smoothly and near the nominal posture.
        is_comfortable: whether to keep upright and well balanced besides, as far as these are worth it.
        wants_reserve: whether to keep a balance margin besides by which position servos may sag.
        room_m: distance from the world beyond the margin that is kept as far as it is worth it; 0 for none [m].
        sight: distance beyond its margin at which a pair enters the problem [m].
        releases: rules of the latches of ``robot``'s mechanism.
        touches: what the planted links may touch; by default floors.
        held: what touches wherever it stands: fingers and what they hold.
        region: where contacts that are not soles on one level hold the robot.
        kept_apart: pairs of links that the robot ignores, and that keep their margin all the same.
        sampled_clearance: of the poses of sampled paths [m]; the optimiser adds the rest of the margin.
    """

    robot: RobotModel
    scene: Scene
    engine: KinematicsEngine
    planted: tuple[PlantedContact, ...]
    polygon: SupportPolygon | None
    nominal: Float[np.ndarray, "n"]
    aims: Aims
    kept: tuple[Kept, ...] = ()
    has_default_costs: bool = True
    is_comfortable: bool = True
    wants_reserve: bool = False
    room_m: float = 0.0
    sight: float = 0.03
    releases: tuple[Release, ...] = ()
    touches: tuple[Allowance, ...] | None = None
    held: tuple[Allowance, ...] = ()
    region: PlannedRegion | None = None
    kept_apart: frozenset[tuple[str, str]] = frozenset()
    sampled_clearance: float = SAMPLING_CLEARANCE

    @staticmethod
    def standing(
        robot: RobotModel, scene: Scene, q: Float[np.ndarray, "n"], feet: Sequence[str], aims: Aims
    ) -> WholeBody:
        """Return the robot planted at configuration ``q`` on the links ``feet`` (none for a fixed base).

        Raises:
            StaticRegionError: feet that are not on one level hold it nowhere.
        """
        engine = KinematicsEngine(robot)
        planted = plant_feet(robot, q, feet)
        body = WholeBody(robot, scene, engine, planted, None, q, aims)
        if not planted or not robot.can_balance:
            return body
        if not are_level(planted):
            return replace(body, region=plan_contact_region(robot, planted))
        return replace(body, polygon=SupportPolygon.of_soles([foot.points for foot in planted]))

    def with_robot(self, robot: RobotModel, nominal: Float[np.ndarray, "n"]) -> WholeBody:
        """Return the same stance of an augmented robot."""
        return replace(self, robot=robot, engine=KinematicsEngine(robot), nominal=nominal)

    def keep_apart(self, pairs: AbstractSet[tuple[str, str]]) -> WholeBody:
        """Return the robot that keeps these links apart although its files leave them out, if they are apart now."""
        wider = replace(self, kept_apart=self.kept_apart | pairs)
        contacts = wider._plain_checker(wider.engine(self.nominal[None]))
        is_inside = contacts.is_self & (contacts.distance <= 0.0)
        links = [body.link for body in self.robot.bodies]
        inside = {
            (min(links[a], links[b]), max(links[a], links[b]))
            for a, b in zip(contacts.body[is_inside].tolist(), contacts.other[is_inside].tolist(), strict=True)
        }
        return replace(self, kept_apart=wider.kept_apart - inside)

    @cached_property
    def _checked_robot(self) -> RobotModel:
        """Robot whose ignored pairs are those that are not checked."""
        return replace(self.robot, ignored_pairs=self.robot.ignored_pairs - self.kept_apart)

    def on_contacts(
        self, planted: Sequence[PlantedContact], touches: Sequence[Allowance], region: PlannedRegion
    ) -> WholeBody:
        """Return the robot on other contacts, which hold it in a region."""
        return replace(self, planted=tuple(planted), touches=tuple(touches), region=region, polygon=None)

    def make_checker(
        self,
        allowances: Sequence[Allowance] = (),
        ends: Sequence[Float[np.ndarray, "n"]] = (),
        overrides: Sequence[tuple[BodyRef, BodyRef, float]] = (),
    ) -> SweptCollisionChecker:
        """Return a checker whose margins fit the given fixed configurations.

        The required clearance of a pair is at most its distance at a configuration that cannot move; otherwise no
        trajectory through it would be feasible.
        """
        asked = (tuple(allowances), tuple(overrides))
        if asked not in self._checkers:
            if len(self._checkers) == MOST_CHECKERS:
                del self._checkers[next(iter(self._checkers))]
            self._checkers[asked] = self._make_checker(*asked)
        checker = self._checkers[asked]
        # A pair that may touch is not allowed more than its depth because it has it at an end.
        touching = -TOUCHING_SHARE * CLEARANCE_TOLERANCE
        return self._fit_margins(checker, ends, CLEARANCE_TOLERANCE, touching, CLEARANCE_TOLERANCE + LEAST_APART)

    @cached_property
    def _checkers(self) -> dict[_Asked, SweptCollisionChecker]:
        """Checkers without regard to ends, by what is asked; most share the work space of the plain one."""
        return {}

    @property
    def _plain_checker(self) -> SweptCollisionChecker:
        """Checker without regard to a task or to ends."""
        return self.make_checker()

    @cached_property
    def _padded(self) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
        """Margins of the pairs that padding keeps further apart."""
        return self.aims.list_padded(self.robot, self.scene)

    def _make_checker(
        self, allowances: Sequence[Allowance], overrides: Sequence[tuple[BodyRef, BodyRef, float]]
    ) -> SweptCollisionChecker:
        margins = PairMargins.of(
            self._checked_robot,
            self.scene,
            self.aims.margin,
            (*self.standing_allowances(), *self.held, *allowances),
            (*self._padded, *overrides),
            SELF_SHARE * self.aims.margin,
        )
        return SweptCollisionChecker(self.robot, self.scene, margins, self.sight)

    def make_pose_checker(self, ends: Sequence[Float[np.ndarray, "n"]]) -> PoseChecker:
        """Return a checker of some poses that requires a few millimetres, or a pair's distance at the ends if less."""
        return PoseChecker(self.engine, self.scene, self._fit_sampled_margins(ends))

    def are_apart(self, q: Float[np.ndarray, "T n"]) -> bool:
        """Return whether all pairs that may not touch are apart at every pose, those that meet at an end aside."""
        return replace(self, sampled_clearance=LEAST_SEEN).make_pose_checker([q[0], q[-1]]).are_clear(q)

    def make_search_checker(self, ends: Sequence[Float[np.ndarray, "n"]]) -> SearchChecker:
        """Return a checker of the same for the many poses of a search."""
        return make_search_checker(self.engine, self.scene, self._fit_sampled_margins(ends))

    def _fit_sampled_margins(self, ends: Sequence[Float[np.ndarray, "n"]]) -> PairMargins:
        """Return the margins of the poses of a search between two ends."""
        allowances = (*self.standing_allowances(), *self.held)
        margins = PairMargins.of(self._checked_robot, self.scene, self.sampled_clearance, allowances)
        checker = SweptCollisionChecker(self.robot, self.scene, margins, buffer=0.0)
        return self._fit_margins(checker, ends, 0.5 * min(CLEARANCE_TOLERANCE, self.sampled_clearance)).margins

    def _fit_margins(
        self,
        checker: SweptCollisionChecker,
        ends: Sequence[Float[np.ndarray, "n"]],
        reserve: float,
        touching_reserve: float | None = None,
        kept: float = 0.0,
    ) -> SweptCollisionChecker:
        """Limit every margin to the distance at the given ends less a reserve: see ``PairMargins.relax_to``."""
        if not len(ends):
            return checker
        contacts = checker.at_poses(self.engine.place(np.array(ends)))
        return checker.with_margins(checker.margins.relax_to(contacts, reserve, touching_reserve, kept))

    def measure_nearest(self, q: Float[np.ndarray, "n"]) -> float:
        """Return the smallest distance of pairs that may not touch at a configuration, at most the sight [m]."""
        contacts = self._plain_checker(self.engine(q[None]))
        own = contacts.distance[contacts.margin > 0.0]
        return float(own.min(initial=self.sight))

    @property
    def keeps_poses(self) -> bool:
        """Whether kept poses are held, so that only some configurations count; regions leave the others free."""
        return any(any(kept.is_held) for kept in self.kept)

    def place_kept(self, path: Float[np.ndarray, "T n"]) -> WholeBody:
        """Return the body with regions that hold on a part of the motion at the waypoints of that part of a path."""
        if all(kept.is_whole for kept in self.kept):
            return self
        speed = np.where(np.isfinite(self.robot.velocity), self.robot.velocity, BASE_SPEED)
        steps = (np.abs(np.diff(path, axis=0)) / speed).max(axis=1, initial=0.0)
        shares = np.concatenate([[0.0], np.cumsum(steps)])
        shares = shares / shares[-1] if shares[-1] > 0.0 else np.linspace(0.0, 1.0, len(path))
        return replace(self, kept=tuple(kept.place(shares) for kept in self.kept))

    def holds(self) -> tuple[Hold, ...]:
        """Return the holds of every phase: planted links and kept poses."""
        planted: list[Hold] = [
            lambda waypoints, contact=contact: self.keep_planted(contact, waypoints)  # type: ignore[misc]
            for contact in self.planted
        ]
        return (*planted, *(hold for kept in self.kept for hold in kept.holds(self.robot)))

    def hold_in_balance(self) -> tuple[Hold, ...]:
        """Return the hold of the centre of mass over the middle of where the robot is held; none for a fixed base."""
        if self.region is not None:
            middle = self.region.region.vertices.mean(axis=0)
        elif self.polygon is not None:
            middle = self.polygon.vertices.mean(axis=0)
        else:
            return ()
        return (lambda waypoints: CentreOfMassAt(middle, waypoints),)

    def keep_planted(
        self, contact: PlantedContact, waypoints: Int[np.ndarray, "S"], by: Float[np.ndarray, "3"] | None = None
    ) -> Residual[MotionState]:
        """Return how far a contact is from its place, moved by an offset in the world if one is given [m, rad].

        A link with fewer than three points in contact may turn about them.
        """
        shift = np.zeros(3) if by is None else by
        if len(contact.sole) < 3:
            places = contact.points + shift
            return ContactPlace.at(self.robot, contact.link, contact.sole, waypoints, places)
        pose = contact.pose_world_link.copy()
        pose[:3, 3] += shift
        return FramePose(self.robot, contact.link, waypoints, pose)

    def project_onto_holds(self, q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
        """Return the nearest waypoints that keep the holds; the first is not moved."""
        return np.concatenate([q[:1], project_onto_holds(self.engine, q[1:], self.holds())])

    @property
    def is_on_feet(self) -> bool:
        """Whether it stands, in balance, on its feet as they are at the start, and not on contacts that change."""
        return self.touches is None and self.is_balanced

    @property
    def is_balanced(self) -> bool:
        """Whether it stands in balance, on whatever contacts."""
        return self.polygon is not None or self.region is not None

    def drift(self) -> float:
        """Return the largest residual of a hold between waypoints [m, rad]."""
        return min([DRIFT if self.touches is None else CONTACT_DRIFT, *(kept.drift for kept in self.kept)])

    def standing_allowances(self) -> tuple[Allowance, ...]:
        """Return the allowances of planted links: those of their contacts, by default with what carries their soles."""
        if self.touches is not None:
            return self.touches
        return make_standing_allowances(self.robot, self.planted, self.scene)

    def make_problem(
        self,
        lower: Float[np.ndarray, "T n"],
        upper: Float[np.ndarray, "T n"],
        checker: SweptCollisionChecker,
        costs: Sequence[Cost[MotionState]] = (),
        constraints: Sequence[Constraint[MotionState]] = (),
        balanced: Sequence[int] | None = None,
        regions: Sequence[PlannedRegion] = (),
    ) -> Problem[MotionState]:
        """Return the terms of every phase and the task's as one problem.

        Args:
            lower, upper: bounds, equal where a variable is fixed.
            checker: of swept collisions.
            costs, constraints: of the task.
            balanced: waypoints with a balance constraint; all if not given.
            regions: where the loaded feet hold the robot, instead of their hull.
        """
        n_waypoints = len(lower)
        if self.region is not None and not regions:
            regions = (replace(self.region, first=0, last=n_waypoints - 1),)
        standing = [
            *self._stay_planted(n_waypoints),
            *self._stay_balanced(n_waypoints, balanced, regions),
            *self._stay_clear(),
        ]

        def state(x: Float[np.ndarray, "T n"]) -> MotionState:
            kinematics = self.engine(x)
            return MotionState(kinematics, self.adjust_contacts(checker(kinematics), n_waypoints))

        return Problem(
            lower,
            upper,
            (*self._list_default_costs(n_waypoints, regions), *costs),
            (*standing, *constraints),
            state,
            self.step_scale(),
            lambda x: MotionState(self.engine.place(x), Contacts.none()),
            self._mobility(),
        )

    def _stay_planted(self, n_waypoints: int) -> Iterator[Constraint[MotionState]]:
        """Yield what holds planted links, wheels and kept poses in place at all waypoints."""
        everywhere = np.arange(n_waypoints)
        for foot in self.planted:
            held = self.keep_planted(foot, everywhere)
            yield Constraint(f"planted {foot.link}", held, Sense.EQUAL_ZERO, FOOT_TOLERANCE, unit="m or rad")
        if self.robot.rolls and n_waypoints > FEWEST_INTERVALS:
            rolling = RollingBase(n_waypoints)
            yield Constraint("rolling base", rolling, Sense.EQUAL_ZERO, ROLLING_TOLERANCE, unit="m or rad")
        for kept in self.kept:
            yield from kept.constraints(self.robot, everywhere)

    def _stay_balanced(
        self, n_waypoints: int, balanced: Sequence[int] | None, regions: Sequence[PlannedRegion]
    ) -> Iterator[Constraint[MotionState]]:
        """Yield what keeps the centre of mass in its regions, or else in the support polygon, if there is any."""
        everywhere = np.arange(n_waypoints)
        margin = self.aims.balance_margin + BALANCE_RESERVE
        inside: Residual[MotionState]
        if regions:
            inside = Joined([keep_in_region(planned, everywhere, margin) for planned in regions])
        elif self.polygon is not None:
            inside = CentreOfMassInPolygon(self.polygon, everywhere if balanced is None else balanced, margin)
        else:
            return
        yield Constraint("balance", inside, tolerance=0.5 * BALANCE_RESERVE, unit="m")

    def _stay_clear(self) -> Iterator[Constraint[MotionState]]:
        """Yield what keeps the margin from the world, and between the robot's own links."""
        for name, is_self in zip(CLEARANCE_TERMS, (False, True), strict=True):
            acceptable = ACCEPTABLE_SHARE * self.aims.margin * (SELF_SHARE if is_self else 1.0)
            clearance = SweptClearance(self.robot, is_self=is_self)
            yield Constraint(name, clearance, tolerance=CLEARANCE_TOLERANCE, acceptable=acceptable, unit="m")

    def _list_default_costs(self, n_waypoints: int, regions: Sequence[PlannedRegion]) -> Iterator[Cost[MotionState]]:
        """Yield the costs of every phase: of speed and posture, of comfort, of room."""
        everywhere = np.arange(n_waypoints)
        if self.has_default_costs:
            yield from smooth_joints(self.robot, self.nominal, n_waypoints)
        if self.has_default_costs and self.is_comfortable:
            yield from keep_upright(self.robot, everywhere)
            yield from keep_balanced(self.polygon, regions, everywhere, wants_reserve=self.wants_reserve)
        if self.room_m > 0.0:
            yield Cost("room", Room(self.robot, self.room_m), ROOM_WEIGHT / n_waypoints)

    def adjust_contacts(self, contacts: Contacts, n_waypoints: int) -> Contacts:
        """Return the contacts of a trajectory as they enter its problem: by default as they are."""
        return contacts

    def bounds(
        self, n_waypoints: int, fixed: Mapping[int, Float[np.ndarray, "n"]]
    ) -> tuple[Float[np.ndarray, "T n"], Float[np.ndarray, "T n"]]:
        """Return joint limits with a reserve at free waypoints, the given configurations at fixed ones.

        A joint that is nearer to a limit at all fixed waypoints, or in the nominal posture where there are none, may
        stay there: nothing asks it to move.
        """
        reserve = np.minimum(LIMIT_RESERVE, 0.05 * (self.robot.upper - self.robot.lower))
        least, most = self.robot.lower + reserve, self.robot.upper - reserve
        ends = np.array([*fixed.values()] or [self.nominal])
        least = np.where(ends.max(axis=0) < least, np.maximum(ends.min(axis=0), self.robot.lower), least)
        most = np.where(ends.min(axis=0) > most, np.minimum(ends.max(axis=0), self.robot.upper), most)
        lower, upper = (np.tile(bound, (n_waypoints, 1)) for bound in (least, most))
        for waypoint, q in fixed.items():
            lower[waypoint] = upper[waypoint] = q
        return lower, upper

    def step_scale(self) -> Float[np.ndarray, "n"]:
        """Return each coordinate's largest step relative to the trust radius."""
        scale = np.ones(self.robot.n)
        if self.robot.is_floating:
            scale[: len(BASE_NAMES)] = BASE_STEP
        return scale

    def _mobility(self) -> Float[np.ndarray, "n"]:
        """Return each coordinate's weight in step corrections; low for the base, since it moves every link."""
        mobility = np.ones(self.robot.n)
        if self.robot.is_floating:
            mobility[: len(BASE_NAMES)] = BASE_MOBILITY
        return mobility
