"""Checks of ways: a frame that moves along a line, an arc or a screw, and joints on a straight line of configurations.

Both poses of a frame and of its way are compared at shares of the way.  Any share gives an upper bound of the distance,
so that those of the nearest points serve; they are followed from knot to knot, and have to lead from 0 to 1.  Between
two shares the way leaves its chord by at most an eighth of its second derivative, the frame by the bound of its path.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.guide import SHORTEST_M, Guide
from service.verify.certificate import Basis, Check, Where
from service.verify.frame_paths import FramePath
from service.verify.motion import JointWayTarget, WayTarget
from service.verify.phase_proof import Extreme, PhaseProof
from service.verify.rounding import round_up
from service.verify.targets.pose_errors import angle_of, chord_of, measure_angle
from service.verify.timeline import edges_within, find_time, find_times

BACK_M, BACK_RAD = 1e-3, 0.01  # by which a frame may be behind the farthest place that it has reached on its way
PARTS = 8  # of an interval between knots, at whose ends is seen whether a frame moves back
LEAST_SAMPLES = 50  # of the speed along a way
CUBIC, QUINTIC = "cubic", "quintic"


@dataclass(frozen=True)
class _Progress:
    """A frame beside its way, by path parameter."""

    proof: PhaseProof
    target: WayTarget
    path: FramePath

    @cached_property
    def guide(self) -> Guide:
        """The way."""
        target = self.target
        return Guide(
            target.position, target.rotation, target.centre, target.axis, target.angle, target.shift, target.turn
        )

    @cached_property
    def knots(self) -> tuple[Float[np.ndarray, "E"], Float[np.ndarray, "E"]]:
        """Path parameters of the phase's knots, and the shares there, each near the one before."""
        edges = edges_within(self.proof.prepared.edges, self.proof.phase)
        points, rotation = self.path.at(edges)
        shares = np.zeros(len(edges))
        before = np.zeros(1)
        for k in range(len(edges)):
            before = self.guide.find_shares(points[[k], 0], rotation[[k]], before)
            shares[k] = before[0]
        return edges, shares

    def find_shares(
        self, s: Float[np.ndarray, "S"], points: Float[np.ndarray, "S 3"], rotation: Float[np.ndarray, "S 3 3"]
    ) -> Float[np.ndarray, "S"]:
        """Return the shares of the way at path parameters."""
        return self.guide.find_shares(points, rotation, np.interp(s, *self.knots))

    def measure(
        self, s: Float[np.ndarray, "S"]
    ) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"], Float[np.ndarray, "S"]]:
        """Return shares, distances from the way [m], and chords of the angles off it [-]."""
        points, rotation = self.path.at(s)
        shares = self.find_shares(s, points[:, 0], rotation)
        off = np.linalg.norm(points[:, 0] - self.guide.positions(shares), axis=1)
        wanted = self.guide.rotations(shares)
        axis = self.target.free_axis
        if axis is not None:
            chord = np.linalg.norm((rotation - wanted) @ axis, axis=1)
        else:
            chord = chord_of(measure_angle(wanted.transpose(0, 2, 1) @ rotation))
        return shares, off, chord


