"""Speeds of tools, and of hands that press or approach what they press, bounded along the whole timed curve.

On an interval of the path on which a point leaves its chord by at most ``d = h^2/8 max|p''|`` its rate ``|p'|`` is at
most that of the chord plus ``h/2 max|p''| = 4 d / h``; its speed is at most this times the largest ``ds/dt``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.curve import TimeLaw
from costs.robot.model import RobotModel
from service.verify.carrying.placing import split_motion
from service.verify.certificate import Check
from service.verify.forces.load_limits import LoadLimits, find_loaded_hand, limit_loads
from service.verify.frame_paths import FramePath
from service.verify.motion import Approach, Motion, Phase, VerifySettings
from service.verify.phase_proof import PhaseProof, bound_largest
from service.verify.prepared_motion import PreparedMotion

NEAR_M = 0.01  # from where a hand begins to press: within it the surface may be met
LEAST_M_S = 0.005  # speed that an approach may always have
RELATIVE_TOLERANCE = 1e-3  # excess of a frame's speed over its limit that still counts as within it


@dataclass(frozen=True)
class FrameSpeed:
    """Largest speed of a frame's origin on a part of the curve.

    Attributes:
        name: of the check.
        frame: frame of the robot.
        first, last: path parameters between which it holds.
        most: [m/s].
        near_m: only within this distance of where the frame is at ``last``; infinite for all of the part [m].
    """

    name: str
    frame: str
    first: float
    last: float
    most: float
    near_m: float = np.inf


def list_tools(robot: RobotModel) -> tuple[str, ...]:
    """Return the frames that count as tools.

    They are those of the robot's hands, else the outermost frames of the links in its group ``hands``, else those at
    the end of every chain.
    """
    if robot.hands:
        return tuple(dict.fromkeys(hand.tool for hand in robot.hands.values()))
    model = robot.model
    hands = [model.getFrameId(link) for link in robot.link_groups.get("hands", ()) if model.existFrame(link)]
    if hands:
        carrying = [(int(model.frames[k].parentJoint), model.frames[k].placement.translation) for k in hands]
    else:
        apart = {body.joint for body in robot.bodies if body.link in robot.mechanism_links}
        framed = {int(frame.parentJoint) for frame in model.frames}
        parents = {int(model.parents[joint]) for joint in range(1, model.njoints)} | apart
        carrying = [
            (joint, np.zeros(3)) for joint in range(1, model.njoints) if joint not in parents and joint in framed
        ]
    return tuple(dict.fromkeys(_find_outermost(model, joint, place) for joint, place in carrying))


def _find_outermost(model: pin.Model, joint: int, place: Float[np.ndarray, "3"]) -> str:
    """Return the frame of a joint that is farthest from a place in the joint."""
    own = [frame for frame in model.frames if int(frame.parentJoint) == joint]
    away = [float(np.linalg.norm(frame.placement.translation - place)) for frame in own]
    return str(own[int(np.argmax(away))].name)


def list_frame_speeds(motion: Motion, phases: Sequence[Phase]) -> tuple[FrameSpeed, ...]:
    """Return the speeds that a motion promises: of its tools, and with a pace of hands that press or begin to."""
    speeds = []
    if motion.tool_speed_m_s is not None:
        first, last = float(motion.curve.knots[0]), float(motion.curve.knots[-1])
        speeds += [
            FrameSpeed(f"limits.tool_speed.{tool}", tool, first, last, motion.tool_speed_m_s)
            for tool in list_tools(motion.robot)
        ]
    if motion.pace is not None:
        speeds += list_press_speeds(motion, phases)
    return tuple(speeds)


def list_press_speeds(motion: Motion, phases: Sequence[Phase]) -> tuple[FrameSpeed, ...]:
    """Return the largest speeds at which hands may press, and come to what they press, so that no jam exceeds a cap."""
    parts = list(zip(split_motion(replace(motion, phases=tuple(phases))), phases, strict=True))
    speeds = [
        FrameSpeed(
            f"pressing.{phase.name}.{limit.tool}",
            limit.tool,
            phase.first,
            phase.last,
            limit_approach(limit, motion.approach),
        )
        for part, phase in parts
        for limit in limit_loads(part, phase)
    ]
    for (_, before), (part, after) in pairwise(parts):
        pressing = {find_loaded_hand(before, load) for load in before.loads}
        speeds += [
            FrameSpeed(
                f"approach.{before.name}.{limit.tool}",
                limit.tool,
                before.first,
                before.last,
                limit_approach(limit, motion.approach),
                NEAR_M,
            )
            for limit in limit_loads(part, after)
            if limit.tool not in pressing
        ]
    return tuple(speeds)


def limit_approach(limit: LoadLimits, approach: Approach) -> float:
    """Return the largest speed at which a hand may meet what it is going to press, and move what it presses [m/s].

    A hand that meets the surface too early, or whose mechanism jams, presses on until the force is seen and the arm
    rests; its force stays below the cap if ``v <= (cap - expected - noise) / (stiffness * time)``.
    """
    room = limit.cap_n - limit.expected_n - approach.noise_n
    return max(room / (approach.stiffness_n_m * approach.reaction_s), LEAST_M_S)


def check_frame_speeds(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    """Check the speeds of tools and of approaching hands on the whole curve."""
    law = prepared.motion.law
    if law is None:
        return
    for speed in list_frame_speeds(prepared.motion, prepared.phases):
        yield _check_speed(prepared, law, speed, settings)


def _check_speed(prepared: PreparedMotion, law: TimeLaw, speed: FrameSpeed, settings: VerifySettings) -> Check:
    path = FramePath.of(prepared, speed.frame, np.zeros((1, 3)), settings.rounding)
    end = path.origin_at(speed.last)

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        begin, finish = path.at(first)[0][:, 0], path.at(last)[0][:, 0]
        away = path.chain.deviation(prepared.over(first, last))
        length, chord = last - first, np.linalg.norm(finish - begin, axis=1)
        at_first, at_last = measure_rates(law, first), measure_rates(law, last)
        mean = chord / length * np.minimum(at_first, at_last)  # no more than the largest speed on the interval
        upper = (chord + 4.0 * away) / length * np.maximum(at_first, at_last)
        off = np.linalg.norm(begin - end, axis=1), np.linalg.norm(finish - end, axis=1)
        is_far = np.minimum(*off) - 0.5 * chord - away > speed.near_m
        is_near = np.maximum(*off) + 0.5 * chord + away <= speed.near_m
        return np.where(is_far, 0.0, upper), np.where(is_near, mean, 0.0), np.zeros(len(first))

    grid = np.concatenate([prepared.edges, law.path, [speed.first, speed.last]])
    edges = np.unique(grid[(grid >= speed.first) & (grid <= speed.last)])
    limit = speed.most * (1.0 + RELATIVE_TOLERANCE)
    extreme = bound_largest(edges, evaluate, limit, 0.02 * speed.most, settings.max_halvings, settings.max_sharpenings)
    proof = PhaseProof(prepared, prepared.phases[0], settings)
    near = f" within {1e3 * speed.near_m:.0f} mm of where it begins to press" if np.isfinite(speed.near_m) else ""
    fastest = extreme.bound if extreme.is_proven else extreme.sampled
    text = f"{speed.frame} moves at up to {fastest:.3f} m/s{near}"
    failure = f"{text}, faster than {speed.most:.3f} m/s"
    promise = f"{speed.frame} stays below {speed.most:.3f} m/s{near}"
    position = path.origin_at(extreme.s)
    names = (speed.frame,)
    return proof.check(speed.name, extreme, limit, "m/s", text, position, names=names, failure=failure, promise=promise)


def measure_rates(law: TimeLaw, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return ds/dt at path parameters [1/s]: its square is linear in the path between two points of the law."""
    return np.asarray(np.sqrt(np.maximum(np.interp(s, law.path, law.speed**2), 0.0)))
