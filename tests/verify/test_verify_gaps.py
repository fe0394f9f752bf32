"""Where a clearance proof leaves a pair open, the certificate says so: pair and stretch."""

import json
from itertools import pairwise

import coal
import numpy as np
import pytest
from told_results import told_results

from service.start.standing import place_bodies
from service.verify import Basis, Certificate, Status
from service.verify.solids import make_coal_convex


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return told_results(tmp_path_factory.mktemp("gaps"))


@pytest.mark.parametrize("name", ["free", "past a post", "out of a block", "a wheel"])
def test_a_certified_motion_has_no_gap(results, name):
    certificate = results[name]().certificate
    assert certificate.status is Status.CERTIFIED
    assert certificate.gaps.pair == ()


@pytest.mark.parametrize("name", ["through a wall", "through a wall, untimed", "out of a block, forbidden"])
def test_every_pose_in_collision_lies_in_a_gap_of_its_pair(results, name):
    result = results[name]()
    motion, gaps = result.motion, result.certificate.gaps
    (piece,) = motion.scene.pieces
    wall, here = make_coal_convex(piece.vertices), coal.Transform3s()
    n_inside = 0
    for s in np.linspace(motion.curve.knots[0], motion.curve.knots[-1], 400):
        for body, vertices in place_bodies(motion.robot, motion.curve(np.array([s]))[0]):
            shape, request = make_coal_convex(vertices), coal.DistanceRequest()
            if coal.distance(shape, here, wall, here, request, coal.DistanceResult()) < -1e-5:
                n_inside += 1
                rows = [k for k, pair in enumerate(gaps.pair) if gaps.pairs[pair] == (body.name, piece.name)]
                assert any(gaps.first[k] <= s <= gaps.last[k] for k in rows), (body.name, s)
    assert n_inside >= 7


def test_what_is_refuted_or_unproven_has_its_place_in_a_gap(results):
    for name in ("through a wall", "past a post, proof cut short", "out of a block, forbidden"):
        certificate = results[name]().certificate
        told = [c for c in certificate.checks if c.name == "clearance" and (not c.ok or c.basis is Basis.UNPROVEN)]
        assert told
        gaps = certificate.gaps
        for check in told:
            rows = [k for k, pair in enumerate(gaps.pair) if gaps.pairs[pair] == check.where.names]
            assert any(gaps.first[k] <= check.where.s <= gaps.last[k] for k in rows), check.text
            assert all(not gaps.lower[k] > 0.0 for k in rows)


def test_gaps_of_a_pair_do_not_touch_each_other(results):
    gaps = results["past a post, proof cut short"]().certificate.gaps
    spans = sorted(zip(gaps.pair, gaps.first, gaps.last, strict=True))
    for (pair, _, end), (other, start, _) in pairwise(spans):
        assert pair != other or end < start


def test_gaps_survive_writing_and_reading_and_older_certificates_have_none(results):
    certificate = results["through a wall"]().certificate
    assert Certificate.from_json(certificate.to_json()).gaps == certificate.gaps
    data = certificate.to_dict()
    del data["gaps"]
    assert Certificate.from_json(json.dumps(data)).gaps.pair == ()
