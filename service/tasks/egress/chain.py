"""A chain of poses whose kept contacts are the same points: stances, and poses on what two stances share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from service.body.forces.equilibrium_pose import EquilibriumPose
from service.demands.contacts.stances import ContactStance, StanceContact, place_patch_as_it_is
from service.tasks.egress.aims import ContactAim
from service.tasks.egress.poses import PoseSolver
from service.tasks.egress.stages import EgressStage, list_lasting

COMPARED = 2  # poses of a limb in its new place, of which the cheaper is taken


@dataclass(frozen=True)
class Transition:
    """Poses between two stances, in equilibrium on the contacts that both have.

    Attributes:
        kept: patches that carry the robot meanwhile.
        leaving: pose with all contacts of the stance before in place; None where none leaves.
        arriving: pose with all contacts of the stance after in place; None where none arrives.
    """

    kept: tuple[str, ...]
    leaving: EquilibriumPose | None
    arriving: EquilibriumPose | None


@dataclass(frozen=True)
class Chain:
    """Stances with every place fixed, a pose for each, and poses between them.

    Attributes:
        stances: in their order.
        poses: (S,) in equilibrium on each stance.
        transitions: (S - 1,) between neighbours.
    """

    stances: tuple[ContactStance, ...]
    poses: tuple[EquilibriumPose, ...]
    transitions: tuple[Transition, ...]

    def list_poses(self) -> tuple[tuple[str, EquilibriumPose], ...]:
        """Return all poses in the order in which the robot takes them, with names."""
        named = [(self.stances[0].name, self.poses[0])]
        for before, after, pose, between in zip(
            self.stances, self.stances[1:], self.poses[1:], self.transitions, strict=False
        ):
            if between.leaving is not None:
                named.append((f"{before.name}, on {', '.join(between.kept)}", between.leaving))
            if between.arriving is not None:
                named.append((f"{after.name}, on {', '.join(between.kept)}", between.arriving))
            named.append((after.name, pose))
        return tuple(named)


@dataclass(frozen=True)
class BrokenChain:
    """A chain that could not be completed.

    Attributes:
        stage: that could not be reached from the one before.
        reason: a sentence.
        poses: solved before it, by name.
    """

    stage: int
    reason: str
    poses: tuple[str, ...]


def link_poses(
    solver: PoseSolver, stages: Sequence[EgressStage], guesses: Mapping[int, EquilibriumPose] | None = None
) -> Chain | BrokenChain:
    """Solve every pose again with the places of kept contacts fixed, and the poses between the stances.

    The first pose of a contact whose place is free decides it.  Where later poses fail with it, the places of the
    guesses of later stages are tried.

    Args:
        solver: of poses.
        stages: in their order.
        guesses: poses of some stages, to start from.
    """
    known = guesses or {}
    stances: list[ContactStance] = []
    poses: list[EquilibriumPose] = []
    transitions: list[Transition] = []
    done: list[str] = []
    here: Float[np.ndarray, "n"] | None = None
    for k, stage in enumerate(stages):
        step: _Step | str = "no place was tried"
        for anchors in _list_anchors(stages, k, known):
            step = _Linker(solver, stages, k, known).link(stances, poses, here, anchors)
            if isinstance(step, _Step):
                break
        if isinstance(step, str):
            return BrokenChain(k, step, tuple(done))
        stances.append(step.stance)
        poses.append(step.pose)
        here = step.pose.q
        if step.transition is not None:
            transitions.append(step.transition)
            last = step.transition.arriving or step.transition.leaving
            here = here if last is None else last.q
        done.append(stage.name)
    return Chain(tuple(stances), tuple(poses), tuple(transitions))


@dataclass(frozen=True)
class _Step:
    stance: ContactStance
    pose: EquilibriumPose
    transition: Transition | None


def _list_anchors(
    stages: Sequence[EgressStage], k: int, known: Mapping[int, EquilibriumPose]
) -> list[tuple[int, EquilibriumPose] | None]:
    """Return poses from which stage ``k`` may take the places of its new contacts: none, then the later ones' last."""
    new = [patch for patch in stages[k].patches if patch not in stages[k].kept]
    lasting = [set(list_lasting(stages, k, patch)) for patch in new]
    common = sorted(set.intersection(*lasting), reverse=True) if lasting else []
    return [None, *((i, known[i]) for i in common if i in known)]


