"""The house itself: which code runs, what ``--help`` costs, what ships."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from source_imports import list_import_statements

ROOT = Path(__file__).parents[2]
PACKAGES = ("scopt", "costs", "perception", "service")


@pytest.mark.parametrize("name", PACKAGES)
def test_package_resolves_to_this_checkout(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__file__ is not None
    assert Path(module.__file__).resolve().parent == ROOT / name


def test_help_loads_no_heavy_library() -> None:
    program = (
        "import sys\n"
        "sys.argv = ['scopt', '--help']\n"
        "from service.cli.app import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'open3d', 'cvxpy', 'matplotlib', 'scipy', 'pinocchio', 'coal', 'numpy', 'pydantic', 'yaml'}\n"
        "heavy |= {'markdown_it'}\n"
        "print('LOADED', sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "LOADED []" in done.stdout
    assert "plan" in done.stdout


@pytest.mark.parametrize("package", ["costs", "service"])
def test_every_public_name_is_listed_and_can_be_imported(package: str) -> None:
    module = importlib.import_module(package)
    assert dir(module) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = module.nonsense


def test_every_dependency_is_pinned_by_a_plain_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9._]+", line) for line in lines)
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines}
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.split(r"[\[<>=;! ]", entry)[0].lower().replace("_", "-") for entry in wanted}
    names -= {"open3d"}  # the wheel for other platforms than Linux on x86-64
    assert names <= pinned


def test_the_program_in_the_readme_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert len(blocks) == 1
    assert len(blocks[0].splitlines()) <= 15
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", blocks[0]], capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
    )
    assert done.returncode == 0, done.stderr
    assert "CERTIFIED" in done.stdout.splitlines()
    assert (tmp_path / "out" / "reach" / "viewer.html").is_file()


def test_licence_is_apache_2_of_the_scopt_authors() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "scopt authors" in text


def test_page_and_models_are_package_data() -> None:
    for path in ("costs/robot/atlas/atlas.urdf", "service/viewer/page/dist/viewer.js"):
        assert (ROOT / path).is_file()


IMPORTED_AS = {
    "grpcio": "grpc",
    "grpcio-health-checking": "grpc_health",
    "grpcio-reflection": "grpc_reflection",
    "grpcio-status": "grpc_status",
    "grpcio-tools": "grpc_tools",
    "open3d-cpu": "open3d",
    "opentelemetry-sdk": "opentelemetry",
    "pillow": "PIL",
    "pin": "pinocchio",
    "prometheus-client": "prometheus_client",
    "protobuf": "google",
    "pyyaml": "yaml",
}


def test_every_imported_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [entry for name, entries in project["optional-dependencies"].items() if name != "dev" for entry in entries]
    names = {re.split(r"[\[<>=;! ]", entry)[0].lower() for entry in (*project["dependencies"], *extras)}
    declared = {IMPORTED_AS.get(name, name) for name in names}
    imported = {module for package in PACKAGES for path in (ROOT / package).rglob("*.py") for module in _imports(path)}
    imported -= {*sys.stdlib_module_names, *PACKAGES, "pydantic_core"}  # pydantic_core comes with pydantic
    assert imported - declared == set()


def test_every_library_of_tests_and_examples_is_declared_for_developers() -> None:
    # What another package happens to bring today is gone when that package goes.
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    entries = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.split(r"[\[<>=;! ]", entry)[0].lower() for entry in entries}
    declared = {IMPORTED_AS.get(name, name) for name in names}
    paths = [path for folder in ("tests", "examples", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    imported = {module for path in paths for module in _imports(path)} - {path.stem for path in paths}
    imported -= {*sys.stdlib_module_names, *PACKAGES, "benchmarks", "click", "pydantic_core"}  # click comes with typer
    assert imported - declared == set()


def _imports(path: Path) -> set[str]:
    found = set()
    for node in list_import_statements(path):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found
