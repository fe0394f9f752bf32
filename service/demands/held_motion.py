"""Demands of a request, and a recorded motion held to them.

The promises of the motion's phases are made anew from the request; differences in robot, scene, path, speed and
promises are listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import Allowance
from costs.robot import RobotModel, read_joint_axis, with_mechanism
from costs.scene import Scene
from service.demands.contacts.egress_demand import EgressDemand
from service.demands.contacts.moved_places import take_recorded_places
from service.demands.contacts.stances import ContactPhase, ContactStance, ends_with_new_contacts, list_contact_phases
from service.demands.holds.pushes import add_pushes
from service.demands.neighbours import make_neighbour_allowances
from service.demands.program import ProgramDemand, make_program_targets, report_fixed_joints_that_move
from service.demands.recorded_task import RecordedTask, TaskDemand
from service.demands.stance import Stance, list_planted_feet, make_escape_allowances, make_standing_allowances
from service.demands.targets import make_goal_targets, make_kept_target
from service.request.schema import PlanRequest
from service.start.overlaps import find_hull_overlaps
from service.verify import Certificate, HandLoad, HandPush, Motion, Phase, PressedPart, SupportPolygon, Target
from service.verify.coverage.required import list_waived_checks
from service.verify.hashes import bodies_hash, robot_hash, scene_hash
from service.verify.polygons import outside_polygon

ESCAPE = "escape"
PACE_TOLERANCE = 0.01  # share of a speed or an acceleration that may be used in addition
BORDER_ROUNDING = 1e-9  # of path parameters, and of tangents that vanish
SAME = 1e-6  # numbers of a request and of a record that agree [m, rad]


@dataclass(frozen=True)
class Demands:
    """Demands of a request on every motion that answers it.

    Attributes:
        robot: the robot without the mechanism that a task moves.
        start: (n,) configuration at the start.
        scene: all pieces, floors included.
        program: demands of the request's TrajOpt problem, or None.
        task: demands of a task that moves a mechanism, or None.
        stances: of a task that changes contacts, that of the start first.
        egress: demands of a task that gets out of a vehicle, or None.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    program: ProgramDemand | None = None
    task: TaskDemand | None = None
    stances: tuple[ContactStance, ...] = ()
    egress: EgressDemand | None = None

    @property
    def changes_contacts(self) -> bool:
        """Whether the task moves from stance to stance."""
        return bool(self.stances) or self.egress is not None

    @property
    def feet(self) -> tuple[str, ...]:
        """Planted links."""
        if self.program is not None:
            return self.program.planted
        return list_planted_feet(self.robot, self.request.options.feet)


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
    robot = demands.robot
    if demands.task is not None:
        robot = with_mechanism(robot, demands.task.mechanism.joints)
    differences = list(compare_world(demands, robot, recorded))
    if recorded.robot.joint_names != robot.joint_names:
        return HeldMotion(recorded, tuple(differences))
    differences += compare_path(demands, recorded)
    promises, lines = _promises(demands, robot, recorded)
    phases = tuple(_rebuild(demands, recorded, index, promises) for index in range(len(recorded.phases)))
    differences += lines
    for phase, own in zip(recorded.phases, phases, strict=True):
        differences += compare_phase(phase, own, is_program=demands.program is not None)
    waived = list_waived_checks(
        is_timed=demands.request.options.timed,
        is_balanced=promises.stance.hull is not None or demands.changes_contacts or not demands.robot.is_floating,
    )
    if recorded.waived != waived:
        differences.append("the record waives other checks than the request")
    if recorded.clearance_m != demands.request.options.clearance_m:
        differences.append("the record demands another clearance than the request")
    releases = () if demands.task is None else demands.task.mechanism.releases
    if not _same(recorded.releases, releases):
        differences.append("the releases of the mechanism's latches are not those of the request")
    continues = None if demands.request.resume is None else demands.request.resume.plan
    if recorded.continues != continues:
        differences.append("the plan that the motion continues is not the request's")
    motion = replace(
        recorded,
        robot=robot,
        scene=demands.scene,
        phases=phases,
        mechanism_links=robot.mechanism_links,
        waived=waived,
        clearance_m=demands.request.options.clearance_m,
        releases=releases,
        continues=continues,
    )
    return HeldMotion(motion, tuple(differences))


