"""Sequences of poses that get out: places drawn, poses solved, the cheapest sequence chosen and linked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.contact_points import MovedPoints
from costs.robot import BASE_NAMES, RobotModel
from costs.scene import Scene
from costs.stopping import poll
from scopt import Status
from service.body.forces.equilibrium_pose import EquilibriumPose
from service.body.phases import Map
from service.demands.contacts.stances import ContactStance
from service.demands.contacts.surfaces import make_surfaces
from service.demands.egress.demand import load_phases
from service.request.tasks.egress import EgressRequest, PhaseRequest
from service.tasks.egress.aims import ContactAim
from service.tasks.egress.chain import Chain, link_poses
from service.tasks.egress.graph import PoseGraph, measure_connection
from service.tasks.egress.poses import STRICT, PoseSolver, measure_cost
from service.tasks.egress.samples import draw_places
from service.tasks.egress.stages import EgressStage, list_lasting, make_stages

SAME_POSE = 1e-2  # largest difference of a coordinate between poses that count as one [rad, m]
SAME_PLACE_M = 1e-6
NEAR = 0.01  # largest violation from which a pose is solved again more strictly [m, rad, share of the weight]
LINKED = 20  # largest number of sequences that are linked before the search is given up

OnPose = Callable[[str, int, float], None]
"""Called with the name of a stage, the number of its poses that hold so far, and the share of all poses."""


@dataclass(frozen=True)
class Node:
    """A feasible pose of a stage for one drawn place.

    Attributes:
        stage: index of the stage.
        sample: index of the place.
        pose: in equilibrium; kept contacts may be elsewhere than in other nodes.
    """

    stage: int
    sample: int
    pose: EquilibriumPose

    @property
    def cost(self) -> float:
        """``C_p`` of the paper."""
        return measure_cost(self.pose)


@dataclass(frozen=True)
class StageCount:
    """Poses of one stage.

    Attributes:
        name: of the stage.
        solved: number of optimisations.
        feasible: of these.
        duplicates: feasible poses that another one equals.
        first_violations: how often each violation came first.
    """

    name: str
    solved: int
    feasible: int
    duplicates: int
    first_violations: Mapping[str, int]


@dataclass(frozen=True)
class PoseSet:
    """Poses of all drawn places.

    Attributes:
        stages: (N,) the stages of each sample.
        nodes: feasible poses without duplicates.
        counts: of each stage that has poses.
    """

    stages: tuple[tuple[EgressStage, ...], ...]
    nodes: tuple[Node, ...]
    counts: tuple[StageCount, ...]


@dataclass(frozen=True)
class EgressSequence:
    """A complete sequence.

    Attributes:
        chain: stances with fixed places and poses that all have the same contact points.
        nodes: the chosen poses before they were linked: the paper's result.
        cost: of the chosen poses by eq. 4 of the paper.
        slip_m: farthest that a kept contact point moves between chosen poses; the chain has none.
        rejected: why cheaper sequences could not be linked, in sentences.
        path: the chosen poses' indices among all nodes.
    """

    chain: Chain
    nodes: tuple[Node, ...]
    cost: float
    slip_m: float
    rejected: tuple[str, ...]
    path: tuple[int, ...] = ()


@dataclass(frozen=True)
class PosePlan:
    """Result of planning poses.

    Attributes:
        search: of sequences, the cheapest first; None where a stage has no pose.
        sequence: the first that could be linked; None if there is none.
        counts: poses of each stage that was sampled, with failures and duplicates.
        reasons: why there is no sequence, in sentences; empty if there is one.
    """

    search: SequenceSearch | None
    sequence: EgressSequence | None
    counts: tuple[StageCount, ...]
    reasons: tuple[str, ...]


def plan_poses(
    robot: RobotModel,
    scene: Scene,
    request: EgressRequest,
    folder: Path = Path(),
    *,
    seed: int = 0,
    map: Map = map,
    should_stop: Callable[[], bool] | None = None,
    start: ContactStance | None = None,
    on_pose: OnPose | None = None,
) -> PosePlan:
    """Draw places, solve poses, and return the cheapest sequence whose poses can be linked.

    Args:
        robot: with contact patches.
        scene: all pieces, those behind surfaces included.
        request: the task.
        folder: of the request, for its phases file.
        seed: of drawn places and starts.
        map: calls a function for every item, in order; that of an executor runs them in parallel.
        should_stop: polled before every trial step.
        start: contacts of the robot as it sits; by default those of the first phase.
        on_pose: called after every pose of a stage.

    Raises:
        RequestError: surfaces or phases that cannot be used.
    """
    stages = make_all_stages(robot, scene, request, load_phases(request, robot, folder), seed)
    stages = stages if start is None else anchor_stages(stages, start)
    solver = PoseSolver.of(robot, scene, request.torque_share, request.margin_n)
    solver = replace(solver, seed=seed, should_stop=should_stop)
    poses = solve_poses(solver, stages, map, on_pose)
    missing = explain_missing(poses)
    if missing:
        return PosePlan(None, None, poses.counts, missing)
    search = SequenceSearch(solver, poses)
    sequence = search.find_next()
    reasons = () if sequence is not None else tuple(dict.fromkeys(search.rejected))
    return PosePlan(search, sequence, poses.counts, reasons)


def anchor_stages(
    stages: Sequence[tuple[EgressStage, ...]], start: ContactStance
) -> tuple[tuple[EgressStage, ...], ...]:
    """Return stages whose first contacts are where a stance has them, for as long as they stay."""
    own = {contact.patch: ContactAim.at(contact) for contact in start.contacts}

    def anchor(sequence: tuple[EgressStage, ...]) -> tuple[EgressStage, ...]:
        first = {id(aim) for aim in sequence[0].aims}
        return tuple(
            replace(stage, aims=tuple(own.get(aim.patch, aim) if id(aim) in first else aim for aim in stage.aims))
            for stage in sequence
        )

    return tuple(anchor(sequence) for sequence in stages)


def make_all_stages(
    robot: RobotModel, scene: Scene, request: EgressRequest, phases: Sequence[PhaseRequest], seed: int = 0
) -> tuple[tuple[EgressStage, ...], ...]:
    """Return the stages of each drawn place.

    Raises:
        RequestError: surfaces or phases that cannot be used.
    """
    surfaces = make_surfaces(request.surfaces, scene, "task.egress.surfaces")
    drawn = draw_places(np.zeros(2), np.ones(2), request.samples, seed)
    return tuple(make_stages(robot, surfaces, phases, place, "task.egress.phases") for place in drawn.tolist())


def solve_poses(
    solver: PoseSolver, stages: Sequence[tuple[EgressStage, ...]], map: Map = map, on_pose: OnPose | None = None
) -> PoseSet:
    """Solve a pose of each sampled stage for each drawn place and nominal pose; of the first and last stage once.

    Args:
        solver: of poses.
        stages: of each drawn place.
        map: calls a function for every item, in order; that of an executor runs them in parallel.
        on_pose: called after every pose of a stage.
    """
    last = len(stages[0]) - 1
    tasks = [
        (k, sample, shape)
        for k in range(last + 1)
        for sample in range(len(stages) if stages[0][k].is_sampled else 1 if k in (0, last) else 0)
        for shape in range(len(stages[sample][k].shapes))
    ]
    poses: list[EquilibriumPose] = []
    feasible_by_stage = Counter[int]()
    for (k, *_), pose in zip(tasks, map(partial(_solve_task, solver, stages), tasks), strict=True):
        poll()
        poses.append(pose)
        feasible_by_stage[k] += pose.is_feasible
        if on_pose is not None:
            on_pose(stages[0][k].name, feasible_by_stage[k], len(poses) / len(tasks))
    nodes: list[Node] = []
    counts = []
    for k in sorted({task[0] for task in tasks}):
        mine = [Node(k, task[1], pose) for task, pose in zip(tasks, poses, strict=True) if task[0] == k]
        feasible = [node for node in mine if node.pose.is_feasible]
        single = _drop_duplicates(feasible)
        nodes += single
        reasons = Counter(node.pose.violations[0] for node in mine if node.pose.violations)
        name = stages[0][k].name
        counts.append(StageCount(name, len(mine), len(feasible), len(feasible) - len(single), dict(reasons)))
    return PoseSet(tuple(stages), tuple(nodes), tuple(counts))


def _solve_task(
    solver: PoseSolver, stages: Sequence[tuple[EgressStage, ...]], task: tuple[int, int, int]
) -> EquilibriumPose:
    k, sample, shape = task
    stage = stages[sample][k]
    pose = solver.solve(stage.aims, stage.shapes[shape])
    worst = max(pose.result.violation.values(), default=0.0)
    if pose.is_feasible or pose.result.status is not Status.STALLED or worst > NEAR:
        return pose
    # The costs of the shape may have led it where nothing is feasible.
    strict = replace(solver.settings, penalty=STRICT * solver.settings.penalty)
    return replace(solver, settings=strict).solve(stage.aims, stage.shapes[shape])


def _drop_duplicates(nodes: Sequence[Node]) -> list[Node]:
    kept: list[Node] = []
    for node in nodes:
        if all(np.abs(node.pose.q - other.pose.q).max() > SAME_POSE for other in kept):
            kept.append(node)
    return kept


def make_graph(solver: PoseSolver, poses: PoseSet) -> PoseGraph:
    """Return the graph of all poses; each stage with poses is a layer, and edges lead to the next one (eq. 3)."""
    nodes = poses.nodes
    used = sorted({node.stage for node in nodes})
    layer = np.array([used.index(node.stage) for node in nodes], dtype=int)
    edges = np.full((len(nodes), len(nodes)), np.inf)
    joints = np.array([node.pose.q[len(BASE_NAMES) :] for node in nodes])
    for k in range(len(used) - 1):
        here, there = np.flatnonzero(layer == k), np.flatnonzero(layer == k + 1)
        points = _choose_points(solver.body.robot, poses.stages[0], used[k], used[k + 1])
        places = [_locate(solver, points, [nodes[i] for i in part]) for part in (here, there)]
        edges[np.ix_(here, there)] = measure_connection(places[0], joints[here], places[1], joints[there])
    return PoseGraph(layer, np.array([node.cost for node in nodes]), edges)


def describe_graph(plan: PosePlan) -> dict[str, Any]:
    """Return the poses of a plan, and the sequence through them (JSON-ready; docs/result-format.md)."""
    search, sequence = plan.search, plan.sequence
    poses = () if search is None else search.poses.nodes
    values = np.zeros(0) if search is None or search.graph is None else search.graph.find_values()
    names = [] if search is None else [stage.name for stage in search.poses.stages[0]]
    return {
        "phases": [
            {
                "name": count.name,
                "solved": count.solved,
                "feasible": count.feasible,
                "duplicates": count.duplicates,
                "failures": dict(count.first_violations),
            }
            for count in plan.counts
        ],
        "poses": [
            {
                "phase": names[node.stage],
                "place": node.sample,
                "cost": node.cost,
                "cost_to_end": float(value) if np.isfinite(value) else None,
                "q": node.pose.q.tolist(),
            }
            for node, value in zip(poses, values if len(values) else np.full(len(poses), np.inf), strict=True)
        ],
        "path": [] if sequence is None else list(sequence.path),
        "cost": None if sequence is None else sequence.cost,
        "slip_m": None if sequence is None else sequence.slip_m,
        "not_linked": [] if search is None else list(search.rejected),
    }


class SequenceSearch:
    """Search for complete sequences through the graph of all poses, the cheapest first.

    Attributes:
        poses: of all drawn places.
        graph: of these poses; None where a stage has none.
        rejected: a sentence for each sequence that could not be linked.
    """

    def __init__(self, solver: PoseSolver, poses: PoseSet, most: int = LINKED) -> None:
        """
        Args:
            solver: of poses.
            poses: of all drawn places.
            most: number of sequences that are linked at most.
        """
        self._solver, self.poses, self._left = solver, poses, most
        is_complete = len({node.stage for node in poses.nodes}) == len(poses.counts)
        self.graph = make_graph(solver, poses) if is_complete else None
        self._without: set[tuple[int, int]] = set()
        self.rejected: list[str] = []

    def find_next(self) -> EgressSequence | None:
        """Return the cheapest sequence that can be linked; None without another one.

        A sequence that cannot be linked loses the edge at which it failed.
        """
        poses = self.poses
        while self.graph is not None and self._left > 0:
            self._left -= 1
            path = self.graph.find_sequence(self._without)
            if path is None:
                return None
            nodes = tuple(poses.nodes[i] for i in path)
            stages = _choose_stages(poses.stages, nodes)
            chain = link_poses(self._solver, stages, {node.stage: node.pose for node in nodes})
            if isinstance(chain, Chain):
                cost, slip = self.graph.measure_cost(path), measure_slip(self._solver, poses.stages[0], nodes)
                return EgressSequence(chain, nodes, cost, slip, tuple(self.rejected), tuple(path))
            self.rejected.append(chain.reason)
            if not self._cut(tuple(path), chain.stage):
                return None  # the first pose is in every sequence
        return None

    def drop(self, sequence: EgressSequence, stage: str | None = None) -> bool:
        """Leave out the edge by which a sequence reaches a stage, or its first free edge.

        Returns:
            Whether another sequence is possible.
        """
        names = [stance.name for stance in sequence.chain.stances]
        return self._cut(sequence.path, 0 if stage not in names else names.index(stage))

    def _cut(self, path: tuple[int, ...], stage: int) -> bool:
        stages = [self.poses.nodes[i].stage for i in path]
        cut = next((k for k, own in enumerate(stages) if own >= stage), len(path) - 1)
        if cut == 0:
            if stage > 0 or len(path) < 3:
                return False
            cut = 2  # the first edge that is not the same in all sequences
        self._without.add((path[cut - 1], path[cut]))
        return True


def find_sequences(
    solver: PoseSolver, poses: PoseSet, most: int = LINKED, rejected: list[str] | None = None
) -> Iterator[EgressSequence]:
    """Yield complete sequences that differ, the cheapest first.

    Args:
        solver: of poses.
        poses: of all drawn places.
        most: number of sequences that are linked at most.
        rejected: filled with a sentence for each sequence that cannot be linked.
    """
    search = SequenceSearch(solver, poses, most)
    if rejected is not None:
        search.rejected = rejected
    while (sequence := search.find_next()) is not None:
        yield sequence
        if not search.drop(sequence):
            return


def explain_missing(poses: PoseSet) -> tuple[str, ...]:
    """Return one sentence per stage that has no pose, with the commonest reason."""
    return tuple(
        f"no pose of '{count.name}' holds for any of {count.solved} starts: "
        f"{max(count.first_violations, key=lambda reason: count.first_violations[reason])}"
        for count in poses.counts
        if not count.feasible
    )


def measure_slip(solver: PoseSolver, stages: Sequence[EgressStage], nodes: Sequence[Node]) -> float:
    """Return the farthest that a contact point which should stay moves between poses of a sequence [m]."""
    slips = [0.0]
    for before, after in pairwise(nodes):
        points = _choose_points(solver.body.robot, stages, before.stage, after.stage)
        places = _locate(solver, points, [before, after])
        slips.append(float(np.linalg.norm(places[0] - places[1], axis=1).max(initial=0.0)))
    return max(slips)


def _choose_stages(stages: Sequence[tuple[EgressStage, ...]], nodes: Sequence[Node]) -> tuple[EgressStage, ...]:
    """Return each stage with the place of the chosen pose that follows it first."""
    sampled = [node for node in nodes if stages[0][node.stage].is_sampled]

    def sample(k: int) -> int:
        return next((node.sample for node in sampled if node.stage >= k), sampled[-1].sample if sampled else 0)

    return tuple(stages[sample(k)][k] for k in range(len(stages[0])))


def _choose_points(robot: RobotModel, stages: Sequence[EgressStage], k: int, later: int) -> MovedPoints:
    """Return the points that should not move between two stages: of contacts that stay, or that turn on the spot."""
    links: list[str] = []
    points: list[Float[np.ndarray, "3"]] = []
    before = {aim.patch: aim for aim in stages[k].aims}
    for aim in stages[later].aims:
        if aim.patch not in before:
            continue
        patch = robot.contacts[aim.patch]
        if later in list_lasting(stages, k, aim.patch):
            points += list(patch.points)
            links += [patch.link] * len(patch.points)
        elif _is_same_place(before[aim.patch], aim):
            points.append(patch.points.mean(axis=0) if aim.mark is None else aim.mark)
            links.append(patch.link)
    return MovedPoints.on_links(robot, links, np.array(points).reshape(-1, 3))


def _is_same_place(aim: ContactAim, other: ContactAim) -> bool:
    if aim.place is None or other.place is None or aim.surface.name != other.surface.name:
        return False
    return bool(np.abs(aim.place - other.place).max() <= SAME_PLACE_M)


def _locate(solver: PoseSolver, points: MovedPoints, nodes: Sequence[Node]) -> Float[np.ndarray, "A C 3"]:
    kinematics = solver.body.engine(np.array([node.pose.q for node in nodes]))
    return points.locate(kinematics, np.arange(len(nodes)))
