"""Contents of the two distributions: scopt, and scopt-client without the planner."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "client_package.py"

PACKAGES = ("scopt", "costs", "perception", "service")
# Of the viewer's page its built files are needed alone, of the schema the .proto files.
SOURCES_ONLY = ("service/viewer/page/", "service/proto/buf.yaml", "service/proto/accepted.binpb")
LIGHT = {
    "annotated_types",
    "google",
    "grpc",
    "pydantic",
    "pydantic_core",
    "typing_extensions",
    "typing_inspection",
    "yaml",
}
OURS = {"costs", "service"}
BY_GRPC = {"grpc_health", "grpc_reflection", "grpc_status", "grpc_tools"}  # which it imports where they are installed


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    """The module ``tools/client_package.py``."""
    spec = importlib.util.spec_from_file_location("client_package", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _tracked() -> list[str]:
    done = subprocess.run(["git", "ls-files", *PACKAGES], capture_output=True, text=True, cwd=ROOT)
    if done.returncode:
        pytest.skip("no git checkout")
    return done.stdout.split()


def test_the_wheel_has_every_file_of_the_packages() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert settings["packages"]["find"]["include"] == [f"{package}*" for package in PACKAGES]
    patterns = ("*.py", *settings["package-data"]["*"])
    folders = {path.parent for package in PACKAGES for path in (ROOT / package).rglob("*")}  # namespaces are packages
    files = (path for folder in folders for pattern in patterns for path in folder.glob(pattern))
    packed = {str(path.relative_to(ROOT)) for path in files}
    needed = {path for path in _tracked() if not path.startswith(SOURCES_ONLY) or "/page/dist/" in path}
    assert {path for path in needed - packed if not path.endswith(".sha256")} == set()
    assert {f"{package}/py.typed" for package in PACKAGES} <= packed


def test_the_client_is_imported_without_planner_and_large_libraries(tool: ModuleType, tmp_path: Path) -> None:
    tool.assemble(tmp_path / "client")
    versions = [
        tomllib.loads((folder / "pyproject.toml").read_text())["project"]["version"]
        for folder in (ROOT, tmp_path / "client")
    ]
    assert versions[0] == versions[1]
    program = (
        "import sys\n"
        f"sys.path.insert(0, {str(tmp_path / 'client')!r})\n"
        "before = set(sys.modules)\n"
        "import service.client\n"
        "from service import parse_request\n"
        "request = parse_request({'robot': {'name': 'atlas'}, 'goal': {'joints': {'l_arm_elx': 1.2}}})\n"
        "from service.client.messages import request_to_message\n"
        "request_to_message(request)\n"
        "service.client.PlannerClient('localhost:1').close()\n"
        "loaded = {name.partition('.')[0] for name in set(sys.modules) - before}\n"
        "print(*sorted(name for name in loaded if name not in sys.stdlib_module_names and name[0] != '_'))\n"
        "print(service.client.__file__)\n"
        "try:\n"
        "    from service import plan\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    loaded, place, refusal = done.stdout.splitlines()
    assert set(loaded.split()) - {"cython_runtime"} <= LIGHT | OURS | BY_GRPC
    assert place.startswith(str(tmp_path))
    assert refusal == "service.plan is not part of scopt-client; pip install scopt has it"


def test_the_client_has_few_modules_and_each_of_its_own(tool: ModuleType) -> None:
    names = [str(path) for path in tool.list_modules()]
    assert {"service/client/blocking.py", "service/request/file.py", "costs/names.py"} <= set(names)
    assert not [name for name in names if name.startswith(("scopt/", "perception/", "service/server/"))]
    assert len(names) < 90
