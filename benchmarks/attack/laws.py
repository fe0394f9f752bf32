"""False time laws for the verifier: faster than their stated speeds, which only dense differences show."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.attack.outcome import Answer, Attack
from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from service.verify import JointTarget, Motion, Phase, Status, VerifyError, verify

SPEED, ACCELERATION = 0.5, 10.0  # limits of the slide
EXCESS = 1.0 + 1e-3  # multiple of a limit that refutes a law
_SLIDE = """<robot name="slide">
  <link name="base"><collision><origin xyz="0 0 -1"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="tip"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" velocity="0.5" effort="1000"/></joint>
  <joint name="bend" type="revolute"><parent link="arm"/><child link="tip"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" velocity="0.5" effort="1000"/></joint>
</robot>"""


@cache
def _robot() -> RobotModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "slide.urdf"
        path.write_text(_SLIDE, encoding="utf-8")
        return load_robot(urdf=path)


def _motion(law: TimeLaw, curve: Curve | None = None, samples: np.ndarray | None = None) -> Motion:
    """Return a motion of the first joint by 2 rad along ``s`` from 0 to 2, at rest at both ends by the law alone."""
    curve = curve or Curve(np.array([0.0, 2.0]), np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([[1.0, 0.0]] * 2))
    last = float(curve.knots[-1])
    end = tuple(
        JointTarget(n, float(q), 1e-3, last) for n, q in zip(("turn", "bend"), curve.positions[-1], strict=True)
    )
    phases = (Phase("turn", 0.0, last, targets=end),)
    return Motion(_robot(), Scene(), curve, law, phases, np.linspace(0.0, last, 201) if samples is None else samples)


def true_peaks(law: TimeLaw, curve: Curve) -> tuple[float, float]:
    """Return the largest speed and acceleration of the table of times, in multiples of the limits.

    Times and path alone say where the robot is when: speeds are differences over windows of at least a millisecond,
    accelerations second differences over 50 ms.
    """
    t = np.linspace(law.times[0], law.times[-1], 40_001)
    s = np.interp(t, law.times, law.path)
    q = curve(s)
    speed = 0.0
    for window in (20, 200, 2000):
        step = t[window] - t[0]
        if step >= 1e-3:
            speed = max(speed, float(np.abs(q[window:] - q[:-window]).max() / step))
    window = max(1, int(np.ceil(0.05 / (t[1] - t[0]))))
    bend = np.abs(q[2 * window :] - 2.0 * q[window:-window] + q[: -2 * window]).max(initial=0.0)
    return speed / SPEED, float(bend / (window * (t[1] - t[0])) ** 2) / ACCELERATION


def _ramps(peak: float, ramp_s: float, told: float = 1.0, steps: int = 400, length: float = 2.0) -> TimeLaw:
    """Speed up, cruise, slow down; the law states ``told`` times its true speed."""
    distance = peak * ramp_s
    cruise = (length - distance) / peak
    times = np.linspace(0.0, 2.0 * ramp_s + cruise, steps + 1)
    times = np.unique(np.concatenate([times, [ramp_s, ramp_s + cruise]]))
    speed = peak * np.clip(np.minimum(times / ramp_s, (times[-1] - times) / ramp_s), 0.0, 1.0)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])
    return TimeLaw(times, path * length / path[-1], speed * told)


def many_tiny_steps() -> Motion:
    """Make each step too long by half of a tolerance relative to the whole path."""
    law = _ramps(0.49, 0.3, steps=199_998, length=1.8)
    return _motion(TimeLaw(law.times, np.linspace(0.0, 0.2, len(law.path)) + law.path, law.speed))


def tiny_steps_at_0605() -> Motion:
    """Make 4e5 steps at 0.605 rad/s with a stated speed of 0.4999."""
    n, fast, told = 400_000, 0.605, 0.4999
    times = np.linspace(0.0, 2.0 / fast, n + 1)
    path = np.linspace(0.0, 2.0, n + 1)
    ramp = np.clip(np.minimum(np.arange(n + 1), n - np.arange(n + 1)) / 40_000, 0.0, 1.0)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (ramp[1:] + ramp[:-1]))])
    return _motion(TimeLaw(times * 1.1, 2.0 * path / path[-1], told * ramp))


def _lied(peak: float, told: float, steps: int) -> Callable[[], Motion]:
    return lambda: _motion(_ramps(peak, 0.3, told, steps))


def jitter() -> Motion:
    """Make steps alternately much longer and shorter than stated, all within a rounding of the whole path."""
    law = _ramps(0.49, 0.3, steps=200_000)
    path = law.path + np.where(np.arange(len(law.path)) % 2 == 1, 0.9e-6, -0.9e-6)
    path[0], path[-1] = 0.0, 2.0
    return _motion(TimeLaw(law.times, np.minimum(np.maximum.accumulate(path), 2.0), law.speed))


def burst() -> Motion:
    """Make a thousand steps in the middle 50 % longer than stated."""
    law = _ramps(0.45, 0.3, steps=200_000)
    step = np.diff(law.path)
    step[90_000:110_000] *= 1.5
    path = np.concatenate([[0.0], np.cumsum(step)])
    return _motion(TimeLaw(law.times, 2.0 * path / path[-1], law.speed))


def time_stands_still() -> Motion:
    """Put two grid points at the same time."""
    law = _ramps(0.49, 0.3)
    times = law.times.copy()
    times[200] = times[199]
    return _motion(TimeLaw(times, law.path, law.speed))


def nearly_no_time() -> Motion:
    """Move by 0.1 rad within a picosecond, with a stated rest at both ends."""
    law = _ramps(0.49, 0.3, length=1.9)
    k = int(np.searchsorted(law.path, 1.0))
    times = np.insert(law.times, k, law.times[k - 1] + 1e-12)
    path = np.insert(law.path, k, law.path[k - 1])
    path[k:] += 0.1
    return _motion(TimeLaw(times, path, np.insert(law.speed, k, law.speed[k - 1])))


def path_runs_back() -> Motion:
    """Let the path run back a little in the middle."""
    law = _ramps(0.49, 0.3)
    path = law.path.copy()
    path[200:220] = path[200:220][::-1]
    return _motion(TimeLaw(law.times, path, law.speed))


def path_jumps() -> Motion:
    """Add a step of the path that no speed explains."""
    law = _ramps(0.49, 0.3, length=1.9)
    path = np.where(np.arange(len(law.path)) > 200, law.path + 0.1, law.path)
    return _motion(TimeLaw(law.times, path, law.speed))


def ends_too_early() -> Motion:
    """Stop the law before the end of the curve."""
    law = _ramps(0.49, 0.3, length=1.99)
    return _motion(law)


def starts_at_full_speed() -> Motion:
    """Start at full speed."""
    times = np.linspace(0.0, 2.0 / 0.49, 101)
    return _motion(TimeLaw(times, 0.49 * times, np.full(101, 0.49)))


def law_with_nan() -> Motion:
    """Set a speed to NaN."""
    law = _ramps(0.49, 0.3)
    speed = law.speed.copy()
    speed[100] = np.nan
    return _motion(TimeLaw(law.times, law.path, speed))


def negative_speeds() -> Motion:
    """Set speeds below zero."""
    law = _ramps(0.49, 0.3)
    return _motion(TimeLaw(law.times, law.path, -law.speed))


def jerky_acceleration() -> Motion:
    """Accelerate to full speed within 20 ms: 25 rad/s^2 where 10 are allowed."""
    return _motion(_ramps(0.49, 0.02))


def acceleration_between_grid_points() -> Motion:
    """Bend the curve most where the law has no grid point."""
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 0.4], [2.0, 0.0]]),
        np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]]))  # fmt: skip
    law = _ramps(0.499, 0.3, steps=4)
    return _motion(law, curve)


def overshooting_tangents() -> Motion:
    """Give the curve much steeper tangents between its knots than its law allows for."""
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]),
        np.array([[0.2, 0.0], [3.0, 0.0], [0.2, 0.0]]))  # fmt: skip
    return _motion(_ramps(0.49, 0.3), curve)


def overlapping_samples() -> Motion:
    """Let the samples go back."""
    samples = np.linspace(0.0, 2.0, 201)
    samples[100] = samples[90]
    return _motion(_ramps(0.49, 0.3), samples=samples)


def repeated_samples() -> Motion:
    """Repeat a sample."""
    return _motion(_ramps(0.49, 0.3), samples=np.sort(np.append(np.linspace(0.0, 2.0, 201), 1.0)))


def samples_beyond_the_curve() -> Motion:
    """Put samples past the end."""
    return _motion(_ramps(0.49, 0.3), samples=np.linspace(0.0, 2.5, 201))


def honest() -> Motion:
    """Return a law within all limits that states its true speeds."""
    return _motion(_ramps(0.49, 0.3))


LAWS: dict[str, Callable[[], Motion]] = {
    "2e5 tiny steps, each a hair too long": many_tiny_steps,
    "4e5 tiny steps at 0.605 under 0.5": tiny_steps_at_0605,
    "twice as fast as told": _lied(0.98, 0.5, 400),
    "1 % faster than told": _lied(0.52, 0.96, 400),
    "1 % faster than told, in 2e5 steps": _lied(0.52, 0.96, 200_000),
    "20 % faster than told, in 2e6 steps": _lied(0.6, 0.8, 2_000_000),
    "jitter": jitter,
    "a burst in the middle": burst,
    "time that stands still": time_stands_still,
    "nearly no time": nearly_no_time,
    "path that runs back": path_runs_back,
    "path that jumps": path_jumps,
    "law that ends too early": ends_too_early,
    "no rest at the start": starts_at_full_speed,
    "a speed that is no number": law_with_nan,
    "negative speeds": negative_speeds,
    "full speed within 20 ms": jerky_acceleration,
    "bends between grid points": acceleration_between_grid_points,
    "overshooting tangents": overshooting_tangents,
    "samples that overlap": overlapping_samples,
    "a sample twice": repeated_samples,
    "samples beyond the curve": samples_beyond_the_curve,
}
SLOW = (
    "20 % faster than told, in 2e6 steps",
    "2e5 tiny steps, each a hair too long",
    "jitter",
    "a burst in the middle",
)


def attacks() -> list[Attack]:
    """Return the false laws, and the correct law that they are made from."""
    found = [Attack("laws", name, _judged(make), name not in SLOW) for name, make in LAWS.items()]
    return [*found, Attack("harmless", "an honest law", _honest)]


def _judged(make: Callable[[], Motion]) -> Callable[[Path], tuple[Answer, str]]:
    def run(scratch: Path) -> tuple[Answer, str]:
        try:
            motion = make()
            certificate = verify(motion)
        except (VerifyError, ValueError) as error:
            return Answer.REFUSED, str(error)
        if certificate.status is not Status.CERTIFIED:
            failed = [check.text for check in certificate.failed()]
            return Answer.REPORTED, f"{certificate.status.value}: {(failed or ['unproven'])[0]}"
        assert motion.law is not None
        speed, acceleration = true_peaks(motion.law, motion.curve)
        text = (
            f"CERTIFIED; truly {100.0 * speed:.2f} % of the speed and {100.0 * acceleration:.1f} % of the acceleration"
        )
        return (Answer.BELIEVED if max(speed, acceleration) > EXCESS else Answer.TRUE), text

    return run


def _honest(scratch: Path) -> tuple[Answer, str]:
    answer, text = _judged(honest)(scratch)
    return (answer, text) if answer in (Answer.TRUE, Answer.CRASHED) else (Answer.ALARM, text)
