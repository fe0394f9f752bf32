"""Checks of a mechanism's latches: a joint stays at 0 until its latch releases it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import comb

import numpy as np
from jaxtyping import Bool, Float

from costs.robot.mechanism import Release
from service.verify.certificate import Basis, Check, Where
from service.verify.motion import Motion, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_time

RELEASE_TOLERANCE = 1e-3  # of the values of both joints [rad, m]
_ROUNDING = 1e-9  # of a joint that rests on its stop, as far as the tolerance beyond 0 [rad, m]
_ROOT_MERGE = 1e-12  # of places relative to an interval's length
_SURE = 1e-12  # share of its largest coefficient by which a polynomial without a root keeps off 0
# From coefficients (constant first) over [0, 1] to Bernstein coefficients, by their number.
_BERNSTEIN = {
    count: np.array([[comb(row, k) / comb(count - 1, k) for k in range(count)] for row in range(count)])
    for count in (3, 4)
}


def check_mechanism(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    """Check every release rule on the whole curve, and on the exported samples read linearly.

    Between two neighbouring knots both joints are cubics of the path parameter.  Their roots cut the interval where the
    locked joint enters or leaves the range of its latch; on each part the latch is extreme at the ends or where its
    derivative vanishes, so that its least value is exact up to rounding.
    """
    for release in prepared.motion.releases:
        tracks = [_Track.of_curve(prepared.motion, release)]
        if prepared.motion.samples is not None:
            tracks.append(_Track.of_samples(prepared.motion, prepared.motion.samples, release))
        breaches = [track.find_breach(release) for track in tracks]
        yield _make_check(prepared.motion, release, max(breaches, key=lambda breach: breach[0]))


def _make_check(motion: Motion, release: Release, breach: tuple[float, float, float]) -> Check:
    short, s, value = breach
    is_ok = short <= RELEASE_TOLERANCE
    shown, unit = _show(motion, release.joint, value)
    latch_at, latch_unit = _show(motion, release.latch, release.latch_at)
    missing, _ = _show(motion, release.latch, short)
    limit, limit_unit = _show(motion, release.joint, release.free_beyond)
    text = (
        f"{release.joint} is locked until {release.latch} is at {latch_at:.3g} {latch_unit} or it is open by "
        f"{limit:.3g} {limit_unit}"
    )
    where = None
    if not is_ok:
        text = (
            f"{release.joint} moves at {shown:.3g} {unit} while {release.latch} lacks {missing:.3g} {latch_unit} of "
            f"the {latch_at:.3g} {latch_unit} that release it"
        )
        where = Where(s, find_time(motion.law, s), None, (release.joint, release.latch))
    base = "m" if _slides(motion, release.latch) else "rad"
    return Check(f"release.{release.joint}", is_ok, short, RELEASE_TOLERANCE, base, text, where, Basis.PROOF)


def _show(motion: Motion, joint: str, value: float) -> tuple[float, str]:
    """Return a joint's value for people, and its unit."""
    return (1e3 * value, "mm") if _slides(motion, joint) else (float(np.rad2deg(value)), "deg")


def _slides(motion: Motion, joint: str) -> bool:
    model = motion.robot.model
    return str(model.joints[model.getJointId(joint)].shortname()).startswith("JointModelP")


