"""Reads the keys of a JSON object one by one, and collects what is wrong with them, a line each, by JSON path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from service.errors import shown, would_do

T = TypeVar("T")
LARGEST_NUMBER = 1e9  # beyond it a number is a mistake


class Fields:
    """One object of the document.  Every method that reads a key remembers it; ``close`` refuses all others.

    What is missing or wrong becomes a line in ``findings`` and reads as the fallback, so that reading goes on.
    """

    def __init__(self, data: object, path: str, findings: list[str]) -> None:
        """
        Args:
            data: should be an object.
            path: of the object in the document; empty for the document itself.
            findings: lines are added here.
        """
        self.path, self.findings = path, findings
        self._known: list[str] = []
        self._data: Mapping[str, Any] = {}
        if isinstance(data, Mapping):
            self._data = data
        else:
            self.refuse(path or "the document", f"an object is needed, got {shown(data)}")

    def refuse(self, path: str, what: str) -> None:
        """Add a line."""
        self.findings.append(f"{path}: {what}")

    def at(self, key: str) -> str:
        """Path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def has(self, key: str) -> bool:
        """Whether the key is given."""
        self._know(key)
        return key in self._data

    def first_of(self, *keys: str) -> str:
        """The one of several names for the same thing that is given; the first when none is."""
        given = [key for key in keys if self.has(key)]
        if len(given) > 1:
            self.refuse(self.at(given[1]), f"says the same as {given[0]}; leave one of them out")
        return given[0] if given else keys[0]

    def number(
        self, key: str, fallback: float | None = None, least: float = -LARGEST_NUMBER, most: float = LARGEST_NUMBER
    ) -> float:
        """A finite number; required without a fallback."""
        if not self._is_given(key, fallback):
            return 0.0 if fallback is None else fallback
        return self._number(self._data[key], self.at(key), least, most)

    def whole(self, key: str, fallback: int | None = None, least: int = -(10**9), most: int = 10**9) -> int:
        """A whole number; required without a fallback."""
        if not self._is_given(key, fallback):
            return least if fallback is None else fallback
        return self._whole(self._data[key], self.at(key), least, most)

    def flag(self, key: str, fallback: bool) -> bool:
        """True or false, also as the texts that tesseract writes."""
        if not self._is_given(key, fallback):
            return fallback
        value = self._data[key]
        if isinstance(value, str) and value.lower() in ("true", "false"):
            return value.lower() == "true"
        if not isinstance(value, bool):
            self.refuse(self.at(key), f"true or false is needed, got {shown(value)}")
            return fallback
        return value

    def text(self, key: str, fallback: str | None = None) -> str:
        """A text that is not empty; required without a fallback."""
        if not self._is_given(key, fallback):
            return "" if fallback is None else fallback
        value = self._data[key]
        if not isinstance(value, str) or not value or not value.isprintable():
            self.refuse(self.at(key), f"a text is needed, got {shown(value)}")
            return "" if fallback is None else fallback
        return value

    def choice(self, key: str, known: Iterable[str], fallback: str | None = None) -> str | None:
        """One of the known names in any case, or None where it is none of them."""
        if not self._is_given(key, fallback):
            return fallback
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
        """A list of numbers; a single number stands for a list of one."""
        if not self._is_given(key, fallback):
            return () if fallback is None else fallback
        path, entries = self.at(key), self._data[key]
        if not isinstance(entries, list):
            entries = [entries] if _is_number(entries) else entries
        if not isinstance(entries, list) or not entries:
            self.refuse(path, f"a list of numbers is needed, got {shown(entries)}")
            return () if fallback is None else fallback
        if length is not None and len(entries) != length:
            self.refuse(path, f"{length} numbers are needed, got {len(entries)}")
        return tuple(self._number(entry, f"{path}[{k}]", least, LARGEST_NUMBER) for k, entry in enumerate(entries))

    def wholes(self, key: str, least: int, most: int) -> tuple[int, ...]:
        """A list of whole numbers, by default none."""
        if not self._is_given(key, ()):
            return ()
        entries = self._list(key, "whole numbers")
        return tuple(self._whole(entry, f"{self.at(key)}[{k}]", least, most) for k, entry in enumerate(entries))

    def texts(self, key: str) -> tuple[str, ...]:
        """A required list of texts."""
        if not self._is_given(key, None):
            return ()
        entries = self._list(key, "texts")
        for k, entry in enumerate(entries):
            if not isinstance(entry, str) or not entry or not entry.isprintable():
                self.refuse(f"{self.at(key)}[{k}]", f"a text is needed, got {shown(entry)}")
        if not entries and isinstance(self._data[key], list):
            self.refuse(self.at(key), "at least one text is needed")
        return tuple(str(entry) for entry in entries)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...]:
        """A required list of lists of numbers."""
        if not self._is_given(key, None):
            return ()
        path = self.at(key)
        found: list[tuple[float, ...]] = []
        for k, row in enumerate(self._list(key, "lists of numbers")):
            if not isinstance(row, list):
                self.refuse(f"{path}[{k}]", f"a list of numbers is needed, got {shown(row)}")
                continue
            found.append(
                tuple(
                    self._number(entry, f"{path}[{k}][{j}]", -LARGEST_NUMBER, LARGEST_NUMBER)
                    for j, entry in enumerate(row)
                )
            )
        return tuple(found)

    def section(self, key: str, is_required: bool = True) -> Fields:
        """The object under a key; when it is missing, an empty one of which nothing more is said."""
        if not self._is_given(key, None if is_required else ()):
            return Fields({}, self.at(key), [])
        return Fields(self._data[key], self.at(key), self.findings)

    def sections(self, key: str) -> list[Fields]:
        """The objects of a list, by default none."""
        if not self._is_given(key, ()):
            return []
        entries = self._list(key, "objects")
        return [Fields(entry, f"{self.at(key)}[{k}]", self.findings) for k, entry in enumerate(entries)]

    def close(self) -> None:
        """Refuse every key that was not asked for."""
        for key in self._data:
            if key not in self._known:
                self.refuse(self.at(_printable(key)), f"unknown key; expected {would_do(key, self._known)}")

    def _know(self, key: str) -> None:
        if key not in self._known:
            self._known.append(key)

    def _is_given(self, key: str, fallback: object | None) -> bool:
        self._know(key)
        if key in self._data:
            return True
        if fallback is None:
            self.refuse(self.at(key), "is missing")
        return False

    def _list(self, key: str, of: str) -> list[Any]:
        value = self._data[key]
        if isinstance(value, list):
            return value
        self.refuse(self.at(key), f"a list of {of} is needed, got {shown(value)}")
        return []

    def _number(self, value: object, path: str, least: float, most: float) -> float:
        if not _is_number(value):
            self.refuse(path, f"a number is needed, got {shown(value)}")
            return max(least, 0.0)
        number = float(value)  # type: ignore[arg-type]
        if not least <= number <= most or not math.isfinite(number):
            self.refuse(path, f"expected {_range(least, most)}, got {shown(value)}")
            return max(least, 0.0)
        return number

    def _whole(self, value: object, path: str, least: int, most: int) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            self.refuse(path, f"a whole number is needed, got {shown(value)}")
            return max(least, 0)
        if not least <= value <= most:
            self.refuse(path, f"expected {_range(least, most)}, got {shown(value)}")
            return max(least, 0)
        return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _range(least: float, most: float) -> str:
    if most >= LARGEST_NUMBER:
        return f"at least {least:g}"
    return f"at most {most:g}" if least <= -LARGEST_NUMBER else f"{least:g} to {most:g}"


def _printable(key: str) -> str:
    return key if key.isprintable() and len(key) <= 60 else shown(key)
