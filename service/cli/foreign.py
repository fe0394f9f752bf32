"""Libraries that a shell's PYTHONPATH or LD_LIBRARY_PATH (such as that of ROS) puts before scopt's own."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from pathlib import Path

LIBRARIES = ("pinocchio", "coal", "hppfcl", "eigenpy", "numpy", "scipy", "google.protobuf", "grpc", "yaml", "lxml")


def explain_foreign_libraries(error: BaseException) -> str | None:
    """Return a sentence about libraries from elsewhere that may be the cause of an error; None if there are none."""
    if found := list(_find_shadowing()):
        name, folder = found[0]
        more = f" (and {', '.join(other for other, _ in found[1:])})" if len(found) > 1 else ""
        return (
            f"{name}{more} comes from PYTHONPATH {folder} instead of scopt's own environment: unset it "
            f"(env -u PYTHONPATH scopt ...); {type(error).__name__}: {error}"
        )
    libraries = os.environ.get("LD_LIBRARY_PATH", "")
    if libraries and isinstance(error, ImportError) and ".so" in str(error):
        return (
            f"a library of scopt does not load, perhaps for one of LD_LIBRARY_PATH {libraries}: unset it "
            f"(env -u LD_LIBRARY_PATH scopt ...); {type(error).__name__}: {error}"
        )
    return None


def _find_shadowing() -> Iterator[tuple[str, str]]:
    """Yield the libraries that a folder of PYTHONPATH outside this environment provides, and the folder."""
    own = Path(sys.prefix).resolve()
    folders = [folder for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder]
    for name in LIBRARIES:
        origin = _locate(name)
        if origin is None or own in origin.parents:
            continue
        for folder in folders:
            if Path(folder).resolve() in origin.parents:
                yield name, folder
                break


def _locate(name: str) -> Path | None:
    try:
        found = importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return None
    places = [] if found is None else [found.origin, *(found.submodule_search_locations or ())]
    return next((Path(place).resolve() for place in places if place), None)
