"""Plans carried out in physics, in a worker."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.errors import RequestError
from service.executor import Control
from service.simulation.options import SimulationOptions
from service.work.look import with_result_folder
from service.work.plan import Refused

SIMULATION_FIELDS = (
    "friction", "hand_friction", "feed_forward", "stiffness_scale", "noise", "delay_ms", "joint_friction", "seed",
    "perturb",
)  # fmt: skip


def simulate(files: Mapping[str, bytes], given: Mapping[str, float], control: Control) -> Mapping[str, Any] | Refused:
    """Carry out the plan of a result folder, given as its files by path; returns ``simulation.json`` without the track.

    Args:
        files: content by path.
        given: options by the names of ``SIMULATION_FIELDS``; others have their defaults.
        control: of the job.
    """
    try:
        options = SimulationOptions(**given)  # type: ignore[arg-type]
    except RequestError as error:
        return Refused(error.problems)

    def carry_out(folder: Path) -> Mapping[str, Any]:
        from service.simulation.report import make_report
        from service.simulation.run import execute_folder

        made, _ = make_report(execute_folder(folder, options))
        return {key: value for key, value in made.items() if key != "track"}

    return with_result_folder(files, carry_out, control)