@dataclass(frozen=True)
class _Linker:
    """Solver of one stage of a chain and of the way there."""

    solver: PoseSolver
    stages: Sequence[EgressStage]
    k: int
    known: Mapping[int, EquilibriumPose]

    def link(
        self,
        stances: Sequence[ContactStance],
        poses: Sequence[EquilibriumPose],
        here: Float[np.ndarray, "n"] | None,
        anchor: tuple[int, EquilibriumPose] | None,
    ) -> _Step | str:
        """Return stage ``k`` linked to the stances before it, or a sentence why it cannot be.

        Args:
            stances, poses: of the stages before.
            here: (n,) configuration in which the robot arrives at the last of these stances.
            anchor: a later stage with the pose whose places new contacts take.
        """
        stage = self.stages[self.k]
        before = {contact.patch: contact for contact in stances[-1].contacts} if stances else {}
        kept = tuple(patch for patch in stage.patches if patch in stage.kept and patch in before)
        fixed = {patch: before[patch] for patch in kept}
        if anchor is not None:
            fixed |= self._take_places(anchor[1], [patch for patch in stage.patches if patch not in fixed])
        guesses = [self.known[self.k].q] if self.k in self.known else []
        guesses += [pose.q for pose in poses[-1:]]
        leaving = arriving = None
        if here is not None and len(kept) < len(before):
            aims = [ContactAim.at(contact) for contact in stances[-1].contacts]
            shapes = self.stages[self.k - 1].shapes
            leaving = self.solver.solve_from(aims, shapes, [here, poses[-1].q], kept, since=here)
            if not leaving.is_feasible:
                return self._explain(f"leaving '{stances[-1].name}' on {', '.join(kept)}", leaving)
            guesses.append(leaving.q)
        if stances and len(kept) < len(stage.patches):
            since = here if leaving is None else leaving.q
            left = () if not stances else tuple(contact.patch for contact in stances[-1].contacts)
            swinging = [patch for patch in (*left, *stage.patches) if patch not in kept]
            aims = self._aim(stage, fixed)
            arriving = self.solver.solve_from(
                aims, stage.shapes, guesses, kept, since=since, swinging=swinging, n_compared=COMPARED
            )
            if not arriving.is_feasible:
                return self._explain(f"reaching '{stage.name}' on {', '.join(kept)}", arriving)
            fixed |= self._take_places(arriving, [patch for patch in stage.patches if patch not in fixed])
            guesses = [arriving.q, *guesses]
        pose = self.solver.solve_from(self._aim(stage, fixed), stage.shapes, guesses)
        if not pose.is_feasible:
            return self._explain(f"'{stage.name}'", pose)
        fixed |= self._take_places(pose, [patch for patch in stage.patches if patch not in fixed])
        stance = ContactStance(stage.name, tuple(fixed[patch] for patch in stage.patches))
        return _Step(stance, pose, Transition(kept, leaving, arriving) if stances else None)

    def _take_places(self, pose: EquilibriumPose, patches: Sequence[str]) -> dict[str, StanceContact]:
        """Return contacts where a pose has them, flat on their surfaces."""
        robot, stage = self.solver.body.robot, self.stages[self.k]
        by_patch = {aim.patch: aim for aim in stage.aims}
        return {
            patch: replace(
                place_patch_as_it_is(robot, pose.q, patch, by_patch[patch].surface), slack_m=by_patch[patch].slack_m
            )
            for patch in patches
        }

    def _aim(self, stage: EgressStage, fixed: Mapping[str, StanceContact]) -> list[ContactAim]:
        return [ContactAim.at(fixed[aim.patch]) if aim.patch in fixed else aim for aim in stage.aims]

    @staticmethod
    def _explain(what: str, pose: EquilibriumPose) -> str:
        return f"{what}: {'; '.join(pose.violations)}"
