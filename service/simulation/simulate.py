"""``service.simulate``: the plan of a result folder in physics, and its verdict."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.errors import ResultError
from service.result.folder import SIMULATION_NAME, read_result, result_path
from service.result.manifest import forget_files, record_files
from service.simulation.options import SimulationOptions
from service.simulation.page import write_page
from service.simulation.report import make_report
from service.simulation.run import execute_folder
from service.viewer.files import replace_file


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
        options: friction, feed-forward, noise, delay. Without a friction of the hands both ends of the request's
            interval are tried, and the worse verdict counts.
        output: file to write; None for ``simulation.json`` in the folder. A page of the same name ends in ``.html``.
        report: called with a step and the share that is done.

    Raises:
        ResultError: one line: the folder cannot be used or written, the plan has no time law, the robot lacks masses
            or efforts, or MuJoCo is not installed.
    """
    file = result_path(path).parent / SIMULATION_NAME if output is None else Path(output)
    made, execution = make_report(execute_folder(path, options, report))
    folder, names = result_path(path).parent, (file.name, file.with_suffix(".html").name)
    is_of_result = output is None
    if is_of_result:
        forget_files(folder, names)
    write_simulation(made, file)
    if report is not None:
        report("write page", 1.0)
    try:
        write_page(read_result(path), execution, made, file.with_suffix(".html"))
    except OSError as error:
        raise ResultError(f"{file.with_suffix('.html')} cannot be written: {error.strerror}") from None
    if is_of_result:
        record_files(folder, names)
    return made


def write_simulation(report: dict[str, Any], path: Path) -> None:
    """Write a report, replacing the file as a whole.

    Raises:
        ResultError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, json.dumps(report, allow_nan=False).encode("utf-8"))
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror}") from None
