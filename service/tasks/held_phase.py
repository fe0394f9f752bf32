"""A phase that leads frames, solved in stages: past what it passes between, without loads, with them, strong enough."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, tee
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from service.body.forces.loaded_regions import PlannedRegion
from service.body.ladder import Path
from service.body.phases import PhaseSolver
from service.body.task_plan import Solved
from service.demands.phase import TaskPhase
from service.tasks.held_tool import follow_in_balance

if TYPE_CHECKING:
    from service.tasks.phase_compiler import PhaseCompiler


@dataclass(frozen=True)
class HeldPhase:
    """A phase with a held hand, solved in stages.

    Attributes:
        compiler: of its problems.
        spec: the phase.
        fixed: configuration by waypoint.
        values: of the mechanism's joints at the waypoints.
    """

    compiler: PhaseCompiler
    spec: TaskPhase
    fixed: Mapping[int, Float[np.ndarray, "n"]]
    values: Float[np.ndarray, "T k"]

    def solve(self, solver: PhaseSolver, paths: Iterable[Path]) -> Solved:
        """Solve the phase from the first of some paths that leads to a solution.

        Every stage tries all paths before it restores the best attempt: what is restored has lost its costs, and a
        solution from another path is the better motion.  What the hand passes between would push it to the wrong side
        of a poor path: one that may be in it comes first.  Where loads ask for balance here and there, that is found
        more easily on a path that exists.
        """
        staged = replace(self, compiler=replace(self.compiler, solver=solver))
        spec, compiler = self.spec, staged.compiler
        passes = compiler.hints(spec).passes
        light = replace(staged, compiler=compiler.with_hints(torque_share=None))
        if passes:
            loose = light._solve(paths, (), passes)
            if not loose.is_feasible:
                return loose
            paths = [loose.x]
        regions = self._regions
        if len(regions) > 1:
            own, paths = tee(paths)
            unloaded = light._solve(own, ())
            if not unloaded.is_feasible:  # the regions hold no load as well: they are within the hull of the soles
                return unloaded
            paths = chain([unloaded.x], paths)
            if spec.frames:
                is_fixed = np.isin(np.arange(len(unloaded.x)), list(self.fixed))
                prescribed = compiler.find_prescribed(spec)
                inside = follow_in_balance(solver.body, spec.frames, unloaded.x, regions, is_fixed, prescribed)
                paths = chain([inside], paths)
        solved = light._solve(paths, regions)
        if not solved.is_feasible or compiler.is_strong_enough(spec, solved.x):
            return solved
        return staged._solve([solved.x], regions)

    def repair(self, solver: PhaseSolver, path: Path) -> Solved:
        """Solve the phase from an earlier motion, whose waypoints keep nearly everything, in one stage."""
        staged = replace(self, compiler=replace(self.compiler, solver=solver))
        return staged._solve([path], self._regions)

    @cached_property
    def _regions(self) -> tuple[PlannedRegion, ...]:
        """Where the feet hold the robot under the phase's loads."""
        return self.compiler.find_regions(self.spec, self.values)

    def _solve(
        self, paths: Iterable[Path], regions: tuple[PlannedRegion, ...], passes: tuple[Allowance, ...] = ()
    ) -> Solved:
        spec = replace(self.spec, touches=(*self.spec.touches, *passes))
        return self.compiler.solve(spec, paths, self.fixed, self.values, regions)
