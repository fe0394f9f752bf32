"""Check of a base on two wheels: along the whole curve it never slides sideways."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from costs.curve import differentiate
from costs.robot.model import PLANAR_NAMES
from service.verify.certificate import Basis, Check, Where
from service.verify.motion import VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.rounding import round_up
from service.verify.timeline import find_time

NAME = "rolling.base"
SLIDE_M, SLIDE_SHARE = 1e-3, 0.01  # that a base may slide on any stretch, and per length of that stretch [m, -]
PARTS = 64  # of an interval between knots


def check_rolling(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    """Bound the way that a rolling base slides across its heading, on its worst stretch; nothing for other robots.

    In each part of the curve the slide is at most ``(|a'| + |p'| |turn|) ds``, with ``a`` along the normal of the
    heading in the part's middle, and the turn from there.
    """
    motion = prepared.motion
    if not motion.robot.rolls:
        return
    columns = [motion.robot.joint_names.index(name) for name in PLANAR_NAMES]
    knots = motion.curve.knots
    shares = np.linspace(0.0, 1.0, PARTS + 1)
    edges = (knots[:-1, None] + np.diff(knots)[:, None] * shares).clip(max=knots[1:, None])  # (K-1, PARTS + 1)
    half = 0.5 * np.diff(edges, axis=1)
    middle = edges[:, :-1] + half
    local = middle - knots[:-1, None]
    coefficients = motion.curve.coefficients()[:, :, columns]  # (k, K-1, 3)
    yaw = _evaluate(coefficients[..., 2], local)
    # Largest rates in each part: the Taylor series about its middle.
    turn = _bound_series(coefficients[..., 2], local, half)
    across = [-np.sin(yaw), np.cos(yaw)]
    rates = [_list_derivatives(differentiate(coefficients[..., k], 1), local) for k in range(2)]
    slide = sum(np.abs(across[0] * x + across[1] * y) * power for x, y, power in _series(rates, half))
    speed = sum(np.hypot(x, y) * power for x, y, power in _series(rates, half))
    slides = np.asarray((slide + speed * turn) * 2.0 * half)
    places = [_evaluate(coefficients[..., k], edges - knots[:-1, None]) for k in range(2)]
    ways = np.hypot(*(np.diff(place, axis=1) for place in places))  # chords, no longer than the way
    first, last = _find_worst((slides - SLIDE_SHARE * ways).ravel())
    value, way = (float(each.ravel()[first : last + 1].sum()) for each in (slides, ways))
    limit = SLIDE_M + SLIDE_SHARE * way
    worst = float(middle.ravel()[first + int(slides.ravel()[first : last + 1].argmax())])
    ok = value <= limit
    amount = f"{round_up(1e3 * value, 2)} mm"
    text = f"the base turns and rolls, and slides across its heading by at most {amount} on {way:.2f} m of its way"
    if not ok:
        text = f"the base slides across its heading by up to {amount} on {way:.2f} m of its way, as wheels do not"
    where = None if ok else Where(worst, find_time(motion.law, worst), None, ())
    yield Check(NAME, ok, value, limit, "m", text, where, Basis.PROOF)


def _find_worst(excess: Float[np.ndarray, "P"]) -> tuple[int, int]:
    """Return the first and last of the neighbouring parts whose sum is largest."""
    sums = np.concatenate([[0.0], np.cumsum(excess)])
    least = np.minimum.accumulate(sums[:-1])
    last = int((sums[1:] - least).argmax())
    return int(sums[: last + 1].argmin()), last


def _evaluate(coefficients: Float[np.ndarray, "k I"], u: Float[np.ndarray, "I P"]) -> Float[np.ndarray, "I P"]:
    out = np.zeros_like(u)
    for row in coefficients[::-1]:
        out = out * u + row[:, None]
    return out


def _list_derivatives(coefficients: Float[np.ndarray, "k I"], u: Float[np.ndarray, "I P"]) -> list[np.ndarray]:
    """Return value and all derivatives of polynomials at ``u``, each over the factorial of its order."""
    out, factorial = [], 1.0
    for order in range(len(coefficients)):
        out.append(_evaluate(coefficients if order == 0 else differentiate(coefficients, order), u) / factorial)
        factorial *= order + 1.0
    return out


def _bound_series(
    coefficients: Float[np.ndarray, "k I"], u: Float[np.ndarray, "I P"], half: Float[np.ndarray, "I P"]
) -> Float[np.ndarray, "I P"]:
    """Return how far polynomials get from their values at ``u`` within ``half`` of it, at most."""
    terms = _list_derivatives(coefficients, u)
    return np.asarray(sum((np.abs(term) * half**order for order, term in enumerate(terms) if order), np.zeros_like(u)))


def _series(
    rates: list[list[np.ndarray]], half: Float[np.ndarray, "I P"]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the terms of both coordinates' Taylor series, with the power of the half width."""
    for order, (x, y) in enumerate(zip(*rates, strict=True)):
        yield x, y, half**order
