"""Commands that lead plain position servos to the planned pose: their sag under the plan's load is taken off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from service.errors import ResultError, shown
from service.execution.reference import PlannedReference
from service.replay.replay import read_motion, read_request
from service.result.folder import read_result
from service.start.robot import resolve_stiffness
from service.viewer.files import replace_file

STEP_S = 4e-3  # between two commands of a table


def lead_servos(
    q: Float[np.ndarray, "T k"],
    qd: Float[np.ndarray, "T k"],
    tau: Float[np.ndarray, "T k"],
    stiffness: Float[np.ndarray, "k"],
    step_s: float,
    feed_forward: float = 0.0,
) -> tuple[Float[np.ndarray, "T k"], Float[np.ndarray, "T k"]]:
    """Return positions and speeds that servos at rest turn into the planned ones, ``q + (1 - Kf) tau / Kp``.

    A servo makes ``Kp (q_d - q) + Kf tau`` (Liu et al., Humanoids 2015, eq. 8).  With these commands that is the plan's
    torque ``tau = rnea - J^T f`` at the plan's position ``q``.

    Args:
        q, qd, tau: of the plan at even times.
        stiffness: ``Kp`` of the servos [N m/rad, N/m].
        step_s: between two times [s].
        feed_forward: share ``Kf`` of the torques that the servos add.
    """
    sag = (1.0 - feed_forward) * tau / stiffness
    return q + sag, qd + np.gradient(sag, step_s, axis=0)


def write_servo_reference(folder: Path, path: Path, *, any_verdict: bool = False) -> Path:
    """Write what position servos without feed-forward are commanded as a table: ``time_s``, then a column per joint.

    Args:
        folder: of the result.
        path: file to write; an earlier one is replaced.
        any_verdict: whether a motion without a certificate is written as well.

    Raises:
        ResultError: one line: the result has no certificate, cannot be read or executed, or the file cannot be written.
    """
    data = read_result(folder)
    if data["verdict"] != "CERTIFIED" and not any_verdict:
        raise ResultError(f"the verdict is {shown(data['verdict'])}; --any-verdict exports the motion all the same")
    reference, request = PlannedReference(read_motion(data, folder)), read_request(data, folder)
    table = resolve_stiffness(reference.robot, request)
    stiffness = np.array([table[name] for name in reference.joint_names])
    times = np.arange(round(reference.duration_s / STEP_S) + 1) * STEP_S
    q, _ = lead_servos(*reference.tabulate_commands(times), stiffness, STEP_S)
    lines = [",".join(("time_s", *reference.joint_names))]
    lines += [",".join(f"{value:.9g}" for value in row) for row in np.column_stack([times, q])]
    try:
        replace_file(path, ("\n".join(lines) + "\n").encode())
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror}") from None
    return path
