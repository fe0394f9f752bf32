"""Libraries that PYTHONPATH puts before scopt's own are named, not reported as defects."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.cli.foreign import explain_foreign_libraries

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("library", ["numpy", "pinocchio"])
def test_a_library_from_a_ros_shell_is_named_with_its_folder(tmp_path: Path, library: str) -> None:
    package = tmp_path / "opt" / library
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('made for another Python')\n")
    path = os.pathsep.join([str(package.parent), str(ROOT)])
    program = "from service.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "robots"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        cwd=tmp_path,
        timeout=120,
        check=False,
    )
    assert done.returncode == 70
    assert f"{library} comes from PYTHONPATH {package.parent} instead of scopt's own environment" in done.stderr
    assert "Traceback" not in done.stderr
    assert "report it" not in done.stderr


def test_a_library_that_does_not_load_blames_the_linker_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/ros/lib")
    error = ImportError("libpinocchio.so: undefined symbol: x")
    assert "LD_LIBRARY_PATH /opt/ros/lib" in str(explain_foreign_libraries(error))
    assert explain_foreign_libraries(ZeroDivisionError("x.so")) is None
    monkeypatch.delenv("LD_LIBRARY_PATH")
    assert explain_foreign_libraries(error) is None
