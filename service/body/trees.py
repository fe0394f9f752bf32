"""Trees of a reach, in the order in which they are tried."""

from __future__ import annotations

import numpy as np

from service.body.sampling import Tree

# The effort of a search varies with its seed: several short searches are faster than a long one.
# Where joints turn far, most of their space leads nowhere: trees draw near the ends, everywhere, or within a turn.
NEAR, EVERYWHERE, IN_A_TURN = 0.8, float(np.pi), float(np.inf)
# Paths through gaps narrower than twice the margin: clearance [m], and step at which edges are checked [rad, m].
NARROW = (2e-3, 0.05)
BARS = (2e-3, 0.1)  # between bars
# LBKPIECE finds a way through shelves, within some hundred checks. Between bars a tree near the ends, with little
# clearance, has twice its success for the same time. They take turns.
TREES = (
    Tree(0, 1000, "LBKPIECE1"),
    Tree(1, 1000, "RRTConnect", NEAR, *BARS),
    Tree(2, 2000, "LBKPIECE1"),
    Tree(3, 1000, "RRTConnect", NEAR, *BARS),
    Tree(4, 2000, "RRTConnect", NEAR, *BARS),
    Tree(5, 2000, "RRTConnect", NEAR, *NARROW),
    Tree(6, 4000, "RRTConnect", IN_A_TURN, *NARROW),
    Tree(7, 4000, "LBKPIECE1", NEAR, *NARROW),
    Tree(8, 8000, "RRTConnect", EVERYWHERE, *NARROW),
)
# An arm that four short trees led nowhere has to leave the region of its ends more often than it has a way near them.
# With more joints draws from all of their space lead nowhere.
MOST_ARM_JOINTS = 8
ARM_TREES = (*TREES[:4], TREES[8], *TREES[4:8])
LARGE_TREES = (
    Tree(0, 8000, "RRTConnect", IN_A_TURN, *NARROW),
    Tree(0, 8000, "LBKPIECE1", NEAR, *NARROW),
    Tree(0, 8000, "RRTConnect", NEAR, *NARROW),
    Tree(0, 8000, "RRTConnect", EVERYWHERE),
    Tree(0, 8000, "LBKPIECE1", EVERYWHERE, *NARROW),
)
