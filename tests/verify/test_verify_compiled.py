"""The proof by the compiled library decides as the one by numpy and coal does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import random_crowd

from costs.native import find_library, without_library
from service.verify import VerifySettings, verify
from service.verify.clearance.broad_phase import bound_clearances, find_open_intervals, refine_edges
from service.verify.clearance.pair_poses import PairPoses
from service.verify.clearance.pairs import PairIntervals, PairTable, collect_pairs
from service.verify.prepared_motion import PreparedMotion

pytestmark = pytest.mark.skipif(find_library() is None, reason="the library is not built: python costs/native/build.py")
SEEDS = st.integers(0, 2**32 - 1)


def _draw(seed: int) -> tuple[PreparedMotion, PairTable, PairIntervals]:
    """A crowd's pairs near each other and intervals of the broad phase."""
    motion = random_crowd(seed)
    prepared = PreparedMotion(motion)
    table = collect_pairs(motion, prepared.tree)
    knots = motion.curve.knots
    edges, phase = refine_edges(prepared, table, knots, np.zeros(len(knots) - 1, dtype=int))
    floors = np.full((len(edges) - 1, len(table.mover)), -np.inf)
    start = find_open_intervals(table, edges, phase, floors, 0.1)
    return prepared, table.with_chains(prepared.tree, np.unique(start.pair)), start


@settings(max_examples=8)
@given(SEEDS)
def test_poses_bounds_and_separations_are_the_same(seed: int) -> None:
    prepared, table, start = _draw(seed)
    rng = np.random.default_rng(seed)
    rows = rng.integers(len(start), size=20)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions[0] = np.nan
    compiled = PairPoses.at(prepared, table, start, VerifySettings())
    separation = compiled.separation(rows, directions)
    with without_library():
        plain = PairPoses.at(prepared, table, start, VerifySettings())
        wanted = plain.separation(rows, directions)
    assert compiled.bound == pytest.approx(plain.bound, rel=1e-12, abs=1e-15)
    assert compiled.rotation == pytest.approx(plain.rotation, abs=1e-14)
    assert compiled.translation == pytest.approx(plain.translation, abs=1e-14)
    assert separation == pytest.approx(wanted, abs=1e-13)
    assert separation[0] == -np.inf


def test_a_pair_without_a_chain_has_no_bound() -> None:
    prepared, table, start = _draw(3)
    table.chain[:] = -1
    assert np.all(PairPoses.at(prepared, table, start.take(slice(0, 2)), VerifySettings()).bound == np.inf)


@settings(max_examples=8)
@given(SEEDS)
def test_checks_are_decided_the_same_with_clearances_within_the_resolution(seed: int) -> None:
    motion, options = random_crowd(seed), VerifySettings()
    compiled = verify(motion, options)
    with without_library():
        plain = verify(motion, options)
    assert compiled.status == plain.status
    decided, wanted = ([(check.name, check.ok, check.basis) for check in made.checks] for made in (compiled, plain))
    assert decided == wanted
    if plain.min_clearance_m is not None:
        assert compiled.min_clearance_m == pytest.approx(plain.min_clearance_m, abs=options.resolution_m)


@settings(max_examples=6)
@given(SEEDS)
def test_floors_of_the_broad_phase_are_the_same(seed: int) -> None:
    prepared, table, start = _draw(seed)
    edges = np.unique(np.concatenate([start.first, start.last]))
    compiled = bound_clearances(prepared, table, edges, VerifySettings())
    with without_library():
        assert compiled == pytest.approx(bound_clearances(prepared, table, edges, VerifySettings()), abs=1e-13)
