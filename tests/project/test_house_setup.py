"""The set-up script on machines that lack something, simulated with a PATH of our own."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("bash", "dirname", "tr", "cat", "rm", "env")


def _machine(folder: Path, **programs: str) -> Path:
    """A folder to be the whole PATH: the shell's tools and the given scripts."""
    folder.mkdir()
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found is not None
        (folder / tool).symlink_to(found)
    for name, script in programs.items():
        path = folder / name
        path.write_text(f"#!/bin/bash\n{script}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return folder


def _checkout(folder: Path) -> Path:
    (folder / "tools").mkdir(parents=True)
    script = (ROOT / "tools" / "setup.sh").read_text()
    # The real Python of this machine must not be found.
    (folder / "tools" / "setup.sh").write_text(script.replace("/usr/bin/", f"{folder}/distribution/"))
    return folder


def _setup(checkout: Path, path: Path) -> subprocess.CompletedProcess[str]:
    command = ["bash", str(checkout / "tools" / "setup.sh"), ".venv"]
    environment = {"PATH": str(path), "HOME": os.environ.get("HOME", "/")}
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=240)


ALL_LIBRARIES = "echo libgomp.so.1 libEGL.so.1 libusb-1.0.so.0 libGL.so.1"


def test_missing_system_packages_are_named_in_one_command(tmp_path: Path) -> None:
    python = "exit 0"  # a Python of a right version with venv
    path = _machine(tmp_path / "bin", ldconfig="echo libgomp.so.1 libEGL.so.1", **{"python3.11": python})
    done = _setup(_checkout(tmp_path / "checkout"), path)
    assert done.returncode == 1
    assert done.stderr.strip().endswith("sudo apt-get install -y libusb-1.0-0 libgl1")


def test_missing_python_is_a_missing_package(tmp_path: Path) -> None:
    path = _machine(tmp_path / "bin", ldconfig=ALL_LIBRARIES, python3="exit 1")
    done = _setup(_checkout(tmp_path / "checkout"), path)
    assert done.returncode == 1
    assert "sudo apt-get install -y python3 python3-venv" in done.stderr


def test_a_python_that_does_not_run_is_passed_over(tmp_path: Path) -> None:
    log = tmp_path / "log"
    works = f'echo "$0 $*" >>{log}; [[ $1 == -c ]] && exit 0; exit 7'
    path = _machine(tmp_path / "bin", ldconfig=ALL_LIBRARIES, **{"python3.11": "exit 127", "python3.12": works})
    done = _setup(_checkout(tmp_path / "checkout"), path)
    assert done.returncode == 7  # it went on to make the environment with python3.12
    assert "python3.12 -m venv .venv" in log.read_text()


def test_the_distributions_python_comes_before_those_of_the_path(tmp_path: Path) -> None:
    works = "[[ $1 == -c ]] && exit 0; exit {}"
    path = _machine(tmp_path / "bin", ldconfig=ALL_LIBRARIES, **{"python3.11": works.format(7)})
    checkout = _checkout(tmp_path / "checkout")
    _machine(checkout / "distribution", **{"python3.12": works.format(8)})
    assert _setup(checkout, path).returncode == 8


@pytest.mark.parametrize(("version", "fits"), [((3, 10), False), ((3, 11), True), ((3, 13), True), ((3, 14), False)])
def test_only_pythons_3_11_to_3_13_fit(tmp_path: Path, version: tuple[int, int], fits: bool) -> None:
    pretend = f"import sys; sys.version_info = {(*version, 0)}; exec(sys.argv[1])"
    python = f'[[ $1 == -c ]] && exec {sys.executable} -c "{pretend}" "$2"; exit 7'
    path = _machine(tmp_path / "bin", ldconfig=ALL_LIBRARIES, python3=python)
    done = _setup(_checkout(tmp_path / "checkout"), path)
    assert done.returncode == (7 if fits else 1), done.stderr


@pytest.mark.parametrize("name", ["setup", "demo", "test", "check", "bench", "clean"])
def test_make_knows_its_targets(name: str) -> None:
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    done = subprocess.run(["make", "-n", name], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