@dataclass(frozen=True)
class _Promises:
    """Promises of the phases, made from the request.

    Attributes:
        stance: planted feet and support polygon.
        standing: allowances of planted links on floors.
        escape: allowances of the overlaps at the start.
        last: targets of the last phase.
        everywhere: targets of all phases.
        task: phases of a task that moves a mechanism, or None.
        neighbours: allowances of the mechanism and what is near it at the start.
        changes: phases of a task that changes contacts.
    """

    stance: Stance
    standing: tuple[Allowance, ...]
    escape: tuple[Allowance, ...]
    last: tuple[Target, ...]
    everywhere: tuple[Target, ...]
    task: RecordedTask | None
    neighbours: tuple[Allowance, ...]
    changes: tuple[ContactPhase, ...] = ()


def _promises(demands: Demands, augmented: RobotModel, recorded: Motion) -> tuple[_Promises, tuple[str, ...]]:
    request, robot, start, feet = demands.request, demands.robot, demands.start, demands.feet
    is_balanced = (demands.program is None or demands.program.is_balanced) and robot.can_balance
    stance = Stance.of(
        robot, start, feet, request.options.balance_margin_m, is_balanced and not demands.changes_contacts
    )
    leaves = request.options.escape and demands.program is None
    inside = find_hull_overlaps(robot, start, demands.scene, feet) if leaves else []
    targets: tuple[Target, ...] = ()
    lines: tuple[str, ...] = ()
    knots = recorded.curve.knots
    if request.goal is not None:
        # A joint without limits may arrive after any number of turns: its goal is the one near the recorded end.
        reached = recorded.curve.positions[-1, : robot.n]
        targets = make_goal_targets(robot, request.goal, float(knots[-1]), reached)
    elif demands.program is not None:
        targets, lines = make_program_targets(demands.program, robot, knots, recorded.curve.positions[:, : robot.n])
    task, neighbours = None, tuple[Allowance, ...]()
    if demands.task is not None:
        mechanism, friction = demands.task.mechanism, request.options.hand_friction
        task = RecordedTask.of(demands.task, recorded).map_specs(
            lambda specs: add_pushes(specs, augmented, mechanism, friction)
        )
        lines = task.problems
        at_start = np.concatenate([start, demands.task.mechanism.start])
        neighbours = make_neighbour_allowances(augmented, demands.scene, at_start)
    changes = tuple[ContactPhase, ...]()
    stances, has_finish, forbidden = demands.stances, False, tuple[str, ...]()
    if demands.egress is not None:
        stances, forbidden = demands.egress.read_stances(recorded)
        has_finish = ends_with_new_contacts(stances)
    elif request.task is not None and request.task.contacts is not None:
        stances, forbidden = take_recorded_places(stances, demands.scene, recorded)
        has_finish = request.task.contacts.finish is not None
    if stances:
        changes = list_contact_phases(stances, has_finish=has_finish)
        lines = forbidden + tuple(
            _compare_names([phase.name for phase in recorded.phases], [spec.name for spec in changes])
        )
        lines += tuple(_find_unmade(robot, recorded, changes))
    return _Promises(
        stance,
        make_standing_allowances(stance.contacts, demands.scene),
        make_escape_allowances(inside),
        targets,
        tuple(make_kept_target(robot, start, keep) for keep in request.keep),
        task,
        neighbours,
        changes,
    ), lines


def _compare_names(recorded: Sequence[str], wanted: Sequence[str]) -> Iterator[str]:
    if recorded != wanted:
        yield f"the phases are {', '.join(recorded)}; the task has {', '.join(wanted)}"


def _find_unmade(robot: RobotModel, recorded: Motion, changes: Sequence[ContactPhase]) -> Iterator[str]:
    """Yield a sentence for each contact that is not in its place at the end of the phase that lands it.

    No phase stands on the contacts that the last stance makes, so that no other check sees them.
    """
    data = robot.model.createData()
    for phase, change in zip(recorded.phases, changes, strict=False):
        for contact in change.moving if change.kind == "land" else ():
            planted = contact.planted
            q = recorded.curve(np.array([phase.last]))[0, : robot.n]
            pin.framesForwardKinematics(robot.model, data, q)
            pose = data.oMf[robot.model.getFrameId(planted.link)]
            points = planted.sole @ pose.rotation.T + pose.translation
            off = float(np.linalg.norm(points - planted.points, axis=1).max())
            if off > planted.knot_tolerance_m:
                yield f"{contact.patch} is {1e3 * off:.1f} mm off its place at the end of phase '{phase.name}'"


