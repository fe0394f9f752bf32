"""Record result folders, and a server's store with a review, of an earlier release; README.md says how to run it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from service.client import PlannerClient

try:
    from service.request.file import parse_request
except ImportError:  # before 0.3.0
    from service.request_file import parse_request

HERE = Path(__file__).parent
SCOPT = [sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())"]
POST = {"name": "post", "type": "cylinder", "radius": 0.03, "height": 0.4, "position": [0.75, 0.0, 0.0]}
REACH: dict[str, Any] = {
    "start": {"joints": {"a": 0.9, "b": 0.2, "c": 0.0}},
    "scene": {"obstacles": [POST]},
    "goal": {"poses": [{"link": "hand", "position": [0.55, -0.5, 0.0], "position_tolerance_m": 0.005}]},
}
VALVE = {"centre": [0.68, 0.12, 1.1], "axis": [-1, 0, 0], "radius": 0.14, "turn_deg": 30}
TURN = {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, "task": {"valve": VALVE}}
CUPBOARD = """<robot name="cupboard">
  <link name="cupboard">
    <collision><origin xyz="0.27 0 0.425"/><geometry><box size="0.5 0.5 0.85"/></geometry></collision>
    <collision><origin xyz="0.27 0 1.1"/><geometry><box size="0.5 0.5 0.1"/></geometry></collision></link>
  <link name="drawer"><collision><geometry><box size="0.02 0.46 0.16"/></geometry></collision></link>
  <link name="handle"><collision><origin rpy="1.5707963 0 0" xyz="0 0 0"/>
    <geometry><cylinder radius="0.008" length="0.2"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="cupboard"/><child link="drawer"/><origin xyz="0 0 0.95"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.4" velocity="0.5" effort="100"/></joint>
  <joint name="screws" type="fixed"><parent link="drawer"/><child link="handle"/><origin xyz="-0.06 0 0"/></joint>
</robot>"""
PULL = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "task": {
        "mechanism": {
            "urdf": CUPBOARD,
            "position": [0.75, -0.25, 0.0],
            "handle": {"link": "handle", "place": [0.018, 0.0, 0.01], "axis": [0, 0, -1]},
            "moves": [{"joint": "slide", "to": 0.1}],
            "joints": {"slide": {"friction": 30.0}},
        }
    },
}


def record_result(request: dict[str, Any], archive: Path, kept: tuple[str, ...], scratch: Path) -> None:
    """Plan a request by the command line, and keep some files of its folder."""
    asked, folder = scratch / "request.json", scratch / archive.name.partition(".")[0]
    asked.write_text(json.dumps(request))
    subprocess.run([*SCOPT, "plan", str(asked), "--out", str(folder)], check=True)
    pack(archive, folder, kept)


def pack(archive: Path, folder: Path, names: tuple[str, ...]) -> None:
    """Write files and folders of a folder into a compressed archive."""
    with tarfile.open(archive, "w:xz", preset=9) as tar:
        for name in names:
            tar.add(folder / name, name)


def record_store(archive: Path, scratch: Path, options: list[str]) -> None:
    """Ask a server for one plan without files and, of the arm, one with files, which is accepted; pack its store."""
    data, robots, socket = scratch / "data", scratch / "robots", scratch / "s"
    (robots / "arm").mkdir(parents=True)
    (robots / "arm" / "robot.urdf").write_text((HERE / "arm.urdf").read_text())
    listen = ["--listen", f"unix:{socket}", "--data", str(data), "--robots", str(robots), "--workers", "1"]
    server = subprocess.Popen([*SCOPT, "serve", *listen, *options], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        print(server.stdout.readline())
        with PlannerClient(f"unix:{socket}") as client:
            reach = {"robot": {"name": "arm"}, **REACH}
            client.plan(parse_request(reach), request_id="plain")
            plan = client.plan(parse_request(reach), request_id="accepted", out=scratch / "seen")
            client.review(client.get_plan(plan.plan_id).record, accept=True, comment="seen from all sides")
    finally:
        server.terminate()
        server.wait()
    names = tuple(sorted(str(path.relative_to(data)) for path in data.rglob("*") if path.is_file()))
    pack(archive, data, tuple(name for name in names if not name.endswith("lock")))


def main() -> None:
    """Write the archives into the folder that is named; further arguments are options of the server."""
    folder = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        os.chdir(scratch)
        (scratch / "arm.urdf").write_text((HERE / "arm.urdf").read_text())
        reach = {"robot": {"urdf": "arm.urdf"}, **REACH}
        record_result(reach, folder / "reach.tar.xz", ("result.json", "trajectory.csv", "robot"), scratch)
        if folder.name == "0.2.0":
            record_result(TURN, folder / "valve.tar.xz", ("result.json", "robot"), scratch)
        else:
            record_result(PULL, folder / "drawer.tar.xz", ("result.json", "robot"), scratch)
        record_store(folder / "store.tar.xz", scratch, sys.argv[2:])


if __name__ == "__main__":
    main()
