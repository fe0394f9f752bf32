"""``service.simulate``: the plan of a result folder in physics, and its verdict."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.errors import ResultError
from service.result.folder import SIMULATION_NAME, result_path
from service.simulation.options import SimulationOptions
from service.simulation.report import make_report
from service.simulation.run import execute_folder


def simulate(
    path: str | Path,
    options: SimulationOptions | None = None,
    *,
    output: str | Path | None = None,
    report: Callable[[str, float | None], None] | None = None,
) -> dict[str, Any]:
    """Carry out the plan of a result folder in MuJoCo, and return the verdict: the content of ``simulation.json``.

    The folder is read like ``scopt verify`` reads it; that a certified motion is the requested one is for
    ``scopt verify`` to say.

    Args:
        path: the folder or its ``result.json``.
        options: friction, feed-forward, noise, delay.
        output: file to write; None for ``simulation.json`` in the folder.
        report: called with a step and the share that is done.

    Raises:
        ResultError: one line: the folder cannot be used or written, the plan has no time law, the robot lacks masses
            or efforts, or MuJoCo is not installed.
    """
    made = make_report(execute_folder(path, options, report))
    write_simulation(made, result_path(path).parent / SIMULATION_NAME if output is None else Path(output))
    return made


def write_simulation(report: dict[str, Any], path: Path) -> None:
    """Write a report, replacing the file as a whole.

    Raises:
        ResultError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            file.write(json.dumps(report, allow_nan=False))
        os.replace(file.name, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror}") from None
