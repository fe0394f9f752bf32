"""Robots of the package example-robot-data: which URDFs load and plan, in what time, and what line the others get.

    python -m benchmarks.planning.robots [--only WORD] [--folder FOLDER] [--srdf]

Every URDF is loaded in a process of its own as a file is that nobody edited: fixed base, no SRDF (``--srdf`` takes the
one beside it).  The motion is one joint by 0.1 rad or 0.02 m from the first start without a collision: all joints at 0
or at the nearest limit, the middle of the limits, then random ones.  Times are of the processor; the first load begins
with an empty cache, the second finds what the first left.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from costs.robot import RobotModel

TIME_LIMIT_S = 120.0  # wall time; a busy machine must not decide
N_STARTS = 12


def find_data_folder() -> Path | None:
    """Return the folder that holds the package ``example-robot-data``, or None without the extra ``robots``."""
    for entry in sys.path:
        folder = Path(entry) / "cmeel.prefix" / "share"
        if (folder / "example-robot-data").is_dir():
            return folder
    return None


def find_urdfs(folder: Path) -> list[Path]:
    """Return all URDF files below a folder."""
    return sorted(folder.rglob("*.urdf"))


def find_srdf(urdf: Path) -> Path | None:
    """Return the SRDF of the same name in the robot's ``srdf`` folder, or None."""
    found = urdf.parent.parent / "srdf" / f"{urdf.stem}.srdf"
    return found if found.is_file() else None


def row_has_no_start(robot: RobotModel) -> bool:
    """Return whether links overlap with all joints at 0 and in the middle of their limits."""
    from costs.scene import Scene
    from service.start.overlaps import find_overlaps

    middle = 0.5 * (np.maximum(robot.lower, -np.pi) + np.minimum(robot.upper, np.pi))
    starts = (np.clip(np.zeros(robot.n), robot.lower, robot.upper), middle)
    return all(find_overlaps(robot, q, Scene(()), ()) for q in starts)


def try_robot(urdf: Path, packages: Path, srdf: Path | None) -> dict[str, object]:
    """Load a robot and plan a small motion; return figures and the line of the first failure."""
    from service import RequestError, parse_request, plan
    from service.start.robot import load_requested_robot

    robot_data: dict[str, object] = {"urdf": str(urdf), "package_dirs": [str(packages)]}
    if srdf is not None:
        robot_data["srdf"] = str(srdf)
    row: dict[str, object] = {"urdf": urdf.name, "loads": False, "verdict": "", "line": "", "load_s": 0.0, "n": 0}
    started = time.process_time()
    try:
        request = parse_request({"robot": robot_data, "goal": {"joints": {"any": 0.0}}}, folder=urdf.parent)
        robot = load_requested_robot(request)
        loaded = time.process_time()
        load_requested_robot(request)
    except RequestError as error:
        row["line"] = str(error).splitlines()[0]
        return row
    loads = {"load_s": loaded - started, "again_s": time.process_time() - loaded}
    if srdf is None and row_has_no_start(robot):
        # As the refusal says: an SRDF that leaves out what overlaps at rest.
        from service.start.robot_report import check_robot

        with tempfile.TemporaryDirectory() as scratch:
            proposed = Path(scratch) / "proposed.srdf"
            proposed.write_text(check_robot(robot).srdf, encoding="utf-8")
            return {**try_robot(urdf, packages, proposed), **loads, "proposed": True}
    row.update(loads=True, **loads, n=robot.n, notes=list(getattr(robot, "notes", ())))
    starts = list_starts(robot)
    for index, q in enumerate(starts):
        data = make_request(robot, robot_data, q)
        started = time.process_time()
        try:
            result = plan(parse_request(data, folder=urdf.parent), robot=robot)
        except RequestError as error:
            row["line"] = row["line"] or str(error).splitlines()[0]
            if "robot.torque" not in str(error):
                continue
            # As the refusal says: what springs carry, or what the file states too low, is not checked.
            robot_data["torque"] = {"check": False}
            row["unchecked"] = True
            robot = load_requested_robot(parse_request(data, folder=urdf.parent))
            try:
                result = plan(parse_request(data, folder=urdf.parent), robot=robot)
            except RequestError:
                continue
        verdict = result.verdict.value
        if verdict in ("NOT_FOUND", "INFEASIBLE") and index + 1 < len(starts):
            row.update(line=row["line"] or " ".join(result.explanation), verdict=verdict)
            continue
        row.update(verdict=verdict, plan_s=time.process_time() - started, start=index)
        if verdict == "CERTIFIED":
            row["line"] = ""
        elif result.certificate is not None:
            row["line"] = "; ".join(result.explanation)[:300]
        else:
            row["line"] = row["line"] or " ".join(result.explanation)
        break
    return row


