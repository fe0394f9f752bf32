"""A request that uses a task file, as the request that it stands for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown
from service.request.task_files.expressions import ExpressionError, fill_in
from service.request.task_files.files import find_task_file

USE, WITH = "use", "with"


def use_task(data: Mapping[str, Any], own: Sequence[Path] = ()) -> dict[str, Any]:
    """Return a request's plain data with its ``task: {use: NAME, with: {...}}`` replaced by what the file makes of it.

    Data without ``use`` are returned as they are.

    Args:
        data: of the request.
        own: folders of the request, in which task files are looked for first.

    Raises:
        RequestError: there is no such task, or its parameters do not fit.
    """
    task = data.get("task")
    if not isinstance(task, Mapping) or USE not in task:
        return dict(data)
    name, given = task[USE], task.get(WITH) or {}
    if not isinstance(name, str) or not name.replace("_", "").replace("-", "").isalnum():
        raise RequestError(f"task.use: expected the name of a task file, got {shown(name)}")
    if not isinstance(given, Mapping):
        raise RequestError(f"task.with: a mapping is needed, got {shown(given)}")
    others = [key for key in task if key not in (USE, WITH)]
    if others:
        raise RequestError(f"task.{others[0]}: goes into the task file; expected use and with alone")
    file = find_task_file(name, own)
    values = file.take(given)
    try:
        made = fill_in(file.data.task, values)
        attached = fill_in(list(file.data.attached), values)
        start = fill_in(file.data.start, values)
    except ExpressionError as error:
        raise RequestError(f"task file {file.path.name}: {error}") from None
    filled = {**data, "task": made}
    if attached:
        filled["attached"] = [*(data.get("attached") or ()), *attached]
    if start is not None and not data.get("start"):
        filled["start"] = start
    return filled
