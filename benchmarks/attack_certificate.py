"""Attack the certificate: `python -m benchmarks.attack_certificate [problems per kind] [seed]`.

The default of 100 problems per kind takes a minute or two; 10,000 is the length for a release.

Short random motions, each with a piece put where it hurts: a hair's breadth before or inside the path of one chosen
point at one chosen moment.  Dense sampling, refined at its worst pose, with a distance of its own (non-negative least
squares) judges; a certificate that it refutes is printed and makes the exit code 1.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize_scalar, nnls
from scipy.spatial import ConvexHull

from costs.curve import Curve
from costs.robot import LinkBody, RobotModel, RobotSource
from costs.scene import ConvexPiece, Scene
from service.verify import Motion, Status, verify

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
N_PROBLEMS = 100  # per kind
# Sampled gaps are right to about this [m]: what is deeper refutes, what is farther away should be certified.
JUDGE_M = 2e-6


@dataclass(frozen=True)
class Attack:
    """A motion and how far the piece was put from the point's path [m]; negative: into it."""

    motion: Motion
    offset: float


def main(n_problems: int, seed: int) -> int:
    """Run all kinds of attack and print a table."""
    n_false = 0
    print(f"{'attack':22} {'certified':>9} {'refuted':>8} {'unproven':>8} {'missed':>7} {'FALSE':>6} {'ms':>7}")
    for kind, make in KINDS.items():
        rng = np.random.default_rng([seed, len(kind)])
        found: Counter[str] = Counter()
        spent = 0.0
        for _ in range(n_problems):
            attack = make(rng)
            start = time.process_time()
            status = verify(attack.motion).status
            spent += time.process_time() - start
            found[status.value] += 1
            if status is Status.CERTIFIED:
                found["false"] += attack.offset < 0.0 or sampled_gap(attack.motion) < -JUDGE_M
            else:
                found["missed"] += attack.offset >= 0.0 and sampled_gap(attack.motion) > 1e-4
        n_false += found["false"]
        counts = [found[status.value] for status in (Status.CERTIFIED, Status.VIOLATED, Status.FEASIBLE_AT_SAMPLES)]
        print(f"{kind:22} {counts[0]:9} {counts[1]:8} {counts[2]:8} {found['missed']:7} {found['false']:6}", end="")
        print(f" {1e3 * spent / n_problems:7.1f}")
    print(f"certified although false: {n_false} (target 0)")
    return 1 if n_false else 0


def tiny_piece(rng: np.random.Generator) -> Attack:
    """A speck near the path of a body's vertex, seldom at a knot."""
    return _put(rng, _random_motion(rng, spread=0.4), half=10.0 ** rng.uniform(-4, -2, size=3))


def thin_wall(rng: np.random.Generator) -> Attack:
    """A wall thinner than a step, across the path."""
    return _put(rng, _random_motion(rng, spread=0.4), half=np.array([10.0 ** rng.uniform(-4, -3), 0.5, 0.5]))


def overshoot(rng: np.random.Generator) -> Attack:
    """Cubics with tangents many times their step, so that the extremes lie far from the knots."""
    return _put(rng, _random_motion(rng, spread=0.05, tangent=1.0), half=np.full(3, 0.01))


def counter_rotation(rng: np.random.Generator) -> Attack:
    """Joints about one direction that turn against each other: the link moves without turning."""
    model = pin.Model()
    tip = 0
    for k in range(4):
        tip = model.addJoint(
            tip, pin.JointModelRZ(), pin.SE3(np.eye(3), np.append(rng.uniform(-0.5, 0.5, 2), 0.0)), f"j{k}"
        )
    turn = rng.uniform(0.2, 1.2)
    step = turn * np.array([1.0, -1.0, 1.0, -1.0])
    start = rng.uniform(-1.0, 1.0, 4)
    curve = Curve(np.arange(2.0), np.stack([start, start + step]), np.tile(step, (2, 1)))
    return _put(rng, _motion(model, curve, rng), half=np.full(3, 0.005))


