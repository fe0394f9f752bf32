"""Checks of movable objects in a phase: what carries them holds them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.robot.carried import MovableObject
from service.verify.carrying.carriers import Carrier
from service.verify.carrying.grasp import GRAVITY, GripBalance, Held
from service.verify.carrying.stacks import Rest, RestingObject, measure_rests
from service.verify.certificate import Basis, Check, Where
from service.verify.forces.dynamics import list_sample_times
from service.verify.forces.hand_loads import measure_most
from service.verify.motion import Motion, Phase, VerifySettings
from service.verify.phase_proof import PhaseProof
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_time

PAD_GAP_M = 2e-3  # between a pad and what it holds
STILL_M = 1.5e-3  # by which a finger may move against what it holds
REST_MARGIN_M = 5e-3  # of the centre of mass of a resting object, to any side
_SAME_WRENCH = 0.05  # wrenches that differ by less need nearly the same grip [N, N m]
_RESOLUTION_M, _SHARE_RESOLUTION = 2e-4, 0.02


def list_carrier_checks(phase: Phase, *, is_timed: bool) -> tuple[str, ...]:
    """Return the names of the checks that a phase's carriers require."""
    names = []
    for carrier in phase.carriers:
        kinds = ("rests",) if carrier.link is None else ("grip", "carried", *(("swung",) if is_timed else ()))
        names += [f"{kind}.{phase.name}.{carrier.item}" for kind in kinds]
    return tuple(names)


