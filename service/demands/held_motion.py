"""Demands of a request, and a recorded motion held to them.

The promises of the motion's phases are made anew from the request; differences in robot, scene, path, speed and
promises are listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np

from costs.allowance import Allowance
from costs.robot import RobotModel, read_joint_axis
from costs.robot.carried import MovableObject
from costs.scene import Scene
from service.demands.distances import Distances
from service.demands.neighbours import make_neighbour_allowances
from service.demands.phase import TaskPhase
from service.demands.stance import (
    Stance,
    list_planted_feet,
    make_escape_allowances,
    make_resting_allowances,
    make_standing_allowances,
)
from service.demands.targets import make_kept_target
from service.demands.task_demand import TaskDemand, World
from service.request.schema import PlanRequest
from service.start.overlaps import find_hull_overlaps
from service.start.resting import find_rests
from service.verify import (
    Approach,
    Certificate,
    Motion,
    Phase,
    SupportPolygon,
    Target,
    bodies_hash,
    list_waived_checks,
    outside_polygon,
    robot_hash,
    scene_hash,
)

ESCAPE, RAISE = "escape", "raise"  # phases that may come first: out of overlaps, and off what carried bodies rest on
PACE_TOLERANCE = 0.01  # share of a speed or an acceleration that may be used in addition
BORDER_ROUNDING = 1e-9  # of path parameters, and of tangents that vanish
SAME = 1e-6  # numbers of a request and of a record that agree [m, rad]


@dataclass(frozen=True)
class Demands:
    """Demands of a request on every motion that answers it.

    Attributes:
        world: the request with its robot and scene.
        task: what its task demands.
    """

    world: World
    task: TaskDemand

    @property
    def request(self) -> PlanRequest:
        """The request."""
        return self.world.request

    @property
    def robot(self) -> RobotModel:
        """The robot without what the task moves."""
        return self.world.robot

    @property
    def feet(self) -> tuple[str, ...]:
        """Planted links."""
        feet = self.task.feet
        return list_planted_feet(self.robot, self.request.options.feet) if feet is None else feet


@dataclass(frozen=True)
class HeldMotion:
    """Recorded motion with the promises of a request.

    Attributes:
        motion: the recorded curve, time law, samples and phases' borders; everything else from the request.
        differences: one sentence for each statement of the record that is not the request's.
    """

    motion: Motion
    differences: tuple[str, ...]


def hold_to_request(demands: Demands, recorded: Motion) -> HeldMotion:
    """Make a recorded motion's promises anew from a request.

    Only choices are kept from the record: curve, time law, samples, and where phases begin and end.

    Raises:
        ValueError: the request's feet do not span a polygon.
    """
    task, robot = demands.task, demands.task.augment(demands.robot)
    differences = list(compare_world(demands, robot, recorded))
    if recorded.robot.joint_names != robot.joint_names:
        return HeldMotion(recorded, tuple(differences))
    differences += compare_path(demands, recorded)
    demanded = task.demand_phases(demands.world, robot, recorded)
    differences += compare_rests(recorded, demanded.phases)
    standing = _Standing.of(demands, robot)
    phases = tuple(standing.rebuild(recorded, *one) for one in enumerate(demanded.phases))
    differences += demanded.problems
    for phase, own in zip(recorded.phases, phases, strict=True):
        differences += compare_phase(phase, own, has_own_targets=task.has_own_targets)
    waived = list_waived_checks(
        is_timed=demands.request.options.timed,
        is_balanced=standing.stance.hull is not None or task.changes_contacts or not demands.robot.is_floating,
    )
    if recorded.waived != waived:
        differences.append("the record waives other checks than the request")
    options = demands.request.options
    distances = Distances.of(options, demands.world.scene)
    if recorded.clearance_m != distances.clearance_m:
        differences.append("the record demands another clearance than the request")
    if recorded.sway != distances.sway:
        differences.append("the record lets the base sway in another way than the request")
    if recorded.padding != distances.padding:
        differences.append("the record demands another padding than the request")
    if recorded.jerk_scale != options.jerk_scale:
        differences.append("the record limits the jerk in another way than the request")
    if recorded.tool_speed_m_s != options.tool_speed_m_s:
        differences.append("the record limits the speed of the tools in another way than the request")
    if recorded.pace != options.pace:
        differences.append("the record keeps the margins of another pace than the request's")
    approach = Approach.of(demands.request.hand_servo)
    if not _same(recorded.approach, approach):
        differences.append("the record lets hands come to what they press in another way than the request")
    start_rates, end_rates = demands.request.end_rates
    if (dict(recorded.start_rates), dict(recorded.end_rates)) != (start_rates, end_rates):
        differences.append("the record begins or ends at other rates than the request demands")
    releases = () if task.moved is None else task.moved.releases
    if not _same(recorded.releases, releases):
        differences.append("the releases of the mechanism's latches are not those of the request")
    if not _same(tuple(map(_describe, recorded.objects)), tuple(map(_describe, task.objects))):
        differences.append("the objects that hands carry are not those of the request")
    continues = None if demands.request.resume is None else demands.request.resume.plan
    if recorded.continues != continues:
        differences.append("the plan that the motion continues is not the request's")
    motion = replace(
        recorded,
        robot=robot,
        scene=demands.world.scene,
        phases=phases,
        mechanism_links=robot.mechanism_links,
        waived=waived,
        clearance_m=distances.clearance_m,
        sway=distances.sway,
        padding=distances.padding,
        jerk_scale=options.jerk_scale,
        tool_speed_m_s=options.tool_speed_m_s,
        pace=options.pace,
        approach=approach,
        start_rates=start_rates,
        end_rates=end_rates,
        releases=releases,
        continues=continues,
        objects=task.objects,
    )
    return HeldMotion(motion, tuple(differences))


@dataclass(frozen=True)
class _Standing:
    """What every phase promises besides its own: feet, balance, the way out of overlaps, and what is kept.

    Attributes:
        stance: planted feet and support polygon.
        floors: allowances of planted links on floors.
        leaving: allowances of the first phase by its name: of overlaps, and of what carried bodies rest on.
        neighbours: allowances of what the mechanism is near at the start.
        kept: targets of all phases.
        joint_names: of the robot, the mechanism's last.
        margin_m: how far the centre of mass stays inside the region of a phase's own contacts.
        scene: all pieces.
    """

    stance: Stance
    floors: tuple[Allowance, ...]
    leaving: dict[str, tuple[Allowance, ...]]
    neighbours: tuple[Allowance, ...]
    kept: tuple[Target, ...]
    joint_names: tuple[str, ...]
    margin_m: float
    scene: Scene

    @staticmethod
    def of(demands: Demands, augmented: RobotModel) -> _Standing:
        """Make the promises from the request, with the robot augmented by what the task moves."""
        request, robot, feet, task = demands.request, demands.robot, demands.feet, demands.task
        start, scene = demands.world.start, demands.world.scene
        is_balanced = task.is_balanced and robot.can_balance and not task.changes_contacts
        stance = Stance.of(robot, start, feet, request.options.balance_margin_m, is_balanced)
        carried = [item.name for item in request.attached] if task.can_escape else []
        rests = find_rests(robot, start, scene.pieces, carried)
        leaves = request.options.escape and task.can_escape
        inside = find_hull_overlaps(robot, start, scene, feet, rests) if leaves else []
        resting = make_resting_allowances(rests)
        leaving = {ESCAPE: (*make_escape_allowances(inside), *resting), RAISE: resting}
        kept = tuple(make_kept_target(robot, start, keep) for keep in request.keep)
        neighbours: tuple[Allowance, ...] = ()
        if task.moved is not None:
            neighbours = make_neighbour_allowances(augmented, scene, np.concatenate([start, task.moved.start]))
        return _Standing(
            stance,
            make_standing_allowances(robot, stance.contacts, scene),
            leaving,
            neighbours,
            kept,
            augmented.joint_names,
            request.options.balance_margin_m,
            scene,
        )

    def rebuild(self, recorded: Motion, index: int, demand: TaskPhase) -> Phase:
        """Return one phase of a record with the promises of the request."""
        phase = recorded.phases[index]
        own = Phase(
            name=phase.name,
            first=phase.first,
            last=phase.last,
            allowances=(*demand.touches, *self.neighbours),
            targets=(*demand.list_targets(self.joint_names, phase.last), *self.kept),
            loads=demand.loads,
            pushes=demand.pushes,
            pressed=demand.pressed,
            carriers=demand.carriers,
            regions=phase.regions,  # evidence, which the verifier proves
        )
        if demand.contacts is not None:
            planted = tuple(contact.planted for contact in demand.contacts)
            return replace(own, contacts=planted, region_margin_m=self.margin_m)
        first = recorded.curve(np.array([phase.first]))[0, : self.stance.robot.n]
        leaving = self.leaving.get(phase.name, ()) if index == 0 else ()
        stance, floors = self.stance, self.floors
        if demand.stands is not None:
            feet = tuple(contact.link for contact in stance.contacts)
            stance = Stance.of(stance.robot, demand.stands, feet, stance.margin_m, stance.hull is not None)
            floors = make_standing_allowances(stance.robot, stance.contacts, self.scene)
        return replace(
            own,
            contacts=stance.contacts,
            allowances=(*floors, *leaving, *own.allowances),
            support=stance.support(phase.name, first),
            region_margin_m=stance.region_margin(phase.name, first),
        )


def compare_world(demands: Demands, robot: RobotModel, recorded: Motion) -> Iterator[str]:
    """Yield a sentence for each difference in robot, mechanism and scene."""
    if recorded.robot.joint_names != robot.joint_names:
        yield "the motion's joints are not those of the robot and the task's mechanism"
    elif robot_hash(recorded.robot) != robot_hash(robot):
        yield "the robot is not the request's"
    elif bodies_hash(recorded.robot) != bodies_hash(robot):
        yield "the bodies, or the ignored pairs, are not those of the robot and the task's mechanism"
    elif not _have_same_joints(recorded.robot, robot, demands.robot.n):
        yield "the task's mechanism does not move as the request demands"
    if scene_hash(recorded.scene) != scene_hash(demands.world.scene):
        yield _scene_difference(recorded.scene, demands.world.scene)


def compare_path(demands: Demands, recorded: Motion) -> Iterator[str]:
    """Yield a sentence for each difference in start, time law and fixed joints."""
    q = recorded.curve.positions[:, : demands.robot.n]
    off = np.abs(q[0] - demands.world.start)
    if off.max(initial=0.0) > SAME:
        joint = demands.robot.joint_names[int(off.argmax())]
        yield f"the motion starts {off.max():.3g} away from the request's start at {joint}"
    if demands.request.options.timed and recorded.law is None:
        yield "the request demands a timed motion, and the record has no time law"
    yield from demands.task.find_strays(demands.world, q)
    names = [phase.name for phase in recorded.phases]
    if {ESCAPE, RAISE} & {*names[1:]}:
        yield "only the first phase may escape from an overlap at the start, or raise what rests on something"


def compare_rests(recorded: Motion, demanded: Sequence[TaskPhase]) -> Iterator[str]:
    """Yield a sentence for each border of phases where the robot moves instead of resting, or the other way round."""
    for before, phase in zip(demanded, recorded.phases[1:], strict=False):
        rests = _rests(recorded, phase.first)
        if not before.flows and not rests:
            yield f"phase '{phase.name}' begins while the robot moves; it must rest there"
        elif before.flows and rests:
            yield f"phase '{phase.name}' begins at rest; the robot must go on there"


def compare_phase(recorded: Phase, own: Phase, has_own_targets: bool) -> Iterator[str]:
    """Yield a sentence for each promise of a recorded phase that is not the request's."""
    if not _same_support(recorded.support, own.support):
        yield f"support of phase '{recorded.name}' are not those of the request"
    names = ("contacts", "allowances", "loads", "region_margin_m", "carriers")
    for name in (*names, *(() if has_own_targets else ("targets",))):
        if not _same(getattr(recorded, name), getattr(own, name)):
            yield f"{name} of phase '{recorded.name}' are not those of the request"
    if recorded.pressed is None:  # a record of an earlier release says neither what is pressed nor by which contacts
        return
    if not _same(recorded.pushes, own.pushes):
        yield f"pushes of phase '{recorded.name}' are not the contacts, forces and friction of the request"
    if not _same(recorded.pressed, own.pressed):
        yield f"pressed of phase '{recorded.name}' are not the parts, or not the counts of the scan"