def floating_base(rng: np.random.Generator) -> Attack:
    """A floating base that turns about all three axes while it travels."""
    return _put(rng, _random_motion(rng, spread=0.4, is_floating=True), half=np.full(3, 0.01))


def passing_links(rng: np.random.Generator) -> Attack:
    """No piece but the robot itself: branches that swing past each other."""
    motion = _random_motion(rng, spread=0.4, is_branched=True)
    return Attack(motion, 0.0)


def coarse_samples(rng: np.random.Generator) -> Attack:
    """Few exported samples: the line between them is what counts, and where the piece is put."""
    motion = _random_motion(rng, spread=0.3)
    knots = motion.curve.knots
    samples = np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], int(rng.integers(3, 30)))]))
    exported = Curve(samples, motion.curve(samples), np.zeros((len(samples), motion.robot.n)))
    sampled = Motion(motion.robot, Scene(), motion.curve, samples=samples)
    return _put(rng, sampled, half=np.full(3, 0.005), line=exported)


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
) -> Motion:
    model = pin.Model()
    tip = 0
    if is_floating:
        base = pin.JointModelComposite()
        base.addJoint(pin.JointModelTranslation())
        base.addJoint(pin.JointModelSphericalZYX())
        tip = model.addJoint(0, base, pin.SE3.Identity(), "base")
    for k in range(int(rng.integers(2, 7))):
        axis = rng.normal(size=3)
        kind = pin.JointModelPrismaticUnaligned if rng.random() < 0.2 else pin.JointModelRevoluteUnaligned
        parent = int(rng.integers(0, model.njoints)) if is_branched else tip
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, size=3))
        tip = model.addJoint(parent, kind(axis / np.linalg.norm(axis)), placement, f"j{k}")
    n_knots = int(rng.integers(2, 4))
    steps = rng.uniform(-spread, spread, size=(n_knots, model.nq))
    tangents = rng.uniform(-1.0, 1.0, size=(n_knots, model.nq)) * (2.0 * spread if tangent is None else tangent)
    return _motion(
        model, Curve(np.arange(float(n_knots)), rng.normal(size=model.nq) + np.cumsum(steps, 0), tangents), rng
    )


def _motion(model: pin.Model, curve: Curve, rng: np.random.Generator) -> Motion:
    bodies = []
    for joint in range(1, model.njoints):
        points = rng.uniform(-0.12, 0.12, size=(int(rng.integers(4, 40)), 3))
        vertices = points[ConvexHull(points).vertices]
        bodies.append(LinkBody(f"link{joint}", f"link{joint}", joint, vertices, CUBE * np.abs(vertices).max(axis=0)))
    n = model.nq
    wide = np.full(n, 1e3)
    is_floating = bool(model.joints[1].shortname() == "JointModelComposite")
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
        is_floating=is_floating,
        groups={},
        link_groups={},
        postures={},
        ignored_pairs=neighbours,
        fixed_links=frozenset(),
        mechanism_links=frozenset(),
        source=RobotSource("", "", {}),
    )
    return Motion(robot, Scene(), curve)


