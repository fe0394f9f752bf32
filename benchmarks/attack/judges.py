"""Programs under attack: ``scopt verify``, ``scopt plan`` and the independent checker."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from benchmarks.attack.outcome import Answer
from service.cli.app import app
from service.errors import RequestError, ResultError
from service.replay.replay import verify_result

CERTIFIED = "CERTIFIED"
USAGE, INTERNAL = 2, 70  # exit codes
STRANGER = Path(__file__).resolve().parents[2] / "examples" / "check_certificate.py"
STRANGER_TIME_S = 300.0


def verify(folder: Path, **seen: Path) -> tuple[Answer, str]:
    """Run ``scopt verify`` on an edited folder; ``seen`` holds the user's own ``request`` and ``cloud``."""
    if seen:
        return _ask_command(folder, seen)
    try:
        summary: dict[str, Any] = verify_result(folder)
    except (ResultError, RequestError) as error:
        return Answer.REFUSED, _first_line(error, folder)
    if summary["verdict"] == CERTIFIED:
        held_to = str(summary.get("held_to") or "")
        answer = Answer.REPORTED if ", without " in held_to else Answer.BELIEVED  # what is not held to is named
        return answer, f"{CERTIFIED} {held_to}".strip()
    reasons = summary.get("explanation") or ["no reason given"]
    return Answer.REPORTED, f"{summary['verdict']}: {reasons[0]}"


def _ask_command(folder: Path, seen: Mapping[str, Path]) -> tuple[Answer, str]:
    options = [text for name, path in seen.items() for text in (f"--{name}", str(path))]
    done = CliRunner().invoke(app, ["verify", str(folder), *options, "--json"])
    said = " ".join(done.output.partition(" % verify")[2].split())
    if done.exit_code == USAGE:
        return Answer.BELIEVED, f"scopt verify takes no {' or '.join(seen)} to compare with"
    if done.exit_code == INTERNAL or not isinstance(done.exception, SystemExit | None):
        return Answer.CRASHED, said[:300]
    if done.exit_code == 0:
        return Answer.BELIEVED, CERTIFIED
    return (Answer.REPORTED if '"verdict"' in said else Answer.REFUSED), said[:300]


def ask_stranger(folder: Path) -> tuple[Answer, str]:
    """Run ``examples/check_certificate.py`` on an edited folder."""
    done = subprocess.run(
        [sys.executable, str(STRANGER), str(folder)],
        capture_output=True,
        text=True,
        timeout=STRANGER_TIME_S,
        check=False,
    )
    if done.returncode == 0:
        return Answer.BELIEVED, "the stranger finds nothing wrong"
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    if failed:
        return Answer.REPORTED, failed[0]
    last = (done.stderr.strip().splitlines() or ["no word"])[-1]
    if "Traceback" in done.stderr or done.returncode < 0:
        return Answer.CRASHED, f"exit code {done.returncode}: {last}"
    return Answer.REFUSED, last


def harmless(answer: Answer, text: str) -> tuple[Answer, str]:
    """Return the answer for an edit that must not change the verdict."""
    if answer is Answer.CRASHED:
        return answer, text
    return (Answer.TRUE, text) if answer is Answer.BELIEVED and text.startswith(CERTIFIED) else (Answer.ALARM, text)


def _first_line(error: Exception, folder: Path) -> str:
    return str(error).splitlines()[0].replace(f"{folder}/", "").replace(f"{folder}: ", "")
