"""JSON objects read key by key; every problem is collected as one line with its JSON path."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown, would_do

MAX_BYTES = 20_000_000
MAX_DEPTH = 20
LARGEST_NUMBER = 1e9  # a larger number is a mistake


def read_document(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises:
        RequestError: the file cannot be read or holds no JSON object.
    """
    try:
        if not path.is_file():
            raise RequestError(f"{path}: is not a file; a TrajOpt problem (JSON) is needed")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise RequestError(f"{path.name}: is {size} bytes long; expected at most {MAX_BYTES}")
        return parse_document(path.read_text(encoding="utf-8-sig"), path.name)
    except UnicodeDecodeError as error:
        raise RequestError(f"{path.name}: is no UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise RequestError(f"{path.name}: cannot be read: {error.strerror}") from None


def parse_document(text: str, name: str) -> dict[str, Any]:
    """Return the object in a JSON text; ``name`` is the file's, for messages.

    Raises:
        RequestError: the text is no strict JSON object, repeats a key, or is nested too deeply.
    """
    try:
        data = json.loads(text, object_pairs_hook=_refuse_repeated_keys, parse_constant=_refuse_constant)
        if _measure_depth(data) > MAX_DEPTH:
            raise RecursionError
    except json.JSONDecodeError as error:
        raise RequestError(f"{name}: line {error.lineno}: no valid JSON: {_explain_syntax(error)}") from None
    except RecursionError:
        raise RequestError(f"{name}: nested deeper than {MAX_DEPTH} levels") from None
    except ValueError as error:
        raise RequestError(f"{name}: {error}") from None
    if not isinstance(data, dict):
        raise RequestError(f"{name}: an object is needed, got {shown(data)}")
    return data


class Fields:
    """One object of the document.

    A missing or wrong value becomes a line in ``findings`` and reads as the fallback, so that reading continues.
    Methods that take a ``fallback`` require the key if it is None.
    """

    def __init__(self, data: object, path: str, findings: list[str]) -> None:
        """
        Args:
            data: the value in the document; anything but an object becomes a finding.
            path: JSON path of the object; empty for the document itself.
            findings: list that receives the lines.
        """
        self.path, self.findings = path, findings
        self._known: list[str] = []
        self._data: Mapping[str, Any] = {}
        if isinstance(data, Mapping):
            self._data = data
        else:
            self.refuse(path or "the document", f"an object is needed, got {shown(data)}")

    def refuse(self, path: str, problem: str) -> None:
        """Add a finding."""
        self.findings.append(f"{path}: {problem}")

    def at(self, key: str) -> str:
        """Return the JSON path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def has(self, key: str) -> bool:
        """Return whether the document has the key; the key is known from then on."""
        if key not in self._known:
            self._known.append(key)
        return key in self._data

    def first_of(self, *keys: str) -> str:
        """Return which of several synonymous keys the document has, by default the first."""
        present = [key for key in keys if self.has(key)]
        if len(present) > 1:
            self.refuse(self.at(present[1]), f"says the same as {present[0]}; leave one of them out")
        return present[0] if present else keys[0]

    def number(
        self, key: str, fallback: float | None = None, least: float = -LARGEST_NUMBER, most: float = LARGEST_NUMBER
    ) -> float:
        """Read a finite number."""
        if not self._is_present(key, fallback):
            return 0.0 if fallback is None else fallback
        return float(self._number(self._data[key], self.at(key), least, most))

    def whole(self, key: str, fallback: int | None = None, least: int = -(10**9), most: int = 10**9) -> int:
        """Read a whole number."""
        if not self._is_present(key, fallback):
            return least if fallback is None else fallback
        return int(self._number(self._data[key], self.at(key), least, most, is_whole=True))

    def flag(self, key: str, fallback: bool) -> bool:
        """Read true or false; Tesseract writes them as texts."""
        if not self._is_present(key, fallback):
            return fallback
        value = self._data[key]
        if isinstance(value, str) and value.lower() in ("true", "false"):
            return value.lower() == "true"
        if not isinstance(value, bool):
            self.refuse(self.at(key), f"true or false is needed, got {shown(value)}")
            return fallback
        return value

    def text(self, key: str, fallback: str | None = None) -> str:
        """Read a text that is not empty."""
        if not self._is_present(key, fallback) or not self._is_text(self._data[key], self.at(key)):
            return fallback or ""
        return str(self._data[key])

    def choice(self, key: str, known: Iterable[str]) -> str | None:
        """Read a known name in any case; None if the key is missing or the name unknown."""
        value = self.text(key)
        names = {name.lower(): name for name in known}
        if value and value.lower() not in names:
            self.refuse(self.at(key), f"unknown {key} {value!r}; expected {would_do(value, names.values())}")
        return names.get(value.lower())

    def numbers(
        self,
        key: str,
        fallback: tuple[float, ...] | None = None,
        length: int | None = None,
        least: float = -LARGEST_NUMBER,
    ) -> tuple[float, ...]:
        """Read a list of numbers; a single number counts as a list of one."""
        if not self._is_present(key, fallback):
            return fallback or ()
        path, entries = self.at(key), self._data[key]
        if _is_number(entries):
            entries = [entries]
        if not isinstance(entries, list) or not entries:
            self.refuse(path, f"a list of numbers is needed, got {shown(entries)}")
            return fallback or ()
        if length is not None and len(entries) != length:
            self.refuse(path, f"{length} numbers are needed, got {len(entries)}")
        return self._numbers(entries, path, least)

    def wholes(self, key: str, least: int, most: int) -> tuple[int, ...]:
        """Read a list of whole numbers, by default empty."""
        entries = self._list(key, "whole numbers", is_required=False)
        return tuple(int(self._number(entry, path, least, most, is_whole=True)) for path, entry in entries)

    def texts(self, key: str) -> tuple[str, ...]:
        """Read a required list of at least one text."""
        entries = self._list(key, "texts")
        for path, entry in entries:
            self._is_text(entry, path)
        if self._data.get(key) == []:
            self.refuse(self.at(key), "at least one text is needed")
        return tuple(str(entry) for _, entry in entries)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...]:
        """Read a required list of lists of numbers."""
        rows: list[tuple[float, ...]] = []
        for path, row in self._list(key, "lists of numbers"):
            if isinstance(row, list):
                rows.append(self._numbers(row, path, -LARGEST_NUMBER))
            else:
                self.refuse(path, f"a list of numbers is needed, got {shown(row)}")
        return tuple(rows)

    def section(self, key: str, is_required: bool = True) -> Fields:
        """Return the object under a key; findings of a missing one are dropped."""
        if not self._is_present(key, None if is_required else ()):
            return Fields({}, self.at(key), [])
        return Fields(self._data[key], self.at(key), self.findings)

    def sections(self, key: str) -> list[Fields]:
        """Return the objects of a list, by default none."""
        return [Fields(entry, path, self.findings) for path, entry in self._list(key, "objects", is_required=False)]

    def close(self) -> None:
        """Refuse every key that no method has read."""
        for key in self._data:
            if key not in self._known:
                name = key if key.isprintable() and len(key) <= 60 else shown(key)
                self.refuse(self.at(name), f"unknown key; expected {would_do(key, self._known)}")

    def _is_present(self, key: str, fallback: object | None) -> bool:
        if self.has(key):
            return True
        if fallback is None:
            self.refuse(self.at(key), "is missing")
        return False

    def _list(self, key: str, content: str, is_required: bool = True) -> list[tuple[str, Any]]:
        """Return path and value of each entry of a list; ``content`` names them in messages."""
        if not self._is_present(key, None if is_required else ()):
            return []
        value = self._data[key]
        if isinstance(value, list):
            return [(f"{self.at(key)}[{k}]", entry) for k, entry in enumerate(value)]
        self.refuse(self.at(key), f"a list of {content} is needed, got {shown(value)}")
        return []

    def _numbers(self, entries: list[Any], path: str, least: float) -> tuple[float, ...]:
        return tuple(
            float(self._number(entry, f"{path}[{k}]", least, LARGEST_NUMBER)) for k, entry in enumerate(entries)
        )

    def _number(self, value: Any, path: str, least: float, most: float, is_whole: bool = False) -> float:
        if not _is_number(value) or (is_whole and not isinstance(value, int)):
            self.refuse(path, f"a {'whole ' if is_whole else ''}number is needed, got {shown(value)}")
        elif not least <= value <= most or not math.isfinite(value):
            self.refuse(path, f"expected {_describe_range(least, most)}, got {shown(value)}")
        else:
            return value  # type: ignore[no-any-return]
        return max(least, 0.0)

    def _is_text(self, value: object, path: str) -> bool:
        if isinstance(value, str) and value and value.isprintable():
            return True
        self.refuse(path, f"a text is needed, got {shown(value)}")
        return False


def _explain_syntax(error: json.JSONDecodeError) -> str:
    """Return what is wrong at the place of a syntax error, and how to mend what other readers of JSON tolerate."""
    before, rest = error.doc[: error.pos].rstrip(), error.doc[error.pos :].lstrip()
    if not rest:
        return "the text ends before its brackets are closed"
    if rest.startswith(("//", "/*", "#")):
        return f"a comment ({shown(rest.splitlines()[0])}); remove it"
    # Since Python 3.13 the place of a comma too many is the comma.
    if rest.startswith(","):
        before, rest = f"{before},", rest[1:].lstrip()
    if before.endswith(",") and rest.startswith(("}", "]")):
        return f"a comma before {rest[0]!r}; remove it"
    return error.msg


def _refuse_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {shown(repeated)} is given twice")
    return data


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number that JSON has")


def _measure_depth(data: object) -> int:
    """Return the number of nested levels, without recursion."""
    level, depth = [data], 0
    while level:
        depth += 1
        level = [
            entry
            for container in level
            if isinstance(container, dict | list)
            for entry in (container.values() if isinstance(container, dict) else container)
            if isinstance(entry, dict | list)
        ]
    return depth


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _describe_range(least: float, most: float) -> str:
    if most >= LARGEST_NUMBER:
        return f"at least {least:g}"
    return f"at most {most:g}" if least <= -LARGEST_NUMBER else f"{least:g} to {most:g}"
