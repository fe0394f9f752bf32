"""Poses of a robot with contacts in their places, held by some of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from costs.collision import Contacts
from costs.contact import Contact
from costs.state import MotionState
from costs.terms import ContactPlace, JointTarget, WithinTolerance
from scopt import Constraint, Cost, Sense, Settings
from service.body.effort import Effort
from service.body.facing import keep_facing
from service.body.forces.equilibrium_pose import EquilibriumPose, ForceLimits, solve_equilibrium_pose
from service.body.holds import project_onto_holds
from service.body.phases import PhaseSolver
from service.body.poses import PoseProblem, find_pose, name_seeds
from service.body.whole_body import FOOT_TOLERANCE, WholeBody
from service.demands.contacts.stances import StanceContact
from service.verify import find_normals

TORQUE_SHARE = 0.85  # of each joint's limit in the poses, the rest is for the motion between them
SAME_STATE = 2e-5  # of a configuration that counts as that of an earlier motion [rad, m]
SIDE_RESERVE = 1e-3  # of the depth behind a contact's surface in poses, for the motion between them [m]
KNOWN_WEIGHT = 1.0  # of a known pose [cost/rad^2, cost/m^2]
SLIDE_TOLERANCE_M = 1e-4  # of slack and edges


@dataclass(frozen=True)
class HeldPose:
    """Poses with all contacts in place, held by those kept alone.

    Attributes:
        solver: with the settings of the plan.
        body: on the kept contacts.
        kept, placed: contacts that carry the robot, and those that touch.
        fixed: value by coordinate index.
        sliding: of all these, contacts that may be anywhere within their slack; not among ``placed`` or planted.
    """

    solver: PhaseSolver
    body: WholeBody
    kept: tuple[StanceContact, ...]
    placed: tuple[StanceContact, ...]
    fixed: Mapping[int, float] | None = None
    sliding: tuple[StanceContact, ...] = ()

    def solve(
        self,
        guess: Float[np.ndarray, "n"],
        near: Float[np.ndarray, "n"],
        costs: Sequence[Cost[MotionState]] = (),
        ends: Sequence[Float[np.ndarray, "n"]] = (),
        effort: Effort = Effort.FORCES,
    ) -> EquilibriumPose:
        """Solve from a guess for a pose near a configuration; ``ends`` limit the clearance that is required."""
        normals = {k: find_normals((contact.planted,)).mean(axis=0) for k, contact in enumerate(self.kept)}
        return solve_equilibrium_pose(
            replace(self.body, nominal=near),
            [_as_contact(contact) for contact in self.kept],
            guess,
            ForceLimits(torque_share=TORQUE_SHARE, world_normals=normals),
            costs,
            self._place(),
            ends=ends,
            fixed=self.fixed,
            settings=effort.apply(Settings()),
            should_stop=self.solver.monitor.should_stop,
        )

    def holds_at(self, q: Float[np.ndarray, "n"]) -> bool:
        """Return whether a configuration is such a pose."""
        pose = self.solve(q, q, ends=(q,), effort=Effort.NONE)
        return pose.is_feasible and bool(np.abs(self.project(q) - q).max() <= SAME_STATE)

    def project(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the nearest configuration with all contacts exactly in place."""
        both = replace(self.body, planted=(*self.body.planted, *(contact.planted for contact in self.placed)))
        return np.asarray(project_onto_holds(both.engine, q[None], both.holds())[0])

    def _place(self) -> list[Constraint[MotionState]]:
        one = np.zeros(1, dtype=int)
        places = [
            Constraint(
                f"place of {contact.patch}",
                self.body.keep_planted(contact.planted, one),
                Sense.EQUAL_ZERO,
                FOOT_TOLERANCE,
                unit="m or rad",
            )
            for contact in self.placed
        ]
        for contact in self.sliding:
            places += _keep_sliding(self.body, contact)
        facing = {contact.patch: contact for contact in (*self.kept, *self.placed, *self.sliding)}
        return [*places, *keep_sides(self.body, tuple(facing.values()), one, SIDE_RESERVE)]

    def only_sliding(self, patches: Collection[str]) -> HeldPose:
        """Return the pose with the slack of the other patches taken away."""

        def hold(contacts: tuple[StanceContact, ...]) -> tuple[StanceContact, ...]:
            return tuple(own if own.patch in patches else replace(own, slack_m=0.0) for own in contacts)

        return replace(self, kept=hold(self.kept), placed=hold(self.placed))

    def find_slides(
        self, guesses: Sequence[Float[np.ndarray, "n"]], near: Float[np.ndarray, "n"]
    ) -> dict[str, float] | None:
        """Return by how much contacts with slack are moved along their surfaces in a pose near a configuration [m].

        None without such contacts, or where no pose holds wherever they are.
        """
        loose = {contact.patch: contact for contact in (*self.kept, *self.placed) if contact.slack_m > 0.0}
        if not loose:
            return None
        fixed = [foot for contact, foot in zip(self.kept, self.body.planted, strict=True) if contact.patch not in loose]
        free = replace(
            self,
            body=replace(self.body, planted=tuple(fixed)),
            placed=tuple(contact for contact in self.placed if contact.patch not in loose),
            sliding=tuple(loose.values()),
        )
        robot = self.body.robot
        known = JointTarget(1, robot.n, np.zeros(1, dtype=int), np.arange(robot.n), near)
        wanted = [Cost("known pose", known, KNOWN_WEIGHT)]
        problem = PoseProblem("pose elsewhere", lambda q: free.solve(q, near, wanted), self.solver.monitor)
        pose = find_pose(problem, name_seeds("near", guesses))
        if not pose.is_feasible:
            return None
        state = MotionState(self.body.engine(pose.q[None]), Contacts.none())
        return {patch: float(_slide(self.body, contact).value(state)[0]) for patch, contact in loose.items()}


