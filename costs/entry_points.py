"""Parts that other packages add by entry points: kinds of tasks, detectors."""

from __future__ import annotations

import traceback
from collections.abc import Collection, Iterator
from importlib.metadata import entry_points
from typing import TypeVar

T = TypeVar("T")


def load_entry_points(
    group: str, wanted: type[T], taken: Collection[str], error: type[Exception]
) -> Iterator[tuple[str, T]]:
    """Yield the parts of other packages by name, in the order of the names.

    Args:
        group: of the entry points.
        wanted: class of the parts.
        taken: names of the parts of this project.
        error: raised with a sentence where a package fails, gives something else, or takes a name that is taken.
    """
    before: str | None = None
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        where = f"entry point {entry.name!r} of {group} ({entry.value})"
        try:
            part = entry.load()
        except Exception as reason:
            last = traceback.extract_tb(reason.__traceback__)[-1]
            words = f"{where}: {type(reason).__name__}: {reason} ({last.filename}, line {last.lineno})"
            raise error(words) from reason
        if not isinstance(part, wanted):
            raise error(f"{where}: {part!r}; expected a {wanted.__name__} named {entry.name!r}")
        if entry.name in taken or entry.name == before:
            raise error(f"{where}: {entry.name!r} exists already; expected another name")
        before = entry.name
        yield entry.name, part
