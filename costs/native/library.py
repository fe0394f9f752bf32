"""The compiled library, which an installation builds; without it, the same is computed by numpy and coal."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import Any

import numpy as np

from costs.native.build import LIBRARY, ROOT, find_digest

_IS_USED: ContextVar[bool] = ContextVar("is_library_used", default=True)


@lru_cache(maxsize=1)
def _load() -> ctypes.CDLL | None:
    try:
        library = ctypes.CDLL(str(ROOT / LIBRARY))
        library.scopt_digest.restype = ctypes.c_char_p
        return library if library.scopt_digest().decode() == find_digest() else None
    except (OSError, AttributeError):
        return None


def find_library() -> ctypes.CDLL | None:
    """Return the library; None where it was not built, was built from other sources, or is not to be used."""
    return _load() if _IS_USED.get() else None


def describe_missing() -> str:
    """Return a line for users if the library cannot be called, else an empty text."""
    if _load() is not None:
        return ""
    state = "is older than its sources" if (ROOT / LIBRARY).exists() else "was not built"
    return f"{LIBRARY} {state}: plans are the same, and take up to half as long again; make setup builds it"


@contextmanager
def without_library() -> Iterator[None]:
    """Compute by numpy and coal in the body, as an installation without the library does."""
    token = _IS_USED.set(False)
    try:
        yield
    finally:
        _IS_USED.reset(token)


Argument = np.ndarray | int | float | ctypes.c_void_p


def call(function: ctypes._NamedFuncPointer, *arguments: Argument) -> int:
    """Call a function of the library with arrays, as the addresses of their numbers, with whole and with real numbers.

    Returns:
        what it returns; of functions that return nothing, any number.

    Raises:
        TypeError: the numbers of an array are of a kind that the library does not read, or not one after the other.
    """
    return int(function(*map(_to_c, arguments)))


def bind(function: ctypes._NamedFuncPointer, *arguments: Argument) -> Callable[[], int]:
    """Return the call of a function with arguments that are read anew at every call.

    Raises:
        TypeError: as ``call``.
    """
    converted = tuple(map(_to_c, arguments))

    def repeat(kept: tuple[Argument, ...] = arguments) -> int:
        return int(function(*converted))

    return repeat


def _to_c(argument: Argument) -> Any:
    if isinstance(argument, np.ndarray):
        if argument.dtype.char not in "dl?B" or not argument.flags.c_contiguous:
            raise TypeError(f"the library reads no {argument.dtype} with strides {argument.strides}")
        try:
            return ctypes.byref(ctypes.c_char.from_buffer(argument.data))  # a sixth of the time of ``argument.ctypes``
        except (TypeError, ValueError):  # read-only, or empty
            return ctypes.c_void_p(argument.ctypes.data)
    if isinstance(argument, ctypes.c_void_p):
        return argument
    return ctypes.c_double(argument) if isinstance(argument, float) else ctypes.c_int64(argument)
