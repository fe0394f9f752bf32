"""Attack the certificate: `python -m benchmarks.certificate.random_problems --count 10000 --seed 0`.

Short random motions, each with a piece just in front of or just inside the path of one chosen point at one chosen
moment.  Dense sampling (:mod:`benchmarks.certificate.judge`) looks for a pose that is nearer than the
certificate says; a certificate that it refutes is printed and makes the exit code 1.  The default of 700 problems takes
half a minute, 10,000 (the length for a release) some minutes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from benchmarks.certificate.judge import Mechanism, least_gap, read
from costs.curve import Curve
from costs.robot import LinkBody, RobotModel, RobotSource
from costs.scene import ConvexPiece, Scene
from service.verify import Motion, Status, verify

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
# A motion with more than this clearance at every sample should be certified [m].
MISSED_M = 1e-4
TITLE = f"{'attack':22} {'count':>7} {'certified':>9} {'refuted':>8} {'unproven':>8} {'missed':>7} {'FALSE':>6}"


@dataclass(frozen=True)
class Attack:
    """A motion and the distance of the piece from the point's path [m]; negative inside it."""

    mechanism: Mechanism
    motion: Motion
    offset: float


def main(count: int, seed: int) -> int:
    """Run attacks of all kinds in turn and print a table."""
    found = {kind: Counter[str]() for kind in KINDS}
    spent = {"certificate": 0.0, "judge": 0.0}
    for index in range(count):
        kind = tuple(KINDS)[index % len(KINDS)]
        attack = KINDS[kind](np.random.default_rng([seed, index]))
        start = time.process_time()
        certificate = verify(attack.motion)
        middle = time.process_time()
        status, claim = certificate.status, certificate.min_clearance_m
        found[kind][status.value] += 1
        if status is Status.CERTIFIED:
            gap = least_gap(attack.mechanism, attack.motion, claim)
            if attack.offset < 0.0 or np.isfinite(gap):
                found[kind]["false"] += 1
                print(f"FALSE: {kind}, --seed {seed}, problem {index}: {claim:.7f} m claimed, {gap:.7f} m found")
        elif attack.offset >= 0.0:
            found[kind]["missed"] += not np.isfinite(least_gap(attack.mechanism, attack.motion, MISSED_M))
        spent["certificate"] += middle - start
        spent["judge"] += time.process_time() - middle
    print(TITLE)
    for kind, counts in found.items():
        print(_row(kind, counts))
    total = sum(found.values(), Counter[str]())
    print(_row("all", total))
    each = ", ".join(f"{name} {1e3 * seconds / max(count, 1):.1f} ms" for name, seconds in spent.items())
    certified = total[Status.CERTIFIED.value]
    print(f"{count} problems, {certified} certified, {total['false']} false claims (target 0); CPU per problem: {each}")
    return 1 if total["false"] else 0


def _row(name: str, found: Counter[str]) -> str:
    counts = [found[status.value] for status in (Status.CERTIFIED, Status.VIOLATED, Status.FEASIBLE_AT_SAMPLES)]
    columns = [sum(counts), *counts, found["missed"], found["false"]]
    return f"{name:22} " + " ".join(f"{n:{w}}" for n, w in zip(columns, (7, 9, 8, 8, 7, 6), strict=True))


def tiny_piece(rng: np.random.Generator) -> Attack:
    """Place a tiny piece near the path of a body's vertex, seldom at a knot."""
    return _put(rng, *_random_motion(rng, spread=0.4), half=10.0 ** rng.uniform(-4, -2, size=3))


def thin_wall(rng: np.random.Generator) -> Attack:
    """Place a wall thinner than a step across the path."""
    return _put(rng, *_random_motion(rng, spread=0.4), half=np.array([10.0 ** rng.uniform(-4, -3), 0.5, 0.5]))


def overshoot(rng: np.random.Generator) -> Attack:
    """Make cubics with tangents many times their step, so that the extremes lie far from the knots."""
    return _put(rng, *_random_motion(rng, spread=0.05, tangent=1.0), half=np.full(3, 0.01))


def counter_rotation(rng: np.random.Generator) -> Attack:
    """Turn joints with parallel axes against each other: the link moves without turning."""
    origins = np.column_stack([rng.uniform(-0.5, 0.5, (4, 2)), np.zeros(4)])
    still, axes = np.tile(np.eye(3), (4, 1, 1)), np.tile(np.eye(3)[2], (4, 1))
    mechanism = Mechanism((-1, 0, 1, 2), still, origins, axes, (False,) * 4, False)
    step = rng.uniform(0.2, 1.2) * np.array([1.0, -1.0, 1.0, -1.0])
    start = rng.uniform(-1.0, 1.0, 4)
    curve = Curve(np.arange(2.0), np.stack([start, start + step]), np.tile(step, (2, 1)))
    return _put(rng, mechanism, _motion(mechanism, curve, rng), half=np.full(3, 0.005))


def floating_base(rng: np.random.Generator) -> Attack:
    """Turn a floating base about all three axes while it travels."""
    return _put(rng, *_random_motion(rng, spread=0.4, is_floating=True), half=np.full(3, 0.01))


