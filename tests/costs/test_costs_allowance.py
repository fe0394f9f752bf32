"""Allowances name an owner and a body: whatever things are called, none gets what another is allowed."""

import importlib.util
import itertools
from dataclasses import asdict, astuple, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.allowance import Allowance, BodyIndex, BodyRef
from costs.robot.model import LinkBody
from costs.scene import ConvexPiece

POINTS = np.eye(4)[:, :3]
NAMES = st.sampled_from(["", "*", "hook", "hook/1", "hook/*", "valve", "valve/rim/*", "valve/rim/0", "scene", "None"])
NAMED = NAMES | st.text(max_size=8)


def body(link, name):
    return LinkBody(name, link, 1, POINTS, POINTS)


@st.composite
def worlds(draw):
    """Bodies of links, of which some are the mechanism's, and pieces, all of any names."""
    bodies = [body(*pair) for pair in draw(st.lists(st.tuples(NAMED, NAMED), min_size=1, max_size=6))]
    links = sorted({one.link for one in bodies})
    mechanism = frozenset(draw(st.lists(st.sampled_from(links), max_size=2)))
    pieces = [ConvexPiece(name, POINTS) for name in draw(st.lists(NAMED, max_size=5, unique=True))]
    return bodies, mechanism, pieces


@st.composite
def references(draw):
    owner = draw(st.sampled_from(["robot", "mechanism", "scene"]))
    if owner == "scene":
        return BodyRef("scene", None, draw(NAMED))
    return BodyRef(owner, draw(NAMED), draw(st.none() | NAMED))


@given(worlds(), references(), references())
def test_an_index_finds_the_pairs_that_an_allowance_covers(world, first, second):
    bodies, mechanism, pieces = world
    index = BodyIndex(bodies, mechanism, pieces)
    table = np.zeros(index.shape)
    index.fill(table, first, second, 1.0)
    own = [BodyRef.of_body(one, mechanism) for one in bodies]
    allowance = Allowance(first, second, 0.0)
    everything = [*own, *(BodyRef.of_piece(piece.name) for piece in pieces)]
    for row, column in itertools.product(range(len(own)), range(len(everything))):
        assert table[row, column] == allowance.covers(own[row], everything[column])
        assert allowance.covers(own[row], everything[column]) == allowance.covers(everything[column], own[row])


@pytest.fixture(scope="module")
def strangers_covers():
    """How the replay in examples/ reads an allowance of a result's JSON."""
    path = Path(__file__).parents[2] / "examples" / "replayed_motion.py"
    spec = importlib.util.spec_from_file_location("replayed_motion", path)
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    return program.covers


@given(references(), references(), st.lists(references(), min_size=2, max_size=2))
def test_a_stranger_reads_allowances_as_they_are_meant(strangers_covers, first, second, pair):
    as_json = {"first": asdict(first), "second": asdict(second), "depth": 0.0}
    others = [one for one in (first, second) if one.owner != "scene"]
    swapped = [replace(one, owner="robot" if one.owner == "mechanism" else "mechanism") for one in others]
    for one, other in (pair, (first, second), *itertools.product((first, second), (*pair, *swapped))):
        if None not in (one.body, other.body):
            assert strangers_covers(as_json, astuple(one), astuple(other)) == Allowance(first, second, 0.0).covers(
                one, other
            )


@given(worlds(), references())
def test_a_reference_names_nothing_of_another_owner_or_link(world, ref):
    bodies, mechanism, pieces = world
    everything = [*(BodyRef.of_body(one, mechanism) for one in bodies), *(BodyRef.of_piece(p.name) for p in pieces)]
    for one in everything:
        if ref.names(one):
            assert (ref.owner, ref.link) == (one.owner, one.link)
            assert ref.body in (None, one.body)


@given(worlds(), st.integers(0, 5))
def test_a_whole_link_is_every_body_of_it_and_a_body_is_itself_only(world, number):
    bodies, mechanism, pieces = world
    index, one = BodyIndex(bodies, mechanism, pieces), bodies[number % len(bodies)]
    ref = BodyRef.of_body(one, mechanism)
    of_link = [row for row, other in enumerate(bodies) if other.link == one.link]
    assert index.rows(BodyRef(ref.owner, one.link)) == of_link
    assert index.rows(ref) == [row for row in of_link if bodies[row].name == one.name]


@pytest.mark.parametrize(
    "parts",
    [
        ("world", None, "floor"),
        (None, "hook", None),
        ("scene", None, None),
        ("scene", "hook", "floor"),
        ("robot", None, "hook"),
        ("mechanism", None, None),
        ("robot", 3, None),
        ("robot", "hook", ["hook"]),
    ],
)
def test_a_reference_says_who_has_what(parts):
    with pytest.raises(ValueError, match=r"owner is|a reference to the (scene|robot|mechanism) needs"):
        BodyRef(*parts)