def check_way(proof: PhaseProof, target: WayTarget) -> Iterator[Check]:
    """Check distance, orientation, progress and speed of a frame on its way."""
    path = FramePath.of(proof.prepared, target.frame, np.zeros((1, 3)), proof.settings.rounding)
    progress = _Progress(proof, target, path)
    guide, during = progress.guide, proof.phase.name
    name = f"way.{during}.{target.frame}"

    def off_way(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        before, at_first, _ = progress.measure(first)
        after, at_last, _ = progress.measure(last)
        bent = guide.bend * (after - before) ** 2 / 8.0
        return np.maximum(at_first, at_last) + bent + path.point_deviation(first, last), at_first, at_last

    def off_turn(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        before, _, at_first = progress.measure(first)
        after, _, at_last = progress.measure(last)
        bent = guide.turned**2 * (after - before) ** 2 / 8.0
        upper = np.maximum(at_first, at_last) + bent + path.direction_deviation(first, last)
        return angle_of(upper), angle_of(at_first), angle_of(at_last)

    if np.isfinite(target.tolerance_m):
        distance = proof.bound(off_way, target.tolerance_m)
        lengths = (target.tolerance_m, distance.bound, distance.sampled)
        most, shown, failed = (f"{round_up(1e3 * value, 2)} mm" for value in lengths)
        yield proof.check(
            name,
            distance,
            target.tolerance_m,
            "m",
            f"{target.frame} stays within {shown} of its way during {during}",
            path.origin_at(distance.s),
            names=(target.frame,),
            failure=f"{target.frame} is {failed} off its way during {during}",
            promise=f"{target.frame} stays within {most} of its way during {during}",
        )
    if np.isfinite(target.rotation_tolerance_rad):
        turn = proof.bound(off_turn, target.rotation_tolerance_rad, largest=np.pi)
        most, shown, failed = (
            f"{round_up(float(np.rad2deg(value)), 3)} deg"
            for value in (target.rotation_tolerance_rad, turn.bound, turn.sampled)
        )
        what = target.frame if target.free_axis is None else f"the axis of {target.frame}"
        yield proof.check(
            f"{name}.rotation",
            turn,
            target.rotation_tolerance_rad,
            "rad",
            f"{what} is turned within {shown} as its way says during {during}",
            path.origin_at(turn.s),
            names=(target.frame,),
            failure=f"{what} is turned {failed} off its way during {during}",
            promise=f"{what} is turned within {most} as its way says during {during}",
        )
    yield _check_progress(proof, progress, name)
    if target.speed_m_s is not None and proof.prepared.motion.law is not None:
        yield _check_speed(proof, progress, name)


def _check_progress(proof: PhaseProof, progress: _Progress, name: str) -> Check:
    """Check that a frame begins at the beginning of its way, ends at its end, and does not move back between.

    The retreat is seen at samples; it counts as a miss of the ends does, in proportion to what each may be.
    """
    guide, target = progress.guide, progress.target
    edges, _ = progress.knots
    s = np.append(np.linspace(edges[:-1], edges[1:], PARTS, endpoint=False, axis=1).ravel(), edges[-1])
    shares = progress.measure(s)[0]
    has_length = guide.length > SHORTEST_M
    scale = guide.length if has_length else guide.turned
    unit, limit = ("m", target.tolerance_m) if has_length else ("rad", target.rotation_tolerance_rad)
    behind = (np.maximum.accumulate(shares) - shares) * scale
    misses = np.where(behind > 0.0, behind * (limit / (BACK_M if has_length else BACK_RAD)), 0.0)
    ends = np.array([abs(shares[0]), abs(shares[-1] - 1.0)]) * scale
    is_back = bool(misses.max() > ends.max())
    worst = int(misses.argmax()) if is_back else -int(ends.argmax())
    value = max(float(misses.max()), float(ends.max()))
    extreme = Extreme.at_one_pose(value, float(s[worst]), limit)
    during = proof.phase.name
    text = f"{target.frame} moves along its whole way during {during}"
    failure = f"{target.frame} does {100.0 * shares[-1]:.1f} % of its way during {during}"
    if is_back:
        most = f"{1e3 * behind.max():.1f} mm" if has_length else f"{np.rad2deg(behind.max()):.2f} deg"
        failure = f"{target.frame} moves back by {most} on its way during {during}"
    return proof.check(f"{name}.progress", extreme, limit, unit, text, None, names=(target.frame,), failure=failure)


def _check_speed(proof: PhaseProof, progress: _Progress, name: str) -> Check:
    """Check the speed of a frame between the ramps of its way, at samples."""
    target, guide, motion = progress.target, progress.guide, proof.prepared.motion
    wanted, law = target.speed_m_s, motion.law
    assert wanted is not None
    assert law is not None
    ends = find_times(law, np.array([proof.phase.first, proof.phase.last]))
    count = max(LEAST_SAMPLES, int(np.ceil((ends[1] - ends[0]) / proof.settings.time_step_s)))
    times = np.linspace(ends[0], ends[1], count + 1)
    s = np.clip(law.at(times)[0], proof.phase.first, proof.phase.last)
    points, rotation = progress.path.at(s)
    done = progress.find_shares(s, points[:, 0], rotation) * guide.length
    middle, speed = 0.5 * (done[1:] + done[:-1]), np.linalg.norm(np.diff(points[:, 0], axis=0), axis=1)
    speed = speed / np.diff(times)
    inside = (middle > target.ramp_m) & (middle < guide.length - target.ramp_m)
    off = np.where(inside, np.abs(speed / wanted - 1.0), 0.0)
    worst = int(off.argmax())
    is_ok = bool(off[worst] <= target.speed_share)
    where = Where(float(s[worst]), find_time(law, float(s[worst])), None, (target.frame,))
    during = proof.phase.name
    if is_ok:
        text = f"{target.frame} moves within {100.0 * off[worst]:.1f} % of {wanted:g} m/s during {during}"
    else:
        text = f"{target.frame} moves at {speed[worst]:.3g} m/s instead of {wanted:g} during {during}"
    if target.ramp_m > 0.0:
        text += f", but for the first and last {1e3 * target.ramp_m:.0f} mm"
    return Check(f"{name}.speed", is_ok, float(off[worst]), target.speed_share, "1", text, where, Basis.SAMPLES)


def check_joint_way(proof: PhaseProof, target: JointWayTarget) -> Iterator[Check]:
    """Check that joints stay on a straight line, arrive, and move over time as their profile says."""
    motion, during = proof.prepared.motion, proof.phase.name
    columns = [motion.robot.joint_names.index(joint) for joint in target.joints]
    name = f"joint_way.{during}.{target.joints[0]}" if columns else f"joint_way.{during}"
    step = target.last - target.first
    square = float(step @ step)

    def off_line(q: Float[np.ndarray, "S k"]) -> Float[np.ndarray, "S k"]:
        offset = q - target.first
        if square > 0.0:
            offset = offset - np.outer(np.clip(offset @ step / square, 0.0, 1.0), step)
        return np.asarray(offset)

    def off(s: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(off_line(motion.curve(s)[:, columns]), axis=1))

    def deviation(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        bend, middle = motion.curve(first, 2)[:, columns], motion.curve(0.5 * (first + last), 2)[:, columns]
        most = np.maximum(np.linalg.norm(bend, axis=1), np.linalg.norm(2.0 * middle - bend, axis=1))
        return np.asarray(most * (last - first) ** 2 / 8.0)

    if columns:
        extreme = proof.bound_convex(off, deviation, target.tolerance)
        stays = "stay where they are" if square == 0.0 else "move on a straight line of configurations"
        text = f"{len(columns)} joints {stays} within {round_up(extreme.bound, 5)} during {during}"
        failure = f"the joints are {extreme.sampled:.2g} off where they should be during {during}"
        yield proof.check(name, extreme, target.tolerance, "rad", text, None, failure=failure, names=target.joints)
        end = float(np.abs(motion.curve(np.array([proof.phase.last]))[0, columns] - target.last).max())
        arrival = Extreme.at_one_pose(end, proof.phase.last, target.tolerance)
        text = f"the joints end within {round_up(end, 5)} of their goal in {during}"
        yield proof.check(f"{name}.end", arrival, target.tolerance, "rad", text, None, names=target.joints)
    if motion.law is None:
        return
    ends = find_times(motion.law, np.array([proof.phase.first, proof.phase.last]))
    duration = float(ends[1] - ends[0])
    if target.duration_s is not None:
        late = abs(duration / target.duration_s - 1.0)
        text = f"{during} takes {duration:.3f} s of {target.duration_s:g} s"
        where = Where(proof.phase.last, float(ends[1]), None)
        yield Check(f"{name}.duration", late <= 0.01, late, 0.01, "1", text, where, Basis.PROOF)
    if target.profile != "any":
        yield _check_profile(proof, target, columns, ends, name)


def _check_profile(
    proof: PhaseProof, target: JointWayTarget, columns: list[int], ends: Float[np.ndarray, "2"], name: str
) -> Check:
    """Check the joints over time against the polynomial, at samples."""
    motion, during = proof.prepared.motion, proof.phase.name
    assert motion.law is not None
    share = np.linspace(0.0, 1.0, max(LEAST_SAMPLES, int((ends[1] - ends[0]) / proof.settings.time_step_s)) + 1)
    s = motion.law.at(ends[0] + share * (ends[1] - ends[0]))[0]
    wanted = target.first + np.outer(evaluate_profile(target.profile, share), target.last - target.first)
    off = np.abs(motion.curve(s)[:, columns] - wanted).max(axis=1)
    worst = int(off.argmax())
    where = Where(float(s[worst]), find_time(motion.law, float(s[worst])), None, target.joints)
    text = f"the joints are within {round_up(float(off[worst]), 5)} of their {target.profile} profile during {during}"
    is_ok = bool(off[worst] <= target.tolerance)
    return Check(f"{name}.profile", is_ok, float(off[worst]), target.tolerance, "rad", text, where, Basis.SAMPLES)


def evaluate_profile(profile: str, share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the share of the way that is done at shares of the time: polynomials at rest at both ends."""
    if profile == QUINTIC:
        return np.asarray(share**3 * (10.0 + share * (6.0 * share - 15.0)))
    return np.asarray(share**2 * (3.0 - 2.0 * share))
