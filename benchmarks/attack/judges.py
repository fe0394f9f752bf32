"""The public faces that are lied to: ``scopt verify``, ``scopt plan`` and the stranger's program."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.attack.outcome import Answer
from service.errors import RequestError, ResultError
from service.replay import verify_result

CERTIFIED = "CERTIFIED"
STRANGER = Path(__file__).resolve().parents[2] / "examples" / "check_certificate.py"
STRANGER_TIME_S = 300.0


def verify(folder: Path, **seen: Path) -> tuple[Answer, str]:
    """What ``scopt verify`` says of an edited folder; ``seen`` are the user's own request and cloud."""
    missing = [name for name in seen if name not in inspect.signature(verify_result).parameters]
    if missing:
        return Answer.BELIEVED, f"scopt verify takes no {', '.join(missing)} to compare with"
    try:
        summary: dict[str, Any] = verify_result(folder, **seen)
    except (ResultError, RequestError) as error:
        return Answer.REFUSED, _first_line(error, folder)
    if summary["verdict"] == CERTIFIED:
        return Answer.BELIEVED, CERTIFIED
    reasons = summary.get("explanation") or ["no reason given"]
    return Answer.REPORTED, f"{summary['verdict']}: {reasons[0]}"


def ask_stranger(folder: Path) -> tuple[Answer, str]:
    """What ``examples/check_certificate.py`` says of an edited folder."""
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
    """The same answer to an edit that changes nothing that matters."""
    if answer is Answer.CRASHED:
        return answer, text
    return (Answer.TRUE, text) if answer is Answer.BELIEVED and text == CERTIFIED else (Answer.ALARM, text)


def _first_line(error: Exception, folder: Path) -> str:
    return str(error).splitlines()[0].replace(f"{folder}/", "").replace(f"{folder}: ", "")
