"""Generate the Python code of the protocol buffers: ``python tools/generate_proto.py [FOLDER]``.

Needs the version of grpcio-tools that the ``dev`` extra pins: generated code refuses an older grpcio, so it is
made with the oldest one that is supported.
"""

from __future__ import annotations

import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from grpc_tools import protoc

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "service" / "proto"
PACKAGE = Path("planner", "v1")
MESSAGES = ("request", "result", "execution", "pose", "planner")


def generate(target: Path) -> list[Path]:
    """Write the generated files below ``target``, as they stand below ``service/proto``; their paths."""
    with tempfile.TemporaryDirectory() as scratch:
        _run(f"--python_out={scratch}", f"--pyi_out={scratch}", *(str(PACKAGE / f"{name}.proto") for name in MESSAGES))
        _run(f"--grpc_python_out={scratch}", str(PACKAGE / "planner.proto"))
        written = []
        for made in sorted((Path(scratch) / PACKAGE).iterdir()):
            # protoc imports by the path of the .proto file, which is below service/proto.
            text = made.read_text().replace("from planner.v1 import", "from service.proto.planner.v1 import")
            path = target / PACKAGE / made.name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            written.append(path)
        return written


def _run(*arguments: str) -> None:
    known = files("grpc_tools") / "_proto"
    code = protoc.main(["protoc", f"-I{SOURCES}", f"-I{known}", *arguments])
    if code != 0:
        raise SystemExit(code)


if __name__ == "__main__":
    for path in generate(Path(sys.argv[1]) if len(sys.argv) > 1 else SOURCES):
        print(path)