def passing_links(rng: np.random.Generator) -> Attack:
    """Swing branches of the robot past each other, without a piece."""
    return Attack(*_random_motion(rng, spread=0.4, is_branched=True), 0.0)


def coarse_samples(rng: np.random.Generator) -> Attack:
    """Export few samples and place the piece at the line between them."""
    mechanism, motion = _random_motion(rng, spread=0.3)
    knots = motion.curve.knots
    samples = np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], int(rng.integers(3, 30)))]))
    return _put(rng, mechanism, replace(motion, samples=samples), half=np.full(3, 0.005))


KINDS: dict[str, Callable[[np.random.Generator], Attack]] = {
    "tiny piece": tiny_piece,
    "thin wall": thin_wall,
    "overshooting cubic": overshoot,
    "counter-rotation": counter_rotation,
    "floating base": floating_base,
    "passing links": passing_links,
    "coarse samples": coarse_samples,
}


def _random_motion(
    rng: np.random.Generator,
    spread: float,
    *,
    tangent: float | None = None,
    is_floating: bool = False,
    is_branched: bool = False,
) -> tuple[Mechanism, Motion]:
    n = int(rng.integers(2, 7))
    axes = rng.normal(size=(n, 3))
    mechanism = Mechanism(
        tuple(int(rng.integers(-1, k)) if is_branched else k - 1 for k in range(n)),
        np.array([pin.exp3(turn) for turn in rng.normal(size=(n, 3))]),
        rng.uniform(-0.3, 0.3, size=(n, 3)),
        axes / np.linalg.norm(axes, axis=1)[:, None],
        tuple((rng.random(n) < 0.2).tolist()),
        is_floating,
    )
    n_knots, n_q = int(rng.integers(2, 4)), n + 6 * is_floating
    steps = rng.uniform(-spread, spread, size=(n_knots, n_q))
    tangents = rng.uniform(-1.0, 1.0, size=(n_knots, n_q)) * (2.0 * spread if tangent is None else tangent)
    curve = Curve(np.arange(float(n_knots)), rng.normal(size=n_q) + np.cumsum(steps, 0), tangents)
    return mechanism, _motion(mechanism, curve, rng)


def _motion(mechanism: Mechanism, curve: Curve, rng: np.random.Generator) -> Motion:
    model = mechanism.model()
    bodies = []
    for joint in range(1, model.njoints):
        points = rng.uniform(-0.12, 0.12, size=(int(rng.integers(4, 40)), 3))
        vertices = points[ConvexHull(points).vertices]
        bodies.append(LinkBody(f"link{joint}", f"link{joint}", joint, vertices, CUBE * np.abs(vertices).max(axis=0)))
    n = model.nq
    wide = np.full(n, 1e3)
    neighbours = frozenset(
        (min(a, b), max(a, b)) for k in range(2, model.njoints) for a, b in [(f"link{k}", f"link{model.parents[k]}")]
    )
    robot = RobotModel(
        name="random",
        model=model,
        joint_names=tuple(f"q{k}" for k in range(n)),
        lower=-wide,
        upper=wide,
        velocity=wide,
        acceleration=wide,
        effort=wide,
        bodies=tuple(bodies),
        is_floating=mechanism.is_floating,
        groups={},
        link_groups={},
        postures={},
        ignored_pairs=neighbours,
        fixed_links=frozenset(),
        mechanism_links=frozenset(),
        source=RobotSource("", "", {}),
    )
    return Motion(robot, Scene(), curve)


def _put(rng: np.random.Generator, mechanism: Mechanism, motion: Motion, half: np.ndarray) -> Attack:
    """Place a box where the last body reaches farthest in some direction, its face at a chosen offset from that point.

    Nothing of the body reaches beyond that point at any time, so the offset's sign is the truth.
    """
    body = motion.robot.bodies[-1]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)

    def placed(s: np.ndarray) -> np.ndarray:
        turned, moved = mechanism.place(read(motion, s))
        k = body.joint - 1
        return np.asarray(body.vertices @ np.swapaxes(turned[:, k], -1, -2) + moved[:, k, None])

    s = np.linspace(motion.curve.knots[0], motion.curve.knots[-1], 400)
    s = s if motion.samples is None else np.union1d(s, motion.samples)
    for _ in range(7):  # each round looks 20 times closer
        best = int((placed(s) @ direction).max(axis=1).argmax())
        at = s[best : best + 1]
        s = np.union1d(np.linspace(s[max(best - 1, 0)], s[min(best + 1, len(s) - 1)], 41), at)
    points = placed(at)[0]
    touch = points[(points @ direction).argmax()]
    frame = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), direction).matrix()
    # No deeper than the box is thick: the body's farthest point must lie inside it.
    offset = float(rng.choice([-1.0, 1.0]) * min(10.0 ** rng.uniform(-5, -2), half[0]))
    vertices = touch + offset * direction + (CUBE * half + np.array([half[0], 0.0, 0.0])) @ frame.T
    return Attack(mechanism, replace(motion, scene=Scene((ConvexPiece("piece", vertices),))), offset)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description="Attack the certificate with short random problems.")
    arguments.add_argument("--count", type=int, default=700, help="problems in all")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    sys.exit(main(given.count, given.seed))
