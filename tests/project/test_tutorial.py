"""The tutorial is run from top to bottom in an empty folder: its files, commands and programs, and what they print.

A fenced block with a title is written to a file of that name. The lines of a ``shell`` block are commands. A ``text``
block is a part of what the commands before it printed; ``...`` stands for anything.
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = ("tutorial.md", "tasks.md")
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', flags=re.MULTILINE | re.DOTALL)
MAY_FAIL = " || true"


def run(command: str) -> str:
    """Run one line of a shell block in this process; everything that it prints."""
    program, *arguments = shlex.split(command.removesuffix(MAY_FAIL))
    if program == "python":
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            runpy.run_path(arguments[0])
        return printed.getvalue()
    assert program == "scopt", command
    outcome = CliRunner().invoke(app, arguments)
    assert (outcome.exit_code != 0) is command.endswith(MAY_FAIL), f"{command}: {outcome.exit_code}\n{outcome.output}"
    return outcome.output


def squeeze(text: str) -> str:
    """Text with single blanks, so that wrapping does not matter."""
    return " ".join(text.split())


@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_does_what_it_says(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    printed = ""
    n_checked = 0
    for kind, title, content in BLOCK.findall((ROOT / "docs" / page).read_text()):
        if title:
            Path(title).parent.mkdir(exist_ok=True)
            Path(title).write_text(content)
        elif kind == "shell":
            printed = "".join(run(line) for line in content.splitlines())
        elif kind == "text":
            pattern = ".*".join(map(re.escape, squeeze(content).split("...")))
            assert re.search(pattern, squeeze(printed)), f"{content}\n{printed}"
            n_checked += 1
        else:
            raise AssertionError(f"{page}: nothing is done with a block of {kind}")
    assert n_checked >= 5
