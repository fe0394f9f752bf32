"""Proof that an object which a yielding hand brings into a hole does not jam there.

Whitney, "Quasi-static assembly of compliantly supported rigid parts", J. Dyn. Sys. Meas. Control 104 (1982): a peg of
radius ``r`` that is ``l`` deep in a hole slides on under a force ``F_z`` along the hole, ``F_x`` across it and a moment
``M`` about its end, wherever it touches the walls, if with ``lam = l / (2 r mu)``

    |F_x / F_z| <= 1 / mu    and    |M / (r F_z) + mu (1 + lam) F_x / F_z| <= lam.

A hand that is held beside the axis, or turned against it, presses with what its stiffness makes of that.  The force
``F_z`` grows until the object moves on, so that it does if the least ``F_z`` with both is not above the largest one.
The region grows with the depth; before both ends can touch, only the first condition counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from service.verify.certificate import Basis, Check, Where
from service.verify.frame_paths import FramePath
from service.verify.motion import HoleTarget
from service.verify.phase_proof import PhaseProof
from service.verify.rounding import round_up
from service.verify.targets.turns import bound_lean
from service.verify.timeline import find_time

FINE_M, FINE_RAD = 2e-4, 2e-3  # bounds are followed to 5 % of these where they are larger


@dataclass(frozen=True)
class HoleForces:
    """What a hand's stiffness exerts on an object in a hole at most.

    Attributes:
        across_n: force across the hole [N].
        moment_n_m: about the object's end in the hole [N m].
        begins_m: depth from which on both ends of the object may touch; infinite where they never do [m].
        needed_n: force along the hole with which the object slides on at every depth [N].
    """

    across_n: float
    moment_n_m: float
    begins_m: float
    needed_n: float

    @staticmethod
    def of(target: HoleTarget, beside_m: float, lean_rad: float) -> HoleForces:
        """Return the forces of a hand that holds an object beside the axis of its hole and leans.

        Args:
            target: the hole, and the hand's stiffness.
            beside_m: largest distance of the object's origin from the axis [m].
            lean_rad: largest angle between both axes [rad].
        """
        beside = beside_m + lean_rad * target.length_m  # of any point of the object
        across = target.stiffness_n_m * beside
        moment = target.turn_stiffness_n_m_rad * lean_rad + across * target.length_m
        # The hole turns the hand until its springs store no more than they do with the object straight in the hole.
        yields = np.hypot(lean_rad, np.sqrt(target.stiffness_n_m / target.turn_stiffness_n_m_rad) * beside)
        turned = lean_rad + float(yields)
        begins = target.play_m / turned if turned * target.depth_m > target.play_m else np.inf
        needed = target.friction * across
        if begins < np.inf:
            share = begins / (2.0 * target.radius_m * target.friction)
            needed = max(needed, (moment / target.radius_m + target.friction * (1.0 + share) * across) / share)
        return HoleForces(across, moment, begins, needed)


def check_hole(proof: PhaseProof, target: HoleTarget) -> Iterator[Check]:
    """Check that the force along a hole is enough for all that the hand's stiffness exerts; unproven where not."""
    phase = proof.phase.name
    path = FramePath.of(proof.prepared, target.frame, np.zeros((1, 3)), proof.settings.rounding, None)

    def beside(s: np.ndarray) -> np.ndarray:
        offset = path.at(s)[0][:, 0] - target.position
        return np.asarray(np.linalg.norm(offset - (offset @ target.axis)[:, None] * target.axis, axis=1))

    off = proof.bound_convex(beside, path.point_deviation, FINE_M)
    lean = bound_lean(proof, path, target.frame_axis, target.axis, FINE_RAD, None)
    forces = HoleForces.of(target, off.bound, lean.bound)
    is_free = bool(forces.needed_n <= target.force_n)
    held = (
        f"{round_up(1e3 * off.bound, 2)} mm beside the axis and {round_up(float(np.rad2deg(lean.bound)), 3)} deg off "
        f"it the hand presses it with up to {forces.across_n:.1f} N across the hole and {forces.moment_n_m:.2f} N m, "
        f"which needs {round_up(forces.needed_n, 1)} N along it at a friction of {target.friction:g}"
    )
    text = f"{target.frame} does not jam during {phase}: {held}, of {target.force_n:g} N"
    if not is_free:
        text = f"not shown that {target.frame} does not jam during {phase}: {held}; force_n is {target.force_n:g} N"
    x, y, z = path.origin_at(off.s).tolist()
    where = Where(off.s, find_time(proof.prepared.motion.law, off.s), (x, y, z), (target.frame,))
    basis = Basis.PROOF if is_free else Basis.UNPROVEN
    yield Check(f"jam.{phase}.{target.frame}", True, forces.needed_n, target.force_n, "N", text, where, basis)
