"""Forces of the hands on a mechanism: what a plan expects, and up to which force ground and joints hold the robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.forces.contact_forces import Joints
from service.verify.forces.dynamics import (
    compute_inverse_dynamics,
    find_limited_joints,
    list_levers,
    make_contact_share,
    map_axes,
)
from service.verify.forces.hand_loads import LoadCase, list_load_cases
from service.verify.motion import HandLoad, Motion, Phase

MOST_LOAD = 10.0  # largest cap of a hand's loads, in units of the expected ones
N_SAMPLES = 5  # of a phase, at which the cap is found


@dataclass(frozen=True)
class LoadLimits:
    """Force of a hand on a mechanism during a phase: the sum of all loads that act at one tool.

    Attributes:
        tool: frame of the robot that presses.
        links: the mechanism's links that the loads act on.
        expected_n: size of the force that the plan expects, at most; some of the loads may be absent.
        cap_n: the force up to which ground and joints hold the robot, with the loads of other tools as expected.
        abort_n: the force at which to stop: half-way between the two.
    """

    tool: str
    links: tuple[str, ...]
    expected_n: float
    cap_n: float

    @property
    def abort_n(self) -> float:
        """Force at which to stop: half-way between the expected force and the cap [N]."""
        return 0.5 * (self.expected_n + self.cap_n)


def limit_loads(motion: Motion, phase: Phase) -> tuple[LoadLimits, ...]:
    """Return expected force and cap of each hand that carries loads in a phase; the weakest of five samples counts.

    Args:
        motion: of the phase, with what hands hold as links of its robot.
        phase: a load on what a hand holds is a load of that hand.
    """
    if not phase.loads:
        return ()
    q = motion.curve(np.linspace(phase.first, phase.last, N_SAMPLES))
    limits = []
    hands = [find_loaded_hand(phase, load) for load in phase.loads]
    for tool in dict.fromkeys(hands):
        own, others = (
            tuple(load for load, hand in zip(phase.loads, hands, strict=True) if (hand == tool) == is_own)
            for is_own in (True, False)
        )
        links = tuple(dict.fromkeys(load.link for load in own))
        largest = max(float(size.max()) for size in _measure_sums(motion, own, q))
        limits.append(LoadLimits(tool, links, largest, _find_cap(motion, phase, own, others, q)))
    return tuple(limits)


def find_loaded_hand(phase: Phase, load: HandLoad) -> str:
    """Return the frame of the robot that a load acts on: its tool, or the hand that holds it."""
    held = {carrier.item: carrier.link for carrier in phase.carriers}
    return held.get(load.tool) or load.tool


def _measure_sums(
    motion: Motion, loads: tuple[HandLoad, ...], q: Float[np.ndarray, "S n"]
) -> Iterator[Float[np.ndarray, "S"]]:
    """Yield the size of the sum of every combination of loads at their largest [N]."""
    for count in range(1, len(loads) + 1):
        for together in combinations(loads, count):
            yield _measure_force(_load_fully(motion, together, q))


def _load_fully(motion: Motion, loads: tuple[HandLoad, ...], q: Float[np.ndarray, "S n"]) -> LoadCase:
    """Return the case in which all loads are at their largest."""
    return list_load_cases(motion.robot, q, loads)[-1]


def _measure_force(case: LoadCase) -> Float[np.ndarray, "S"]:
    """Return the size of the force of a case [N]."""
    return np.asarray(np.linalg.norm(case.wrench[:, :3], axis=1))


def _find_cap(
    motion: Motion,
    phase: Phase,
    own: tuple[HandLoad, ...],
    others: tuple[HandLoad, ...],
    q: Float[np.ndarray, "S n"],
) -> float:
    """Return the largest force of one hand's loads that ground and torques hold at rest at all samples [N].

    All loads of the hand grow in proportion; those of other hands are as expected.
    """
    zero = np.zeros_like(q)
    inverse = compute_inverse_dynamics(motion, q, zero, zero)
    rest, torque = _apply_loads(motion, others, q, inverse.wrench, inverse.torque, inverse.jacobians, 1.0)
    full, loaded = _apply_loads(motion, own, q, rest, torque, inverse.jacobians, MOST_LOAD)
    limited = find_limited_joints(motion)
    effort = motion.robot.effort[limited]
    size = MOST_LOAD * _measure_force(_load_fully(motion, own, q))
    if not phase.contacts:
        held, more = np.abs(torque[:, limited]), np.abs((loaded - torque)[:, limited])
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(more > 0.0, (effort - held) / more, np.inf)
        return float((size * np.clip(part.min(axis=1, initial=1.0), 0.0, 1.0)).min())
    share = make_contact_share(motion, phase)
    levers = list_levers(motion.robot.model, phase, inverse.jacobians)
    parts = []
    for k in range(len(q)):
        rows = np.stack([torque[k, limited], (loaded - torque)[k, limited]])
        joints = Joints(rows, np.stack([levers[k][limited]] * 2), effort)
        parts.append(share.find_part(rest[k], full[k] - rest[k], joints))
    return float((size * np.nan_to_num(parts, nan=0.0)).min())


def _apply_loads(
    motion: Motion,
    loads: tuple[HandLoad, ...],
    q: Float[np.ndarray, "S n"],
    wrench: Float[np.ndarray, "S 6"],
    torque: Float[np.ndarray, "S n"],
    jacobians: Float[np.ndarray, "S 6 n"],
    share: float,
) -> tuple[Float[np.ndarray, "S 6"], Float[np.ndarray, "S n"]]:
    """Return the ground's wrench and the torques with loads added at a share of their size."""
    model: pin.Model = motion.robot.model
    wrench, torque = wrench.copy(), torque.copy()
    for joint, part in _load_fully(motion, loads, q).parts:
        wrench -= share * part
        torque -= share * np.einsum("sij,si->sj", jacobians, part) @ map_axes(model, joint)
    return wrench, torque
