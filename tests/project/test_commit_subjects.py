"""The hook that reads the subject of a commit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

HOOK = Path(__file__).parents[2] / "tools" / "commit-msg"


@pytest.mark.parametrize(
    ("text", "code"),
    [("a" * 72, 0), ("a" * 73, 1), ("ü" * 72 + "\n\nreason " + "b" * 90, 0), ("Name it\nreason", 1), ("Name it\n", 0)],
)
def test_a_subject_has_at_most_72_characters_and_an_empty_line_after_it(tmp_path: Path, text: str, code: int) -> None:
    message = tmp_path / "message"
    message.write_text(text, encoding="utf-8")
    done = subprocess.run([HOOK, message], capture_output=True, text=True, env={"LC_ALL": "C.UTF-8"}, check=False)
    assert done.returncode == code, done.stderr
