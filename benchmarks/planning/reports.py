"""Small requests made after public reports of other planners' users: whether each gets its right answer.

``python -m benchmarks.planning.reports [NAME ...] [--folder FOLDER]``

The requests are files of ``cases/reports`` beside the folder ``SCOPT_DATA``.  ``RIGHT`` has the right answer of each: a
verdict, a word of a refusal or of the reason, and the longest turn of one joint where a detour would be wrong.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.planning.starts import ROOT
from benchmarks.tables import print_table
from scopt import EffortClock
from service.errors import RequestError
from service.planner import plan
from service.request.file import load_request
from service.result.result import Verdict

COLUMNS = ("request", "asks", "answer", "right", "CPU [s]", "clearance [mm]", "largest turn [rad]", "reason")


@dataclass(frozen=True)
class Right:
    """The right answer of a request.

    Attributes:
        about: what the report is about.
        words: one of them is in the refusal or reason; none for a request that has a motion.
        most_turn: largest displacement of a joint along the motion [rad]; None where it does not matter.
    """

    about: str
    words: tuple[str, ...] = ()
    most_turn: float | None = None


RIGHT = {
    "c01_wrap": Right("circular joints", most_turn=0.3),
    "c02_turns": Right("circular joints", most_turn=0.31),
    "c02b_turns100": Right("circular joints", most_turn=0.4),
    "c03_wrap_pose": Right("circular joints"),
    "c04_planar_yaw": Right("circular joints", most_turn=0.51),
    "c05_bounds": Right("start at a limit"),
    "c05b_bounds": Right("start beyond a limit", ("outside the joint's limits",)),
    "c06_still": Right("goal at the start"),
    "c07_5dof": Right("orientation tolerance"),
    "c07_t110": Right("orientation tolerance"),
    "c07_t114": Right("orientation tolerance"),
    "c07_t115": Right("orientation tolerance"),
    "c07_t120": Right("orientation tolerance"),
    "c07_t150": Right("orientation tolerance"),
    "c07_t179": Right("orientation tolerance"),
    "c07b_5dof90": Right("orientation tolerance"),
    "c07c_5dof5": Right("orientation tolerance", ("rotation", "orientation", "within", "cannot")),
    "c07d_5dof180": Right("orientation tolerance"),
    "c08_quat": Right("quaternion not of length 1"),
    "c08b_quatneg": Right("quaternion of the other sign"),
    "c09_rot55": Right("orientation tolerance"),
    "c10_soft": Right("soft limits", ("outside the joint's limits",)),
    "c11_dupes": Right("mesh with repeated vertices"),
    "c11_ground": Right("flat mesh"),
    "c11_insideout": Right("mesh inside out"),
    "c11_openbox": Right("open mesh"),
    "c11_sheet": Right("flat mesh"),
    "c12_windowsheet": Right("wall with a window"),
    "c12_windowthick": Right("wall with a window"),
    "c13_octo": Right("voxels"),
    "c14_lift": Right("touch at the start"),
    "c14_lift_esc": Right("touch at the start"),
    "c14b_lift": Right("touch at the start"),
    "c14b_lift_esc": Right("touch at the start"),
    "c14c_lift": Right("touch at the start"),
    "c15_scale_0.01": Right("speed scale"),
    "c15_scale_0.1": Right("speed scale"),
    "c15_scale_0.5": Right("speed scale"),
    "c15_scale_1.0": Right("speed scale"),
    "c16_load0": Right("payload"),
    "c16_load10": Right("payload"),
    "c16_load25": Right("payload", ("r_arm_wrx",)),
    "c16_load60": Right("payload", ("r_arm",)),
    "c16_load100": Right("payload", ("r_arm",)),
    "c16_load140": Right("payload", ("r_arm",)),
    "c16b_load25_long": Right("payload", ("r_arm_wrx",)),
    "c17_far": Right("far from the origin"),
    "c17_near": Right("far from the origin"),
    "c18_srv": Right("first request"),
    "c19_peg_between_jaws": Right("concave link", ("robot.decompose",)),
    "c20_cup": Right("goal outside what is kept", ("the goal does not keep",)),
    "c20b_cup_short": Right("upright cup"),
    "c20c_cup_short20": Right("upright cup"),
    "c21_line": Right("orientation kept"),
    "c22_onefoot": Right("one foot"),
    "c23_ramp": Right("feet on a slope"),
    "c23_ramp_gap": Right("feet on a slope"),
    "c23b_ramp": Right("feet on a slope"),
    "c23b_ramp_gap": Right("feet on a slope"),
    "c23c_flatbox": Right("feet on a box"),
    "c23d_ramp_contacts": Right("a stance without its base", ("posture.base",)),
    "c23e_slope_scan": Right("feet on a slope"),
    "c23f_onbox": Right("feet on a box"),
    "c23g_floor02": Right("feet on a floor"),
    "c25_padding": Right("margin as an aim"),
    "c26_many": Right("many waypoints"),
}


def judge(path: Path) -> tuple[str, ...]:
    """Plan a request and compare the answer with the right one; return the row of the table."""
    right = RIGHT.get(path.stem, Right(""))
    began, clearance, turn, reasons = time.process_time(), "", "", list[str]()
    try:
        result = plan(load_request(path), clock=EffortClock())
    except RequestError as error:
        answer, reasons = "refused", list(error.problems)
        is_right = bool(right.words)
    else:
        answer, reasons = result.verdict.value, list(result.explanation)
        is_right = (result.verdict is Verdict.CERTIFIED) != bool(right.words)
        if result.motion is not None:
            largest = float(np.abs(result.positions - result.positions[0]).max())
            turn = f"{largest:.2f}"
            is_right = is_right and (right.most_turn is None or largest <= right.most_turn)
        if result.certificate is not None:
            clearance = f"{1e3 * result.certificate.min_clearance_m:.1f}"
    if right.words:
        is_right = is_right and any(word in reason for word in right.words for reason in reasons)
    spent = time.process_time() - began
    shown = reasons[0] if reasons else ""
    return (path.stem, right.about, answer, "yes" if is_right else "NO", f"{spent:.2f}", clearance, turn, shown)


def main() -> None:
    """Print an answer per request."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("names", nargs="*", help="requests by the beginnings of their names; default: all")
    parser.add_argument("--folder", type=Path, help="folder of the requests")
    chosen = parser.parse_args()
    data = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data"))
    folder = chosen.folder or data.parent / "cases" / "reports"
    names = tuple(chosen.names)
    rows = []
    for path in sorted(folder.glob("*.yaml")):
        if path.stem in RIGHT and (not names or path.stem.startswith(names)):
            rows.append(judge(path))
            print("\t".join(rows[-1]), flush=True)
    right = sum(row[3] == "yes" for row in rows)
    print_table(f"{right} of {len(rows)} right", COLUMNS[:-1], [row[:-1] for row in rows])


if __name__ == "__main__":
    main()
