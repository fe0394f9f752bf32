"""setuptools, which asks for a compiler from the package registry where the system has none."""

import runpy
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

_KERNEL = runpy.run_path(str(Path(__file__).resolve().parents[1] / "costs" / "native" / "build.py"))


def _list_compilers() -> list[str]:
    return [] if _KERNEL["has_compiler"]() else [_KERNEL["ZIG"]]


def get_requires_for_build_wheel(config_settings=None):  # type: ignore[no-untyped-def]
    """Return what building a wheel takes."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *_list_compilers()]


def get_requires_for_build_editable(config_settings=None):  # type: ignore[no-untyped-def]
    """Return what an installation in place takes."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *_list_compilers()]