def keep_sides(
    body: WholeBody, contacts: Sequence[StanceContact], waypoints: Int[np.ndarray, "S"], reserve_m: float = 0.0
) -> list[Constraint[MotionState]]:
    """Return constraints that links which may turn about their contact points stay in front of what they touch."""
    return [
        constraint
        for contact in contacts
        for constraint in keep_facing(
            body.robot,
            contact.patch,
            find_normals((contact.planted,)).mean(axis=0),
            contact.points.mean(axis=0),
            waypoints,
            reserve_m,
        )
    ]


def _slide(body: WholeBody, contact: StanceContact) -> ContactPlace:
    """Return how far the first point of a contact is from its place along the surface, at waypoint 0 [m]."""
    planted, along = contact.planted, contact.surface.along
    return ContactPlace(body.robot, planted.link, planted.sole[:1], [0], along[None], along @ contact.points[0])


def _keep_sliding(body: WholeBody, contact: StanceContact) -> list[Constraint[MotionState]]:
    """Return constraints that a contact is in its place but for its slack, and not beyond the edges of its surface."""
    robot, planted, surface = body.robot, contact.planted, contact.surface
    across = np.stack([surface.normal, np.cross(surface.normal, surface.along)])
    on_line = ContactPlace(robot, planted.link, planted.sole, [0], across, contact.points @ across.T)
    inside = ContactPlace.inside(robot, planted.link, planted.sole, [0], *surface.list_edges())
    slack = WithinTolerance(_slide(body, contact), contact.slack_m)
    return [
        Constraint(f"place of {contact.patch}", on_line, Sense.EQUAL_ZERO, FOOT_TOLERANCE, unit="m"),
        Constraint(f"slack of {contact.patch}", slack, tolerance=SLIDE_TOLERANCE_M, unit="m"),
        Constraint(f"{contact.patch} within {surface.name}", inside, tolerance=SLIDE_TOLERANCE_M, unit="m"),
    ]


def _as_contact(contact: StanceContact) -> Contact:
    """Return a planted contact as one whose forces a pose has as variables."""
    planted = contact.planted
    normal = find_normals((planted,)).mean(axis=0) @ planted.pose_world_link[:3, :3]
    return Contact(
        planted.link, planted.sole, np.tile(normal, (len(planted.sole), 1)), planted.friction, planted.force_cap_n
    )