def list_starts(robot: RobotModel) -> list[np.ndarray]:
    """Return configurations to begin at: all joints at 0 or the nearest limit, the middles of limits, random ones."""
    rng = np.random.default_rng(0)
    starts = [np.clip(np.zeros(robot.n), robot.lower, robot.upper)]
    for reach in (1.0, np.pi):
        lower, upper = np.maximum(robot.lower, -reach), np.minimum(robot.upper, reach)
        lower, upper = np.minimum(lower, robot.upper), np.maximum(upper, robot.lower)
        starts += [0.5 * (lower + upper), *(rng.uniform(lower, upper) for _ in range(N_STARTS // 2))]
    return starts


def make_request(robot: RobotModel, robot_data: dict[str, object], q: np.ndarray) -> dict[str, object]:
    """Return the request that moves the joint with the widest limits by 0.1 rad or m, or half of its limits, from q."""
    column = int(np.argmax(np.minimum(robot.upper - robot.lower, 10.0)))
    step = min(0.1, 0.5 * float(robot.upper[column] - robot.lower[column]))
    value = float(q[column]) + (step if q[column] + step <= robot.upper[column] else -step)
    return {
        "robot": robot_data,
        "start": {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))},
        "goal": {"joints": {robot.joint_names[column]: value}},
        "options": {"time_limit_s": TIME_LIMIT_S},
    }


def main() -> None:
    """Print one line per robot and the sums."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--folder", type=Path, default=None, help="another folder with URDF files")
    parser.add_argument("--srdf", action="store_true", help="take the SRDF of the same name")
    parser.add_argument("--one", type=Path, default=None, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    packages = arguments.folder or find_data_folder()
    if packages is None:
        sys.exit("example-robot-data is not installed; pip install 'scopt[robots]'")
    if arguments.one is not None:
        found = find_srdf(arguments.one) if arguments.srdf else None
        print(json.dumps(try_robot(arguments.one, packages, found)))
        return
    rows = []
    cache = tempfile.TemporaryDirectory()
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "XDG_CACHE_HOME": cache.name}
    for urdf in find_urdfs(packages):
        if arguments.only not in str(urdf):
            continue
        words = [sys.executable, "-m", "benchmarks.planning.robots", "--folder", str(packages), "--one", str(urdf)]
        words += ["--srdf"] if arguments.srdf else []
        try:
            made = subprocess.run(words, capture_output=True, text=True, timeout=4 * TIME_LIMIT_S,
                                  env=environment, check=False)  # fmt: skip
            lines = made.stdout.splitlines()
            row = json.loads(lines[-1]) if lines else {"line": (made.stderr.splitlines() or ["crashed"])[-1]}
        except subprocess.TimeoutExpired:
            row = {"line": f"longer than {4 * TIME_LIMIT_S:g} s"}
        row["urdf"] = urdf.name
        mark = "with the SRDF that `scopt robots check` proposes; " if row.get("proposed") else ""
        mark += "with torque: {check: false}; " if row.get("unchecked") else ""
        row["line"] = mark + str(row.get("line", ""))
        rows.append(row)
        print(f"{urdf.stem:38} {row.get('n', 0):3} joints  load {row.get('load_s', 0.0):5.2f} s, "
              f"{row.get('again_s', 0.0):4.2f} s  "
              f"{row.get('verdict', '') or '-':20} {row.get('plan_s', 0.0):6.2f} s  {str(row.get('line', ''))[:300]}",
              flush=True)  # fmt: skip
    cache.cleanup()
    loaded = sum(bool(row.get("loads")) for row in rows)
    certified = sum(row.get("verdict") == "CERTIFIED" for row in rows)
    planned = certified + sum(row.get("verdict") == "FEASIBLE_AT_SAMPLES" for row in rows)
    print(f"{len(rows)} URDFs: {loaded} load, {planned} plan a motion, {certified} of these are certified")


if __name__ == "__main__":
    main()