def compare_pace(request: PlanRequest, certificate: Certificate) -> Iterator[str]:
    """Yield a sentence where a motion uses more of the robot's speed or acceleration limits than the request allows."""
    options = request.options
    for name, share in (("speed", options.speed_share), ("acceleration", options.acceleration_share)):
        for check in certificate.checks:
            if check.name == f"limits.{name}" and check.value > share * (1.0 + PACE_TOLERANCE):
                used, most = 100.0 * check.value, 100.0 * share
                yield f"the motion uses {used:.0f} % of the {name} limits, the request at most {most:g} %"


def _have_same_joints(first: RobotModel, second: RobotModel, n_own: int) -> bool:
    """Return whether all joints have the same limits, those after ``n_own`` the same parents, places and axes."""
    limits = [np.stack([robot.lower, robot.upper, robot.velocity, robot.acceleration]) for robot in (first, second)]
    finite = [np.nan_to_num(limit, posinf=1e9, neginf=-1e9) for limit in limits]
    if not _same(finite[0], finite[1]):
        return False
    for name in first.joint_names[n_own:]:
        joints = [int(robot.model.getJointId(name)) for robot in (first, second)]
        parents, places, axes = zip(
            *(
                (
                    robot.model.names[robot.model.parents[joint]],
                    robot.model.jointPlacements[joint].homogeneous,
                    read_joint_axis(robot, joint),
                )
                for robot, joint in zip((first, second), joints, strict=True)
            ),
            strict=True,
        )
        if not (parents[0] == parents[1] and _same(places[0], places[1]) and _same(axes[0], axes[1])):
            return False
    return True