def check_carriers(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check that each object rests where the world carries it, and does not slip where a hand does.

    Args:
        prepared: of the whole motion.

    Raises:
        VerifyError: a carrier names no grip, or a finger that the robot does not have.
    """
    items = {item.name: item for item in prepared.motion.objects}
    placed = prepared.in_phase(phase)
    resting = [items[carrier.item] for carrier in phase.carriers if carrier.link is None]
    rests = measure_rests([place_resting(placed.motion.robot, item) for item in resting], placed.motion.scene.pieces)
    for carrier in phase.carriers:
        item = items[carrier.item]
        if carrier.link is None:
            yield _check_rest(placed, phase, item, rests[item.name])
        else:
            yield from _check_grips(placed, phase, item, carrier, settings)


def place_resting(robot: RobotModel, item: MovableObject) -> RestingObject:
    """Return an object that the world carries, as a robot with it has it."""
    body = next(body for body in robot.bodies if body.name == item.name)
    frame = robot.model.frames[robot.model.getFrameId(item.name)]
    return RestingObject(body, item.inertia.mass, np.asarray(frame.placement.act(item.inertia.centre)))


def _check_rest(prepared: PreparedMotion, phase: Phase, item: MovableObject, rest: Rest) -> Check:
    motion, names = prepared.motion, rest.names
    centre = place_resting(motion.robot, item).centre
    margin = max(rest.margin, -1.0)
    where = Where(phase.first, find_time(motion.law, phase.first), _point(centre), (item.name, *names))
    text = f"{item.name} rests on {' and '.join(names)} during {phase.name}, {1e3 * margin:.0f} mm inside what holds it"
    if margin < REST_MARGIN_M:
        text = f"{item.name} does not rest during {phase.name}: nothing is below it"
        if names:
            text = f"{item.name} does not rest on {' and '.join(names)} during {phase.name}: its weight is not held"
    return Check(
        f"rests.{phase.name}.{item.name}", margin >= REST_MARGIN_M, margin, REST_MARGIN_M, "m", text, where, Basis.PROOF
    )


def _check_grips(
    prepared: PreparedMotion, phase: Phase, item: MovableObject, carrier: Carrier, settings: VerifySettings
) -> Iterator[Check]:
    held, proof = Held(prepared, item, carrier, phase.loads), PhaseProof(prepared, phase, settings)
    pads = held.list_pads(phase.first)
    fingers = tuple(pad.finger for pad in pads)
    centre = held.centre
    where = Where(phase.first, find_time(prepared.motion.law, phase.first), None, (*fingers, item.name))
    farthest = max(pads, key=lambda pad: abs(pad.gap))
    off = abs(farthest.gap)
    name, hands = f"grip.{phase.name}.{item.name}", " and ".join(fingers)
    if off > PAD_GAP_M:
        side = "off" if farthest.gap > 0.0 else "inside"
        text = f"{farthest.finger} is {1e3 * off:.1f} mm {side} {item.name}, which it is to hold during {phase.name}"
        yield Check(name, False, off, PAD_GAP_M, "m", text, where, Basis.SAMPLES)
        return
    paths = held.list_paths(settings.rounding)
    first = [path.at(np.array([phase.first]))[0][0] for path in paths]

    def drift(s: np.ndarray) -> np.ndarray:
        offs = [np.linalg.norm(path.at(s)[0] - at, axis=2).max(axis=1) for path, at in zip(paths, first, strict=True)]
        return np.asarray(np.max(offs, axis=0))

    def deviation(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        return np.asarray(np.max([path.point_deviation(begin, end) for path in paths], axis=0))

    still = proof.bound_convex(drift, deviation, STILL_M, _RESOLUTION_M)
    text = f"{hands} keep their place on {item.name} during {phase.name}"
    failure = f"{hands} move by {1e3 * still.sampled:.1f} mm on {item.name} during {phase.name}"
    yield proof.check(name, still, STILL_M, "m", text, None, names=(*fingers, item.name), failure=failure)
    balance, weight = GripBalance(pads, centre), GRAVITY * item.inertia.mass
    most = held.measure_turning(balance)
    chain = prepared.tree.chain(0, held.body.joint, np.zeros((1, 3)))
    turning = replace(chain, reach=np.where(chain.is_revolute, 1.0, 0.0))
    known: dict[float, float] = {}

    def share(s: np.ndarray) -> np.ndarray:
        new = [place for place in dict.fromkeys(s.tolist()) if place not in known]
        pressing = np.moveaxis(held.list_pressing(np.array(new)), 0, 1)
        for place, down, corners in zip(new, held.find_down(np.array(new)), pressing, strict=True):
            rest = np.concatenate([-weight * down, np.zeros(3)])
            known[place] = max(balance.find_share(rest + corner) for corner in corners)
        return np.array([known[place] for place in s.tolist()])

    def more(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        over = prepared.over(begin, end)
        return np.asarray(most * (turning.deviation(over) + turning.sampling_slack(over, settings.rounding)))

    weighed = proof.bound_convex(share, more, 1.0, _SHARE_RESOLUTION)
    grip = min(grip.force_n for grip in carrier.grips)
    what = f"{item.name} of {item.inertia.mass:g} kg during {phase.name}"
    if held.loads:
        force = sum(measure_most(load) for load in held.loads)
        what = f"{item.name} of {item.inertia.mass:g} kg, which presses with up to {force:.3g} N, during {phase.name}"
    text = f"{hands} hold {what} with {100.0 * weighed.bound:.0f} % of {grip:g} N"
    failure = f"{hands} do not hold {what}: {_describe_need(weighed.sampled, grip)}"
    name, names = f"carried.{phase.name}.{item.name}", (*fingers, item.name)
    yield proof.check(name, weighed, 1.0, "1", text, None, names=names, failure=failure)
    if prepared.motion.law is not None:
        yield _check_swing(prepared, phase, held, balance, grip, settings)


def _check_swing(
    prepared: PreparedMotion, phase: Phase, held: Held, balance: GripBalance, grip: float, settings: VerifySettings
) -> Check:
    """Check at samples that the grips also hold what accelerates the object."""
    times, s, wrenches, _ = _list_wrenches(prepared, phase, held, settings)
    # Wrenches that differ little need nearly the same: one of each kind.
    _, chosen = np.unique(np.round(wrenches / _SAME_WRENCH), axis=0, return_index=True)
    shares = np.array([balance.find_share(wrenches[k]) for k in chosen])
    worst = int(shares.argmax())
    value, row = float(shares[worst]), int(chosen[worst])
    item = held.item
    where = Where(float(s[row]), float(times[row]), None, (item.name,))
    count = len(np.unique(times))
    text = f"the grip holds {item.name} as it moves during {phase.name} ({count} samples)"
    if value > 1.0:
        text = f"the grip lets {item.name} slip as it moves during {phase.name}: {_describe_need(value, grip)}"
    value = min(value, 1e3)
    return Check(f"swung.{phase.name}.{item.name}", value <= 1.0, value, 1.0, "1", text, where, Basis.SAMPLES)


def find_grip_slowdown(motion: Motion, phase: Phase, settings: VerifySettings) -> float:
    """Return by which factor a phase would have to take longer for its grips to hold what accelerates their objects.

    It is 1 where they hold it, and where they do not hold the weight alone.  Slower by a factor ``c``, a motion needs a
    wrench between that at rest and the present one, ``1 / c^2`` of the way; the share of the grips is convex on it.
    """
    carriers = [carrier for carrier in phase.carriers if carrier.link is not None]
    if not carriers:
        return 1.0
    items = {item.name: item for item in motion.objects}
    placed, factor = PreparedMotion(motion).in_phase(phase), 1.0
    for carrier in carriers:
        held = Held(placed, items[carrier.item], carrier, phase.loads)
        pads = held.list_pads(phase.first)
        if max(abs(pad.gap) for pad in pads) > PAD_GAP_M:
            continue
        balance = GripBalance(pads, held.centre)
        _, _, moving, resting = _list_wrenches(placed, phase, held, settings)
        _, chosen = np.unique(np.round(moving / _SAME_WRENCH), axis=0, return_index=True)
        for k in chosen:
            most = balance.find_share(moving[k])
            if most <= 1.0:
                continue
            least = balance.find_share(resting[k])
            if least < 1.0 and np.isfinite(most):
                factor = max(factor, float(np.sqrt((most - least) / (1.0 - least))))
    return factor


def _list_wrenches(
    prepared: PreparedMotion, phase: Phase, held: Held, settings: VerifySettings
) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"], Float[np.ndarray, "S 6"], Float[np.ndarray, "S 6"]]:
    """Return times, path parameters, and the wrenches that an object demands as it moves and at rest, at samples.

    Each sample comes once per corner of what the object presses with.
    """
    motion, law = prepared.motion, prepared.motion.law
    assert law is not None
    times = list_sample_times(motion, law, phase.first, phase.last, 5.0 * settings.time_step_s)
    s, speed, gain = law.at(times)
    slope, bend, q = motion.curve(s, 1), motion.curve(s, 2), motion.curve(s)
    v, acceleration = slope * speed[:, None], slope * gain[:, None] + bend * speed[:, None] ** 2
    corners, wrenches = held.list_pressing(s), held.find_wrenches(q, v, acceleration)
    moving, resting = ((corners + own).reshape(-1, 6) for own in wrenches)
    return np.tile(times, len(corners)), np.tile(s, len(corners)), moving, resting


def _describe_need(share: float, grip: float) -> str:
    if not np.isfinite(share):
        return "no forces inside their friction cones balance its weight"
    return f"each finger would have to press with {share * grip:.0f} N instead of {grip:g}"


def _point(place: np.ndarray) -> tuple[float, float, float]:
    x, y, z = place.tolist()
    return x, y, z
