"""Poses between two stances: all contacts of one in place, held by those that both have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from costs.state import MotionState
from costs.static_region import StaticRegionError
from costs.terms import JointTarget
from scopt import Cost
from service.body.forces.loaded_regions import plan_contact_region
from service.body.phases import PhaseSolver
from service.body.poses import PoseProblem, find_pose, posture_guesses
from service.body.sampling import free_coordinates
from service.body.task_plan import Stuck
from service.body.whole_body import WholeBody
from service.demands.contacts.stances import ContactChange, StanceContact, make_contact_allowances
from service.tasks.contacts.held_pose import KNOWN_WEIGHT, HeldPose
from service.tasks.contacts.known_poses import KnownPoses
from service.tasks.phase_terms import shrink

DEPTH_RESERVE = 1.5e-3  # of an allowance, for the curve between waypoints [m]
POSE_RESERVE = 2.5e-3  # of an allowance in poses, for the motion between them [m]

MOST_SEEDS = 4  # of a pose

_Try = tuple[Float[np.ndarray, "n"], list[Cost[MotionState]], tuple[Float[np.ndarray, "n"], ...]]
"""Where a pose begins, costs of it, and configurations whose distances limit the clearance that is required."""


class StuckError(Exception):
    """A step has no solution; carries the sentences, the best attempt, and the pose that is missing, if it is one."""

    def __init__(
        self,
        step: str,
        reasons: Sequence[str],
        q: Float[np.ndarray, "n"],
        stuck: Stuck | None = None,
        missing: MissingPose | None = None,
    ) -> None:
        super().__init__("; ".join(reasons))
        self.step, self.reasons, self.q, self.stuck, self.missing = step, tuple(reasons), q, stuck, missing


@dataclass(frozen=True)
class MissingPose:
    """A pose that a change of contacts needs and that does not exist with its contacts where they are.

    Attributes:
        held: the pose.
        near: (n,) configuration that it should be near.
    """

    held: HeldPose
    near: Float[np.ndarray, "n"]


@dataclass(frozen=True)
class PoseFinder:
    """Finds the poses that a change of contacts needs.

    Attributes:
        solver: of the robot at its start.
        guesses: poses and motions that are known already.
        noise: (n,) added to guesses of poses.
        arrives_first: whether the pose at the new places is solved before that on what stays.
        keeps_poses: whether poses of an earlier motion are taken where they hold.
    """

    solver: PhaseSolver
    guesses: KnownPoses
    noise: Float[np.ndarray, "n"]
    arrives_first: bool = False
    keeps_poses: bool = True

    @property
    def start(self) -> WholeBody:
        return self.solver.body

    def stand_on(
        self,
        contacts: Sequence[StanceContact],
        touching: Sequence[StanceContact] = (),
        reserve_m: float = DEPTH_RESERVE,
    ) -> WholeBody:
        """Return the robot on contacts, while others may touch; of what may touch, a reserve of depth is kept [m].

        Raises:
            StuckError: the contacts hold it nowhere.
        """
        touches = shrink(make_contact_allowances((*contacts, *touching)), reserve_m)
        planted = tuple(contact.planted for contact in contacts)
        try:
            region = plan_contact_region(self.start.robot, planted)
        except StaticRegionError as error:
            names = ", ".join(contact.patch for contact in contacts)
            raise StuckError(
                f"stand on {names}", (f"{names} hold the robot nowhere: {error}",), self.start.nominal
            ) from None
        return self.start.on_contacts(planted, touches, region)

    def find_between(
        self,
        name: str,
        change: ContactChange,
        at: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"] | None, Float[np.ndarray, "n"] | None]:
        """Return the poses in which the old and the new contacts are in place, held by those kept; None without such.

        The body is where it is in the first of the two that is solved, so that a swing moves little else than what
        swings.
        """
        monitor = self.solver.monitor
        kept, leaving, arriving = change.kept, change.leaving, change.arriving
        known = self.guesses.leave.get(name), self.guesses.arrive.get(name)
        steps = f"{name}: pose on what stays", f"{name}: pose at the new places"
        left = self.take_known(f"{name}: shift", kept, leaving) if leaving else None
        made = self.take_known(f"{name}: land", kept, arriving) if arriving else None
        limbs = free_coordinates(self.stand_on(kept))
        if not self.arrives_first or not arriving or not self._are_moved_by(limbs, leaving):
            if leaving and left is None:
                with monitor.step(steps[0], 0.2):
                    left = self.find(steps[0], kept, leaving, at, known[0])
            if arriving and made is None:
                with monitor.step(steps[1], 0.3):
                    made = self.find(steps[1], kept, arriving, at if left is None else left, known[1])
            return left, made
        if made is None:
            with monitor.step(steps[1], 0.2):
                made = self.find(steps[1], kept, arriving, at, known[1])
        if leaving and left is None:
            near = made.copy()
            near[limbs] = (at if known[0] is None else known[0])[limbs]
            with monitor.step(steps[0], 0.3):
                left = self.find(steps[0], kept, leaving, at, near)
        return left, made

    def _are_moved_by(self, limbs: Int[np.ndarray, "k"], contacts: Sequence[StanceContact]) -> bool:
        """Return whether each contact's link is on a limb that carries nothing."""
        model, supports = self.start.robot.model, self.start.engine.topology.supports
        joints = [int(model.frames[model.getFrameId(contact.planted.link)].parentJoint) for contact in contacts]
        return all(bool(np.any(supports[joint][limbs])) for joint in joints)

    def find(
        self,
        step: str,
        kept: tuple[StanceContact, ...],
        placed: tuple[StanceContact, ...],
        at: Float[np.ndarray, "n"],
        known: Float[np.ndarray, "n"] | None,
        fixed: Mapping[int, float] | None = None,
    ) -> Float[np.ndarray, "n"]:
        """Return a configuration with all contacts in place, held by those kept alone.

        It is near a known one, or near ``at`` without one; coordinates may be fixed.

        Raises:
            StuckError: there is none.
        """
        if not kept:
            raise StuckError(step, (f"{step}: no contact stays where it is",), at)
        robot, one = self.start.robot, np.zeros(1, dtype=int)
        held = HeldPose(self.solver, self.stand_on(kept, placed, POSE_RESERVE), kept, placed, fixed)
        seeds = [("at hand", np.clip(at + self.noise, robot.lower, robot.upper))]
        seeds += posture_guesses(replace(self.start, nominal=at))[1:]
        near = at if known is None else known
        costs: list[Cost[MotionState]] = []
        if known is not None:
            seeds = [("known", np.clip(known + self.noise, robot.lower, robot.upper)), *seeds]
            costs.append(Cost("known pose", JointTarget(1, robot.n, one, np.arange(robot.n), known), KNOWN_WEIGHT))
        seeds = seeds[:MOST_SEEDS]
        tries: list[tuple[str, _Try]] = [(name, (q, costs, ())) for name, q in seeds]
        if costs:  # the cost may hold the pose where it is not feasible
            tries += [(f"{name}, free", (q, [], ())) for name, q in seeds]
        # What is near at the start may stay as near.
        tries += [(f"{name}, as near as now", (q, [], (at,))) for name, q in seeds[:2]]
        solve = lambda one_try: held.solve(one_try[0], near, *one_try[1:])  # noqa: E731
        best = find_pose(PoseProblem(step, solve, self.solver.monitor), tries)
        if best.is_feasible:
            return held.project(best.q)
        reasons = tuple(f"{step}: {line}" for line in best.violations)
        raise StuckError(step, reasons, best.q, missing=MissingPose(held, near))

    def take_known(
        self, phase: str, kept: tuple[StanceContact, ...], placed: tuple[StanceContact, ...]
    ) -> Float[np.ndarray, "n"] | None:
        """Return the configuration in which a phase of the earlier motion ends; None where it does not do any more."""
        known = self.guesses.earlier.curves.get(phase)
        if known is None or not self.keeps_poses or not kept:
            return None
        q = known.positions[-1]
        held = HeldPose(self.solver, self.stand_on(kept, placed, POSE_RESERVE), kept, placed)
        return q if held.holds_at(q) else None
