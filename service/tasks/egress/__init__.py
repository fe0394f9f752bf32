"""Getting out of a vehicle by many contacts: a sequence of poses in equilibrium with identical contact points.

``plan_poses`` does all of it; ``Chain`` is what motions between the poses are planned from.
"""

from service.tasks.egress.chain import BrokenChain, Chain, Transition, link_poses
from service.tasks.egress.plan import (
    EgressSequence,
    PosePlan,
    PoseSet,
    StageCount,
    explain_missing,
    find_sequences,
    make_all_stages,
    plan_poses,
    solve_poses,
)
from service.tasks.egress.poses import PoseSolver
from service.tasks.egress.stages import EgressStage, make_stages

__all__ = [
    "BrokenChain",
    "Chain",
    "EgressSequence",
    "EgressStage",
    "PosePlan",
    "PoseSet",
    "PoseSolver",
    "StageCount",
    "Transition",
    "explain_missing",
    "find_sequences",
    "link_poses",
    "make_all_stages",
    "make_stages",
    "plan_poses",
    "solve_poses",
]
