"""Builds the library from its sources: at installation, or ``python costs/native/build.py`` after a change of them.

It runs before anything else is installed, and imports nothing of the project.  The library calls nothing of Python, so
that one serves all its versions, and is built by the system's compiler or by that of the package ``ziglang``.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = (
    "costs/native/distance.c",
    "costs/native/many.c",
    "service/verify/clearance/bounds.c",
    "service/verify/coverage/surfaces.c",
)
HEADERS = ("costs/native/distance.h",)
LIBRARY = "costs/native/kernel.so"
ZIG = "ziglang==0.13.0"
# Results are the same from every compiler: no operation is fused or reordered.
_OPTIONS = ("-O3", "-fPIC", "-shared", "-ffp-contract=off", "-fvisibility=hidden")
_TRIAL = "#include <math.h>\n#include <string.h>\ndouble trial(double x) { return sqrt(x); }\n"


def find_digest(root: Path = ROOT) -> str:
    """Return a digest of the sources; the library tells that of its own."""
    return hashlib.sha256(b"\0".join((root / name).read_bytes() for name in (*SOURCES, *HEADERS))).hexdigest()[:16]


def has_compiler() -> bool:
    """Return whether the system has a C compiler with a library of C."""
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "trial.c"
        trial.write_text(_TRIAL)
        return any(_run(command, [trial], Path(folder) / "trial.so", ()) == "" for command in _list_system_compilers())


def build(target: Path, root: Path = ROOT) -> str:
    """Write the library to ``target``; return why there is none, or an empty text."""
    target.parent.mkdir(parents=True, exist_ok=True)
    made = target.with_suffix(f".{os.getpid()}.part")  # a process that has the old one loaded keeps it
    reason = "there is no C compiler, and the package ziglang is not installed"
    for command in (*_list_system_compilers(), *_list_zig()):
        reason = _run(command, [root / name for name in SOURCES], made, (f'-DSCOPT_DIGEST="{find_digest(root)}"',))
        if not reason:
            made.replace(target)
            break
    return reason


def _list_system_compilers() -> Iterator[list[str]]:
    for name in ("cc", "gcc", "clang"):
        found = shutil.which(name)
        if found:
            yield [found]


def _list_zig() -> Iterator[list[str]]:
    target = ["-target", f"{platform.machine()}-linux-gnu.2.17"] if sys.platform == "linux" else []
    if subprocess.run([sys.executable, "-m", "ziglang", "version"], capture_output=True, check=False).returncode == 0:
        yield [sys.executable, "-m", "ziglang", "cc", *target]


def _run(command: Sequence[str], sources: Sequence[Path], target: Path, options: Sequence[str]) -> str:
    """Compile; return the compiler's complaint, or an empty text."""
    try:
        done = subprocess.run(
            [*command, *_OPTIONS, *options, "-o", str(target), *map(str, sources), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError as error:
        return str(error)
    return "" if done.returncode == 0 else done.stderr.strip() or f"{command[0]} ended with {done.returncode}"


if __name__ == "__main__":
    sys.exit(build(ROOT / LIBRARY) or None)