def _put(rng: np.random.Generator, motion: Motion, half: np.ndarray, line: Curve | None = None) -> Attack:
    """Put a box where the last body reaches farthest in some direction: its face a chosen offset from that point.

    Nothing of the body reaches beyond that point at any time, so the offset's sign is the truth.
    """
    body = motion.robot.bodies[-1]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)

    def reach(s: float) -> float:
        return float((_placed(motion.robot, _read(motion, line, s), [body])[0] @ direction).max())

    grid = np.linspace(motion.curve.knots[0], motion.curve.knots[-1], 400)
    if line is not None:
        grid = np.union1d(grid, line.knots)
    best = int(np.argmax([reach(float(s)) for s in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    refined = minimize_scalar(lambda s: -reach(s), bounds=(low, high), method="bounded", options={"xatol": 1e-9})
    s = float(refined.x) if -refined.fun > reach(float(grid[best])) else float(grid[best])
    points = _placed(motion.robot, _read(motion, line, s), [body])[0]
    touch = points[(points @ direction).argmax()]
    frame = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), direction).matrix()
    # No deeper than the box is thick: the body's farthest point must lie inside it.
    offset = float(rng.choice([-1.0, 1.0]) * min(10.0 ** rng.uniform(-5, -2), half[0]))
    vertices = touch + offset * direction + (CUBE * half + np.array([half[0], 0.0, 0.0])) @ frame.T
    piece = ConvexPiece("piece", vertices)
    return Attack(Motion(motion.robot, Scene((piece,)), motion.curve, samples=motion.samples), offset)


def _read(motion: Motion, line: Curve | None, s: float) -> np.ndarray:
    """The curve, or the exported samples read linearly."""
    if line is None:
        return np.asarray(motion.curve(np.array([s]))[0])
    return np.array([np.interp(s, line.knots, column) for column in line.positions.T])


def sampled_gap(motion: Motion, n_samples: int = 160) -> float:
    """Smallest signed gap found by sampling: distance, or minus a depth when the hulls overlap [m]."""
    line = None
    if motion.samples is not None:
        line = Curve(motion.samples, motion.curve(motion.samples), np.zeros((len(motion.samples), motion.robot.n)))

    def gap(s: float) -> float:
        return _pose_gap(motion, _read(motion, line, s))

    s = np.linspace(motion.curve.knots[0], motion.curve.knots[-1], n_samples)
    gaps = [gap(float(at)) for at in s]
    best = min(gaps)
    for k in np.argsort(gaps)[:2].tolist():
        low, high = s[max(k - 1, 0)], s[min(k + 1, n_samples - 1)]
        best = min(best, float(minimize_scalar(gap, bounds=(low, high), method="bounded").fun))
    return best


def _pose_gap(motion: Motion, q: np.ndarray) -> float:
    bodies = motion.robot.bodies
    placed = _placed(motion.robot, q, list(bodies))
    best = np.inf
    for i, points in enumerate(placed):
        others = [piece.vertices for piece in motion.scene.pieces]
        for j in range(i):
            pair = (min(bodies[i].link, bodies[j].link), max(bodies[i].link, bodies[j].link))
            others += [] if pair in motion.robot.ignored_pairs else [placed[j]]
        for other in others:
            apart = np.maximum(points.min(axis=0) - other.max(axis=0), other.min(axis=0) - points.max(axis=0))
            if np.linalg.norm(np.maximum(apart, 0.0)) < best:
                best = min(best, _signed_distance(points, other))
    return best


def _placed(robot: RobotModel, q: np.ndarray, bodies: list[LinkBody]) -> list[np.ndarray]:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return [b.vertices @ data.oMi[b.joint].rotation.T + data.oMi[b.joint].translation for b in bodies]


def _signed_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance by non-negative least squares over convex combinations; when they meet, minus a bound of the depth.

    Overlapping hulls are moved apart by small steps along the line of their centres until they no longer meet:
    if they still meet after a shift by d in the best of a few directions, they are at least partly that deep.
    """
    distance = _distance(a, b)
    if distance > 1e-7:
        return distance
    directions = np.vstack([np.eye(3), -np.eye(3), a.mean(axis=0) - b.mean(axis=0)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for depth in (1e-3, 1e-4, 1e-5):
        if all(_distance(a + depth * direction, b) <= 1e-7 for direction in directions):
            return -depth
    return 0.0


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    weight = 1e3
    matrix = np.zeros((5, len(a) + len(b)))
    matrix[:3, : len(a)], matrix[:3, len(a) :] = a.T, -b.T
    matrix[3, : len(a)], matrix[4, len(a) :] = weight, weight
    shares, _ = nnls(matrix, np.array([0.0, 0.0, 0.0, weight, weight]))
    first, second = shares[: len(a)], shares[len(a) :]
    return float(np.linalg.norm(first @ a / first.sum() - second @ b / second.sum()))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else N_PROBLEMS, int(sys.argv[2]) if len(sys.argv) > 2 else 0))
