"""Completion of commands and options by shells."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from service.cli.app import app


def _ask(**variables: str) -> str:
    return CliRunner().invoke(app, [], prog_name="scopt", env=variables).output


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands_and_options(shell: str) -> None:
    def complete(words: str) -> str:
        return _ask(
            _SCOPT_COMPLETE=f"complete_{shell}",
            COMP_WORDS=words,
            COMP_CWORD=str(len(words.split()) - 1),
            _TYPER_COMPLETE_ARGS=words,
            _TYPER_COMPLETE_FISH_ACTION="get-args",
        )

    assert f"complete_{shell}" in _ask(_SCOPT_COMPLETE=f"source_{shell}")
    assert "certify" in complete("scopt cert")
    assert "plan" not in complete("scopt cert").split()
    assert "--config" in complete("scopt serve --conf")
