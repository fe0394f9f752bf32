"""Task tabs: one for each task file, and the request that a tab makes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from service.cli.console.scans import find_hit, find_scan
from service.cli.console.sessions import OperatorSession
from service.errors import RequestError
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.request.task_files import TaskFile, find_task_file, list_task_paths, read_task_file, use_task
from service.scan.bind import read_hit

ANY_ROBOT = "atlas"  # stands in where a tab is read without a robot
HINT, MOVED = "hint", "moved_m"


class PlanFields(Protocol):
    """What a tab sends."""

    task: str
    values: dict[str, Any]
    robot: str
    posture: str | None
    scan: str | None
    hit: int | None


def list_tabs() -> list[dict[str, Any]]:
    """Return a tab per task file, read anew; one that cannot be used has its errors in place of parameters."""
    tabs = []
    for path in list_task_paths():
        try:
            tabs.append(_make_tab(read_task_file(path)))
        except RequestError as error:
            tabs.append({"name": path.stem, "help": "", "parameters": [], "kinds": [], "errors": list(error.problems)})
    return tabs


def make_request(session: OperatorSession, scans: Sequence[Path], order: PlanFields) -> PlanRequest:
    """Return the request of a tab.

    Parameters that the accepted object gives (``detect`` and ``value`` of a task file) are read off it unless the
    operator set them, and a task that looks for its object does so where the operator accepted one.

    Raises:
        RequestError: there is no such task, scan or object, or its values do not fit.
    """
    hit = None if order.hit is None else find_hit(session.hits, order.hit)
    values = dict(order.values)
    if hit is not None:
        values = {**_read_parameters(order.task, hit), **values}
    data: dict[str, Any] = {"robot": {"name": order.robot}, "task": {"use": order.task, "with": values}}
    if order.posture is not None:
        data["start"] = {"posture": order.posture}
    if order.scan is not None:
        data["scene"] = {"cloud": str(find_scan(scans, order.scan))}
    used = use_task(data)
    if hit is not None:
        used["task"] = _add_place(used["task"], hit)
    return parse_request(used)


def _make_tab(file: TaskFile) -> dict[str, Any]:
    parameters = [
        {
            "name": name,
            "type": parameter.type,
            "unit": parameter.unit,
            "help": parameter.help,
            "default": parameter.default,
            "range": parameter.range,
            "choices": list(parameter.choices),
            "detect": parameter.detect,
        }
        for name, parameter in file.data.parameters.items()
    ]
    detected = [parameter.detect for parameter in file.data.parameters.values() if parameter.detect is not None]
    kinds = list(dict.fromkeys([*detected, *_list_kinds(file)]))
    return {"name": file.name, "help": file.data.help, "parameters": parameters, "kinds": kinds, "errors": []}


def _list_kinds(file: TaskFile) -> tuple[str, ...]:
    """Return the kinds of objects that a task looks for in its scan; none if it needs values to say so."""
    from perception import find_offered

    try:
        request = parse_request({"robot": {"name": ANY_ROBOT}, "task": {"use": file.name}})
    except RequestError:
        return ()
    return tuple(map(find_offered, request.section.detected))


def _read_parameters(task: str, hit: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: read_hit(hit, parameter.value, f"values.{name}")
        for name, parameter in find_task_file(task).data.parameters.items()
        if parameter.value is not None and parameter.detect == hit["searched"]
    }


def _add_place(task: Any, hit: Mapping[str, Any]) -> Any:
    """Return a task whose section says where its object is, and how far the operator moved its fit.

    A section without a place for it, or one that says so itself, stays as it is.
    """
    section = parse_request({"robot": {"name": ANY_ROBOT}, "task": task}).section
    name, given = next(iter(task.items()))
    if len(task) != 1 or not isinstance(given, Mapping):
        return task
    given = dict(given)
    if getattr(section, HINT, given) is None:
        seen = np.array(hit["pose_world_object"])[:3, 3] - hit["moved_m"]
        given[HINT] = seen.tolist()
    if getattr(section, MOVED, given) is None and any(hit["moved_m"]):
        given[MOVED] = hit["moved_m"]
    return {name: given}
