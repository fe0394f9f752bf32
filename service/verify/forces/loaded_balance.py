"""Checks of balance under the loads of the hands: recorded regions proven, and the centre of mass inside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.certificate import Basis, Check, Where
from service.verify.forces.equilibrium import EquilibriumProof, RecordedRegion, prove_equilibrium
from service.verify.forces.hand_loads import list_drifting, list_load_wrenches
from service.verify.frame_paths import MassPath, find_mechanism_joints
from service.verify.motion import (
    LoadedRegion,
    Motion,
    Phase,
    PlantedContact,
    VerifyError,
    VerifySettings,
)
from service.verify.phase_proof import Extreme, PhaseProof
from service.verify.polygons import describe_inside, outside_polygon
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_time

GRAVITY = 9.81
_BORDER = 1e-9  # rounding of path parameters


def check_loaded_balance(
    prepared: PreparedMotion, phase: Phase, margin_m: float, settings: VerifySettings
) -> Iterator[Check]:
    """Check that the contacts hold the robot on the whole phase, under every load up to the largest.

    Each recorded region is proven by its witnesses, for the loads of its stretch and with contacts that drift and lean
    within their tolerances; the centre of mass is inside it by the margin [m].
    """
    gap = _find_gap(phase, prepared.edges)
    if gap is not None:
        where = Where(gap, find_time(prepared.motion.law, gap), None)
        text = f"no region says where the contacts hold the robot during {phase.name}"
        nan = float("nan")
        yield Check(f"equilibrium.{phase.name}", True, nan, 0.0, "1", text, where, Basis.UNPROVEN)
        return
    proofs = _prove_regions(prepared.motion, phase)
    yield _equilibrium_check(prepared, phase, proofs)
    path = MassPath(prepared, settings.rounding)
    stretches = [replace(phase, first=region.first, last=region.last) for region in phase.regions]
    extremes = [
        _bound_outside(path, PhaseProof(prepared, stretch, settings), region, margin_m, shift)
        for stretch, region, (_, shift) in zip(stretches, phase.regions, proofs, strict=True)
    ]
    # Each extreme is relative to the margin of its own stretch, so that stretches can be compared.
    worst = max(extremes, key=lambda extreme: (not extreme.is_proven, extreme.bound))
    proof = PhaseProof(prepared, phase, settings)
    point = path.at(np.array([worst.s]))[0]
    place = f"the region that the {'loaded feet' if phase.loads else 'contacts'} hold during {phase.name}"
    text = f"the centre of mass stays {-1e3 * worst.bound:.1f} mm inside {place}"
    failure = f"the centre of mass is {describe_inside(-worst.sampled)} {place}"
    name, limit = f"balance.{phase.name}", -margin_m
    yield proof.check(name, worst, limit, "m", text, point, negate=True, failure=failure)


class Ground(NamedTuple):
    """All contact points of a phase, in the order of its contacts.

    Attributes:
        points: (C, 3) in the world [m].
        normals: (C, 3) unit vectors along which the surroundings push; of a sole on level ground up from its plane.
        friction: (C,) coefficients.
        caps: (C,) largest normal forces [N].
    """

    points: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    friction: Float[np.ndarray, "C"]
    caps: Float[np.ndarray, "C"]

    @staticmethod
    def under(contacts: tuple[PlantedContact, ...]) -> Ground:
        """Return the contact points (VerifyError where the corners of a sole on level ground are on a line)."""
        counts = np.array([len(contact.sole) for contact in contacts], dtype=int)
        friction = np.repeat(np.array([contact.friction for contact in contacts], dtype=float), counts)
        caps = np.repeat(np.array([contact.force_cap_n for contact in contacts], dtype=float), counts)
        return Ground(place_contact_points(contacts), find_normals(contacts), friction, caps)

    @staticmethod
    def within_tilt(contacts: tuple[PlantedContact, ...]) -> Ground:
        """Return the contact points with the cones and caps that hold for every normal within each contact's tilt.

        A force at most ``atan(mu) - tilt`` off the normal is in every tilted cone. Along the tilted normal that is
        nearest, a force at angle a presses by ``cos(a - tilt) / cos(a)`` more. A contact that leans more than its
        friction carries nothing.
        """
        ground = Ground.under(contacts)
        counts = np.array([len(contact.sole) for contact in contacts], dtype=int)
        tilt = np.repeat(np.array([contact.tilt_rad for contact in contacts], dtype=float), counts)
        left = np.arctan(ground.friction) - tilt
        friction = np.tan(np.maximum(left, 0.0))
        caps = np.where(left >= 0.0, ground.caps / (np.cos(tilt) + friction * np.sin(tilt)), 0.0)
        return Ground(ground.points, ground.normals, friction, caps)


def place_contact_points(contacts: tuple[PlantedContact, ...]) -> Float[np.ndarray, "C 3"]:
    """Return all contact points in the world, in the order of the contacts [m]."""
    return np.concatenate([np.zeros((0, 3)), *(contact.points for contact in contacts)])


def find_normals(contacts: tuple[PlantedContact, ...]) -> Float[np.ndarray, "C 3"]:
    """Return at each contact point the unit normal of its surface, in the world.

    Raises:
        VerifyError: the corners of a sole on level ground are on a line.
    """
    normals = [np.zeros((0, 3))]
    for contact in contacts:
        normal = contact.normal
        if normal is None:
            _, sizes, axes = np.linalg.svd(contact.points - contact.points.mean(axis=0))
            if len(sizes) < 2 or sizes[1] < 1e-3:
                raise VerifyError(f"the corners of the sole of {contact.link} are on a line")
            normal = axes[2] if axes[2, 2] >= 0.0 else -axes[2]
        normals.append(np.tile(normal, (len(contact.sole), 1)))
    return np.concatenate(normals)


def find_tilts(contacts: tuple[PlantedContact, ...]) -> Float[np.ndarray, "C"]:
    """Return at each contact point the largest angle by which its normal may be off [rad].

    A sole on level ground may lean while its corners drift within their tolerance; other contacts state it.
    """
    tilts = [np.zeros(0)]
    for contact in contacts:
        if contact.normal is not None:
            tilts.append(np.full(len(contact.sole), contact.tilt_rad))
            continue
        flat = contact.sole - contact.sole.mean(axis=0)
        narrow = flat @ np.linalg.svd(flat)[2][1]
        tilts.append(np.full(len(contact.sole), np.arctan2(2.0 * contact.tolerance_m, np.ptp(narrow))))
    return np.concatenate(tilts)


def _find_gap(phase: Phase, edges: Float[np.ndarray, "E"]) -> float | None:
    """Return a path parameter of the phase that no region covers; None if they cover it, from knot to knot."""
    scale = _BORDER * max(1.0, abs(phase.last))
    reached = phase.first
    for region in phase.regions:
        is_knot = float(np.abs(edges - region.last).min()) <= scale
        if abs(region.first - reached) > scale or not region.last > region.first or not is_knot:
            return reached
        reached = region.last
    return None if phase.regions and abs(reached - phase.last) <= scale else reached


def weigh(motion: Motion) -> float:
    """Return the mass of the robot with what it carries, without the mechanism [kg]."""
    model: pin.Model = motion.robot.model
    apart = find_mechanism_joints(motion)
    return float(sum(model.inertias[j].mass for j in range(1, model.njoints) if j not in apart))


def _prove_regions(motion: Motion, phase: Phase) -> list[tuple[EquilibriumProof, float]]:
    """Prove all regions; return with each the part of the margin that drifting feet and hands take off [m]."""
    contacts, mass = phase.contacts, weigh(motion)
    feet_drift = max((contact.tolerance_m for contact in contacts), default=0.0)
    # The feet's horizontal forces are at least the hands', so their drift covers the yaw moment of the hands' drift.
    drifting = list_drifting(phase.loads)
    drift = feet_drift + max((load.drift_m for load in drifting), default=0.0)
    hands = sum(float(np.linalg.norm(load.force)) * load.drift_m for load in drifting) / (mass * GRAVITY)
    ground, tilts = Ground.under(contacts), find_tilts(contacts)
    proofs = list[tuple[EquilibriumProof, float]]()
    for region in phase.regions:
        recorded = RecordedRegion(*ground, region.wrenches, region.vertices, region.witnesses)
        loads = list_load_wrenches(motion, phase.loads, region.first, region.last)
        proof = prove_equilibrium(recorded, mass, loads, GRAVITY, drift_m=drift, tilt_rad=tilts)
        proofs.append((proof, proof.shift_m * feet_drift / drift + hands if drift > 0.0 else 0.0))
    return proofs


def _equilibrium_check(prepared: PreparedMotion, phase: Phase, proofs: list[tuple[EquilibriumProof, float]]) -> Check:
    refuted = [k for k, (proof, _) in enumerate(proofs) if not proof.is_proven]
    at = phase.regions[refuted[0] if refuted else 0].first
    where = Where(at, find_time(prepared.motion.law, at), None)
    worst = max((max(proof.force_n, proof.moment_nm) for proof, _ in proofs), default=np.inf)
    if refuted:
        text = f"during {phase.name}: {proofs[refuted[0]][0].text}"
    else:
        count = sum(len(region.vertices) * len(region.wrenches) for region in phase.regions)
        holds = "the ground's forces hold the robot under its loads" if phase.loads else "contact forces hold the robot"
        text = f"{holds} during {phase.name} ({count} balances)"
    return Check(f"equilibrium.{phase.name}", not refuted, worst, 1e-2, "N, Nm", text, where, Basis.PROOF)


def _bound_outside(path: MassPath, proof: PhaseProof, region: LoadedRegion, margin_m: float, shift_m: float) -> Extreme:
    """Bound how far the centre of mass is outside a region on its stretch, less what drift takes off the margin [m]."""

    def outside(s: np.ndarray) -> np.ndarray:
        return outside_polygon(region.vertices, path.at(s)[:, :2])

    extreme = proof.bound_convex(outside, path.deviation, -(margin_m + shift_m), proof.settings.resolution_m)
    return Extreme(extreme.bound + shift_m, extreme.sampled + shift_m, extreme.s, extreme.is_proven)