def _scene_difference(recorded: Scene, own: Scene) -> str:
    """Return a sentence that names the pieces that differ."""
    written, wanted = ({piece.name: piece for piece in scene.pieces} for scene in (recorded, own))
    missing, more = sorted(wanted.keys() - written.keys()), sorted(written.keys() - wanted.keys())
    if missing:
        return f"the scene lacks {', '.join(missing[:3])}{' and others' if len(missing) > 3 else ''}"
    if more:
        return f"the scene has {', '.join(more[:3])}, which the request does not"
    changed = [name for name in sorted(wanted) if not _same(wanted[name].vertices, written[name].vertices)]
    kinds = [name for name in sorted(wanted) if wanted[name].kind != written[name].kind]
    return f"{', '.join((changed or kinds or ['a piece'])[:3])} of the scene is not where the request has it"


def _describe(item: MovableObject) -> tuple[str | float | np.ndarray, ...]:
    """Return what makes an object."""
    return item.name, item.vertices, item.start, item.inertia.mass, item.inertia.centre, item.inertia.moments


def _rests(motion: Motion, border: float) -> bool:
    """Return whether the curve has a waypoint at a path parameter, and vanishing tangents there."""
    at = int(np.abs(motion.curve.knots - border).argmin())
    is_knot = abs(motion.curve.knots[at] - border) <= BORDER_ROUNDING * max(1.0, abs(border))
    return bool(is_knot and np.abs(motion.curve.tangents[at]).max(initial=0.0) <= BORDER_ROUNDING)