@dataclass(frozen=True)
class _Track:
    """Two joints as cubics on ``I`` intervals.

    Attributes:
        first: (I,) path parameter where each interval begins.
        length: (I,) of the local parameter.
        joint, latch: (4, I) coefficients, the constant first; ``latch`` is positive where it releases.
    """

    first: Float[np.ndarray, "I"]
    length: Float[np.ndarray, "I"]
    joint: Float[np.ndarray, "4 I"]
    latch: Float[np.ndarray, "4 I"]

    @staticmethod
    def of_curve(motion: Motion, release: Release) -> _Track:
        """Return the joints along the curve."""
        columns = _columns(motion, release)
        c = motion.curve.coefficients()
        sign = np.sign(release.latch_at)
        knots = motion.curve.knots
        return _Track(knots[:-1], np.diff(knots), c[:, :, columns[0]], sign * c[:, :, columns[1]])

    @staticmethod
    def of_samples(motion: Motion, samples: Float[np.ndarray, "M"], release: Release) -> _Track:
        """Return the joints on straight lines between the samples."""
        steps = np.diff(samples)
        lines = []
        for column, sign in zip(_columns(motion, release), (1.0, np.sign(release.latch_at)), strict=True):
            q = sign * motion.curve(samples)[:, column]
            none = np.zeros(len(steps))
            lines.append(np.stack([q[:-1], np.diff(q) / steps, none, none]))
        return _Track(samples[:-1], steps, lines[0], lines[1])

    def find_breach(self, release: Release) -> tuple[float, float, float]:
        """Return by how much the latch is short where the joint is locked, where that is most, and the joint there.

        The joint is locked from 0 until it is first beyond ``free_beyond``, and again once it is back at 0.  A leaf
        that is ajar at the start may stay as it is.  The shortfall is 0 if there is none [rad, m].
        """
        at_start = float(self.joint[0, 0])
        shut, free = RELEASE_TOLERANCE + _ROUNDING, release.free_beyond
        borders = np.array([-free, -shut, shut, free, at_start - shut, at_start + shut])
        worst = (0.0, float(self.first[0]), at_start)
        is_free = False
        bends = self._list_bends(borders)
        middles = _evaluate(self.joint, 0.5 * self.length).tolist()
        for row in range(len(self.first)):
            joint, latch = self.joint[:, row], self.latch[:, row]
            length, middle = float(self.length[row]), abs(middles[row])
            crosses, turns = bends[row, :-1], bool(bends[row, -1])
            if not crosses.any() and (middle <= shut or middle >= free or is_free):
                is_free = middle > shut and (is_free or middle >= free)  # as the joint is throughout the interval
                continue
            slope = np.array([latch[1], 2.0 * latch[2], 3.0 * latch[3]])
            cuts = [_find_roots(joint - np.array([at, 0.0, 0.0, 0.0]), length) for at in borders[crosses]]
            cuts += [_find_roots(slope, length)] if turns else []
            places = np.unique(np.concatenate([[0.0, length], *cuts]))
            for a, b in pairwise(places.tolist()):
                if b - a <= _ROOT_MERGE * length:
                    continue
                value = float(_evaluate(joint, np.array([0.5 * (a + b)]))[0])
                if abs(value) <= shut:
                    is_free = False
                elif abs(value) >= free:
                    is_free = True
                elif not is_free and abs(value - at_start) > shut:
                    ends = _evaluate(latch, np.array([a, b]))
                    short = abs(release.latch_at) - float(ends.min())
                    at = float((a, b)[int(ends.argmin())])
                    if short > worst[0]:
                        worst = short, float(self.first[row]) + at, float(_evaluate(joint, np.array([at]))[0])
        return worst

    def _list_bends(self, borders: Float[np.ndarray, "B"]) -> Bool[np.ndarray, "I C"]:
        """Return for each interval where the joint may cross each border, and last where the latch may turn round."""
        powers = self.length ** np.arange(4)[:, None]
        joint = self.joint * powers
        shifted = np.repeat(joint[:, :, None], len(borders), axis=2)
        shifted[0] -= borders
        slope = self.latch[1:] * np.arange(1.0, 4.0)[:, None] * powers[:3]
        return np.concatenate([_may_vanish(shifted), _may_vanish(slope[:, :, None])], axis=1)


def _columns(motion: Motion, release: Release) -> tuple[int, int]:
    names = motion.robot.joint_names
    return names.index(release.joint), names.index(release.latch)


def _evaluate(c: Float[np.ndarray, "4"], u: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P"]:
    return np.asarray(c[0] + u * (c[1] + u * (c[2] + u * c[3])))


def _find_roots(c: Float[np.ndarray, "k"], length: float) -> Float[np.ndarray, "r"]:
    """Return the real roots of a polynomial (constant first) inside an interval that begins at 0.

    Roots are those of the polynomial over ``[0, 1]``; a double root that rounding makes complex is kept by its real
    part, where a needless cut does no harm.
    """
    scaled = c * length ** np.arange(len(c))
    if not _may_vanish(scaled):
        return np.zeros(0)
    largest = np.abs(scaled).max()
    scaled = np.where(np.abs(scaled) > 1e-14 * largest, scaled, 0.0)
    roots = np.roots(scaled[::-1])
    real = roots.real[np.abs(roots.imag) <= 1e-6]
    return np.asarray(length * real[(real > 0.0) & (real < 1.0)])


def _may_vanish(scaled: Float[np.ndarray, "k ..."]) -> Bool[np.ndarray, "..."]:
    """Return whether polynomials over [0, 1] (constant first) may have a root that is not everywhere."""
    largest = np.abs(scaled).max(axis=0)
    bounds = np.tensordot(_BERNSTEIN[len(scaled)], scaled, axes=1)  # the polynomial lies between least and largest
    is_apart = (bounds.min(axis=0) > _SURE * largest) | (bounds.max(axis=0) < -_SURE * largest)
    return np.asarray((largest > 0.0) & ~is_apart)
