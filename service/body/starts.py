"""Starts of the search for a motion as data: which ways are tried, in which order, with which effort.

A start is a path that the optimiser begins with.  ``POLICIES`` is the one table of starts, ``service.body.ladder``
walks it.  ``python -m benchmarks.planning.starts`` shows which of them lead to motions, and what each costs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from itertools import count

from costs.robot import RobotModel
from service.body.effort import Effort
from service.body.sampling import Tree

MOST_ARM_JOINTS = 8  # with more, draws from all of the joints' space lead nowhere
MOST_CHECKS = 40_000  # of one tree: some seconds
GROWTH = 1.5  # of trees from round to round


class Way(Enum):
    """How the path of a start is made."""

    KNOWN = "earlier motion"
    GIVEN = "path that the phase or the request gives"
    STRAIGHT = "straight line"
    ON_HOLDS = "straight line along the kept poses"
    LED = "path led by the hand"
    POSTURES = "via named postures"
    CORNERS = "via corners"
    TREE = "sampled path"
    SHRUNKEN = "sampled path among shrunken obstacles"


class End(Enum):
    """Which configurations at its end a start leads to."""

    FIRST = "the first that was found"
    OTHERS = "the others that the robot's postures lead to"
    NEAR = "those that random configurations about the start lead to"
    DRAWN = "those that random configurations within the limits lead to"


@dataclass(frozen=True)
class Start:
    """One row of a policy.

    Attributes:
        way: how its path is made.
        effort: of the optimiser.
        end: where it leads.
        tree: of sampled paths.
        share: size of the obstacles of sampled paths, relative to the true ones.
    """

    way: Way
    effort: Effort
    end: End = End.FIRST
    tree: Tree | None = None
    share: float = 1.0

    def draw_anew(self, seed: int, growth: float) -> Start:
        """Return the start with other draws of its tree, if it has one, and more of them."""
        if self.tree is None:
            return self
        checks = int(min(growth * self.tree.most_checks, MOST_CHECKS))
        return replace(self, tree=replace(self.tree, seed=seed, most_checks=checks))


@dataclass(frozen=True)
class Policy:
    """Starts in the order in which they are tried.

    Attributes:
        once: at first.
        rounds: again and again after them, until little time is left; trees grow from round to round.
    """

    once: tuple[Start, ...]
    rounds: tuple[Start, ...] = ()

    def list_starts(self) -> Iterator[tuple[int, Start]]:
        """Yield starts with the number of their round, 0 for what is tried once; each tree has a seed of its own."""
        seed = 0
        for number in count() if self.rounds else range(1):
            growth = GROWTH ** max(number - 1, 0)
            for start in self.rounds if number else self.once:
                yield number, start.draw_anew(seed, growth)
                seed += start.tree is not None


class RobotClass(Enum):
    """Robots that search alike."""

    ARM = "an arm of few joints, so that their space can be searched"
    ARM_ON_BASE = "more joints, none of them held by feet"
    STANDING = "a robot on its feet: it needs trees seldom, and they take longer"


# The effort of a search varies with its seed: several short searches are faster than a long one.  LBKPIECE finds a way
# through shelves, within some hundred checks.  Between bars a tree near the ends, with little clearance, has twice its
# success for the same time.  A way that short trees did not find mostly leads far from both.
SHELVES = Tree(0, 1000, "LBKPIECE1")
BARS = Tree(0, 1000, "RRTConnect", 0.8, 2e-3, 0.1)
WIDE = Tree(0, 8000, "RRTConnect", clearance=2e-3, edge_step=0.05)


def _tree(tree: Tree, checks: int | None = None, *, keeps_holds: bool = False) -> Start:
    checks = tree.most_checks if checks is None else checks
    return Start(Way.TREE, Effort.PATIENT, End.FIRST, replace(tree, most_checks=checks, keeps_holds=keeps_holds))


_KNOWN = Start(Way.KNOWN, Effort.QUICK)
_STRAIGHT = Start(Way.STRAIGHT, Effort.QUICK)
_ON_HOLDS = Start(Way.ON_HOLDS, Effort.PATIENT)
_LED = Start(Way.LED, Effort.PATIENT)
_OTHERS = Start(Way.STRAIGHT, Effort.QUICK, End.OTHERS)
_NEAR = Start(Way.STRAIGHT, Effort.PATIENT, End.NEAR)
_DRAWN = Start(Way.STRAIGHT, Effort.QUICK, End.DRAWN)
_SHRUNKEN = Start(Way.SHRUNKEN, Effort.PATIENT, tree=replace(SHELVES, most_checks=4000), share=0.7)

POLICIES: Mapping[RobotClass, Policy] = {
    RobotClass.ARM: Policy(
        (_KNOWN, _STRAIGHT, _tree(SHELVES), _ON_HOLDS, _LED, _OTHERS, _tree(BARS), _tree(SHELVES, 2000), _tree(WIDE),
         _NEAR),
        (_DRAWN, _tree(BARS, 2000), _tree(SHELVES, 4000), _SHRUNKEN, _tree(WIDE)),
    ),
    RobotClass.ARM_ON_BASE: Policy(
        (_KNOWN, _STRAIGHT, _tree(SHELVES), _ON_HOLDS, _LED, _OTHERS, _tree(BARS), _tree(SHELVES, 2000), _NEAR),
        (_DRAWN, _tree(BARS, 2000), _tree(SHELVES, 4000), _SHRUNKEN, _tree(WIDE)),
    ),
    RobotClass.STANDING: Policy(
        (_KNOWN, _STRAIGHT, _ON_HOLDS, _LED, _OTHERS, Start(Way.POSTURES, Effort.QUICK), _NEAR,
         Start(Way.STRAIGHT, Effort.WHOLE), _tree(SHELVES), _tree(BARS)),
        (_DRAWN, _tree(BARS, 2000), _tree(SHELVES, keeps_holds=True), _SHRUNKEN, _tree(SHELVES, 4000), _tree(WIDE)),
    ),
}  # fmt: skip

# Phases between given poses: what changes contacts, moves a mechanism or solves a problem file.  Their poses are found
# already, and what is gained is the quality of the motion, so that no start is quick.
BETWEEN_POSES = Policy(
    (
        Start(Way.KNOWN, Effort.REPAIR),
        Start(Way.GIVEN, Effort.WHOLE),
        Start(Way.LED, Effort.WHOLE),
        Start(Way.STRAIGHT, Effort.WHOLE),
        Start(Way.POSTURES, Effort.WHOLE),
        Start(Way.CORNERS, Effort.WHOLE),
        Start(Way.TREE, Effort.WHOLE, tree=replace(SHELVES, most_checks=3000)),
        Start(Way.TREE, Effort.WHOLE, tree=replace(SHELVES, most_checks=6000)),
        Start(Way.TREE, Effort.WHOLE, tree=replace(BARS, most_checks=3000)),
    )
)

# Phases that lead a little way off: out of collision, into balance.
DIRECT = Policy((Start(Way.GIVEN, Effort.WHOLE), Start(Way.STRAIGHT, Effort.WHOLE)))


def choose_policy(robot: RobotModel) -> Policy:
    """Return the policy of a robot's reaches."""
    if robot.is_floating:
        return POLICIES[RobotClass.STANDING]
    return POLICIES[RobotClass.ARM if robot.n <= MOST_ARM_JOINTS else RobotClass.ARM_ON_BASE]