def _rebuild(demands: Demands, recorded: Motion, index: int, promises: _Promises) -> Phase:
    """Return one phase with the promises of the request."""
    phase = recorded.phases[index]
    if promises.changes:
        return _rebuild_change(demands, phase, promises.changes[min(index, len(promises.changes) - 1)])
    first = recorded.curve(np.array([phase.first]))[0, : demands.robot.n]
    escape = promises.escape if phase.name == ESCAPE and index == 0 else ()
    targets = promises.last if index == len(recorded.phases) - 1 else ()
    touching: tuple[Allowance, ...] = ()
    loads: tuple[HandLoad, ...] = ()
    pushes: tuple[HandPush, ...] = ()
    pressed: tuple[PressedPart, ...] = ()
    spec = None if promises.task is None else promises.task.specs[index]
    if spec is not None and demands.task is not None:
        targets, touching = spec.targets(demands.task.mechanism, phase.last), spec.touches
        loads, pushes, pressed = spec.loads, spec.pushes, spec.pressed
    if demands.program is not None:  # the planner itself promises targets between its steps
        targets = (*(target for target in phase.targets if getattr(target, "at", None) is None), *targets)
    return Phase(
        name=phase.name,
        first=phase.first,
        last=phase.last,
        contacts=promises.stance.contacts,
        allowances=(*promises.standing, *escape, *touching, *promises.neighbours),
        targets=(*targets, *promises.everywhere),
        support=promises.stance.support(phase.name, first),
        loads=loads,
        pushes=pushes,
        regions=phase.regions,  # evidence, which the verifier proves
        pressed=pressed,
    )


def _rebuild_change(demands: Demands, phase: Phase, change: ContactPhase) -> Phase:
    """Return one phase of a task that changes contacts with the promises of the request."""
    return Phase(
        name=phase.name,
        first=phase.first,
        last=phase.last,
        contacts=tuple(contact.planted for contact in change.contacts),
        allowances=change.list_allowances(demands.robot),
        targets=change.list_targets(),
        regions=phase.regions,  # evidence, which the verifier proves
        region_margin_m=demands.request.options.balance_margin_m,
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
    if scene_hash(recorded.scene) != scene_hash(demands.scene):
        yield _scene_difference(recorded.scene, demands.scene)


def compare_path(demands: Demands, recorded: Motion) -> Iterator[str]:
    """Yield a sentence for each difference in start, time law, fixed joints and phase borders."""
    q = recorded.curve.positions[:, : demands.robot.n]
    off = np.abs(q[0] - demands.start)
    if off.max(initial=0.0) > SAME:
        joint = demands.robot.joint_names[int(off.argmax())]
        yield f"the motion starts {off.max():.3g} away from the request's start at {joint}"
    if demands.request.options.timed and recorded.law is None:
        yield "the request demands a timed motion, and the record has no time law"
    if demands.program is not None:
        yield from report_fixed_joints_that_move(demands.program, demands.robot, demands.start, q)
    for phase in recorded.phases[1:]:
        if not _rests(recorded, phase.first):
            yield f"phase '{phase.name}' begins while the robot moves; it must rest there"
    names = [phase.name for phase in recorded.phases]
    if ESCAPE in names[1:]:
        yield "only the first phase may escape from an overlap at the start"


def compare_phase(recorded: Phase, own: Phase, is_program: bool) -> Iterator[str]:
    """Yield a sentence for each promise of a recorded phase that is not the request's."""
    if not _same_support(recorded.support, own.support):
        yield f"support of phase '{recorded.name}' are not those of the request"
    names = ("contacts", "allowances", "loads", "region_margin_m")
    for name in (*names, *(() if is_program else ("targets",))):
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
    for name, share in (("speed", options.velocity_scale), ("acceleration", options.acceleration_scale)):
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
