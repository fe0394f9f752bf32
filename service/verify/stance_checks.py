"""Checks of a phase's stance along the whole curve: the centre of mass above the feet, and feet that stay planted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.verify.certificate import Basis, Check
from service.verify.forces.loaded_balance import check_loaded_balance, find_normals
from service.verify.frame_paths import FramePath, MassPath
from service.verify.motion import Phase, PlantedContact, SupportPolygon, VerifySettings
from service.verify.phase_proof import Extreme, PhaseProof
from service.verify.polygons import describe_inside, outside_polygon
from service.verify.prepared_motion import PreparedMotion
from service.verify.rounding import round_down, round_up
from service.verify.timeline import edges_within

# How far a support polygon may reach beyond the planted soles, which may themselves drift by about as much [m].
_SUPPORT_TOLERANCE_M = 1e-3
# Largest difference of height between corners of planted soles, and lean of a sole, with which their hull counts.
_LEVEL_M, _LEVEL_RAD = 0.02, float(np.deg2rad(10.0))


def check_stance(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check balance, the support polygon and planted links of one phase."""
    proof = PhaseProof(prepared, phase, settings)
    if phase.region_margin_m is not None:
        yield from check_loaded_balance(prepared, phase, phase.region_margin_m, settings)
    elif phase.support is not None:
        if phase.loads:
            yield from check_loaded_balance(prepared, phase, phase.support.margin_m, settings)
        else:
            yield _balance_check(proof, phase.support)
        if phase.contacts:
            yield check_support(phase, phase.support)
    for contact in phase.contacts:
        yield from _planted_checks(proof, contact)


def _balance_check(proof: PhaseProof, support: SupportPolygon) -> Check:
    path, phase = MassPath(proof.prepared, proof.settings.rounding), proof.phase

    def outside(s: np.ndarray) -> np.ndarray:
        return outside_polygon(support.polygon, path.at(s)[:, :2])

    extreme = proof.bound_convex(outside, path.deviation, -support.margin_m, proof.settings.resolution_m)
    point = path.at(np.array([extreme.s]))[0]
    margin = round_down(-1e3 * extreme.bound, 1)
    text = f"the centre of mass stays {margin} mm inside the support polygon during {phase.name}"
    failure = f"the centre of mass is {describe_inside(-extreme.sampled)} the support polygon during {phase.name}"
    name, limit = f"balance.{phase.name}", -support.margin_m
    return proof.check(name, extreme, limit, "m", text, point, negate=True, failure=failure)


def _planted_checks(proof: PhaseProof, contact: PlantedContact) -> Iterator[Check]:
    phase = proof.phase
    path = FramePath.of(proof.prepared, contact.link, contact.sole, proof.settings.rounding)
    planted = contact.points

    def drift(s: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(path.at(s)[0] - planted, axis=2).max(axis=1))

    extreme = proof.bound_convex(drift, path.point_deviation, contact.tolerance_m)
    at = path.at(np.array([extreme.s]))[0][0].mean(axis=0)
    text = f"{contact.link} drifts at most {round_up(1e3 * extreme.bound, 2)} mm during {phase.name}"
    name = f"planted.{phase.name}.{contact.link}"
    failure = f"{contact.link} drifts by {round_down(1e3 * extreme.sampled, 2)} mm during {phase.name}"
    promise = f"{contact.link} drifts at most {1e3 * contact.tolerance_m:g} mm during {phase.name}"
    names = (contact.link,)
    yield proof.check(name, extreme, contact.tolerance_m, "m", text, at, names=names, failure=failure, promise=promise)
    knots = edges_within(proof.prepared.motion.curve.knots, phase)
    if len(knots):
        drifts = drift(knots)
        worst = int(drifts.argmax())
        at_knots = Extreme(float(drifts[worst]), float(drifts[worst]), float(knots[worst]), True)
        limit, off = contact.knot_tolerance_m, 1e3 * at_knots.bound
        words = f"at most {round_up(off, 3)}" if at_knots.bound <= limit else f"{round_down(off, 3)}"
        text = f"{contact.link} is off by {words} mm at the waypoints of {phase.name}"
        yield proof.check(f"{name}.waypoints", at_knots, limit, "m", text, at, names=names)


def check_support(phase: Phase, support: SupportPolygon) -> Check:
    """Check that the polygon is no wider than the hull of the planted soles, which alone carry the robot.

    The hull counts only where all soles are on level ground at one height: elsewhere friction and the direction of each
    force decide, which a region with witnesses proves.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    ground = np.concatenate([contact.points for contact in phase.contacts])
    rise = float(np.ptp(ground[:, 2]))
    lean = float(np.arccos(np.clip(find_normals(phase.contacts)[:, 2], -1.0, 1.0)).max())
    name = f"support.{phase.name}"
    if not rise <= _LEVEL_M:
        text = f"the soles of {phase.name} are on levels {1e3 * rise:.0f} mm apart; a support polygon needs one level"
        return Check(name, False, rise, _LEVEL_M, "m", text, None, Basis.PROOF)
    if not lean <= _LEVEL_RAD:
        text = f"a sole of {phase.name} leans {np.rad2deg(lean):.1f} deg; a support polygon needs level ground"
        return Check(name, False, lean, _LEVEL_RAD, "rad", text, None, Basis.PROOF)
    ground = ground[:, :2]
    try:
        value = float(outside_polygon(ground[ConvexHull(ground).vertices], support.polygon).max())
    except QhullError:  # soles on one line support nothing
        value = np.inf
    is_ok = value <= _SUPPORT_TOLERANCE_M
    text = f"the support polygon of {phase.name} reaches {1e3 * value:.1f} mm beyond the planted soles"
    return Check(name, is_ok, value, _SUPPORT_TOLERANCE_M, "m", text, None, Basis.PROOF)