def _same_support(recorded: SupportPolygon | None, own: SupportPolygon | None) -> bool:
    """Return whether two supports agree: which corner comes first, and those on a line, are matters of rounding."""
    if recorded is None or own is None:
        return recorded is own
    polygon = np.asarray(recorded.polygon, dtype=float)
    if polygon.ndim != 2 or polygon.shape[0] < 3 or polygon.shape[1] != 2 or not np.all(np.isfinite(polygon)):
        return False
    edges = np.roll(polygon, -1, axis=0) - polygon
    turned = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    if np.linalg.norm(edges, axis=1).min() <= SAME or turned.min() < -SAME:
        return False
    off = max(float(outside_polygon(a, b).max()) for a, b in ((polygon, own.polygon), (own.polygon, polygon)))
    return off <= SAME and _same(recorded.margin_m, own.margin_m) and _same(recorded.height, own.height)


def _same(first: object, second: object) -> bool:
    """Return whether two values agree, numbers up to rounding; infinities agree with infinities."""
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        if first is None or second is None:
            return first is second
        a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
        return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=SAME))
    if isinstance(first, float | int) and isinstance(second, float | int):
        return bool(np.isclose(first, second, rtol=0.0, atol=SAME))
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(_same(a, b) for a, b in zip(first, second, strict=True))
    if is_dataclass(first) and type(first) is type(second):
        return all(_same(getattr(first, field.name), getattr(second, field.name)) for field in fields(first))
    return first == second
