"""``scopt serve --config``: options by name from a TOML file; the command line takes precedence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import service.server.launch
from service.cli.app import app
from service.cli.server.config import list_options, read_config
from service.cli.server.serve import serve_command
from service.errors import RequestError
from service.server.launch import ServeOptions


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[ServeOptions]:
    """Options with which servers would have been started."""
    calls: list[ServeOptions] = []

    async def launch(options: ServeOptions, on_ready: Any) -> None:
        calls.append(options)

    monkeypatch.setattr(service.server.launch, "launch", launch)
    return calls


def _write(folder: Path, text: str) -> Path:
    path = folder / "server.toml"
    path.write_text(text)
    return path


def test_every_option_of_the_command_can_be_in_the_file() -> None:
    names = set(list_options(serve_command))
    program = CliRunner().invoke(app, ["serve", "--help"], env={"COLUMNS": "200", "TERMINAL_WIDTH": "200"}).output
    listed = {word.removeprefix("--").rstrip(",") for word in program.split() if word.startswith("--")}
    assert names == {name.removeprefix("no-") for name in listed} - {"help", "config"}
    assert {"listen", "tls-cert", "requests-per-s", "remote-metrics"} <= names


def test_values_of_the_file_are_used_and_the_command_line_takes_precedence(
    tmp_path: Path, started: list[ServeOptions]
) -> None:
    path = _write(
        tmp_path,
        'workers = 3\nqueue = 7\ndrain = 5\nallow = ["scans", "/srv/robots"]\nlisten = "127.0.0.1:6000"\n'
        'budget = ["egress=200"]\ntokens = "tokens.yaml"\nremote-metrics = true\n',
    )
    outcome = CliRunner().invoke(app, ["serve", "--queue", "2", "--config", str(path), "--allow", "/mnt"])
    assert outcome.exit_code == 0, outcome.output
    (options,) = started
    assert options.listen == "127.0.0.1:6000"
    assert options.settings["workers"] == 3
    assert options.settings["queue"] == 2
    assert options.settings["drain_s"] == 5.0
    assert options.settings["allowed"] == (Path("/mnt"),)
    assert options.tokens == tmp_path / "tokens.yaml"
    assert options.budgets == ("egress=200",)
    assert options.is_metrics_remote
    assert options.sign_key is None


def test_paths_start_at_the_folder_of_the_file(tmp_path: Path) -> None:
    path = _write(tmp_path, 'allow = ["scans", "/srv/robots"]\nrobots = "more"\n')
    values = read_config(path, list_options(serve_command))
    assert values == {"allow": [str(tmp_path / "scans"), "/srv/robots"], "robots": str(tmp_path / "more")}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("worker = 1", "unknown key 'worker'; expected workers"),
        ("tls_cert = 'x'", "unknown key 'tls_cert'; expected tls-cert"),
        ("workers = 0", "workers: expected greater than or equal to 1, got 0"),
        ("workers = 2.5", "workers: expected a valid integer, got 2.5"),
        ("queue = 'many'", "queue: expected a valid integer, got 'many'"),
        ("drain = true", "drain: expected a valid number, got True"),
        ("allow = 'scans'", "allow: expected a valid list, got 'scans'"),
        ("listen = 5", "listen: expected a valid string, got 5"),
        ("config = 'other.toml'", "unknown key 'config'"),
        ("[serve]\nworkers = 2", "unknown key 'serve'"),
        ("workers = ", "is no TOML file"),
    ],
)
def test_a_key_that_cannot_be_used_is_one_line(
    tmp_path: Path, text: str, problem: str, started: list[ServeOptions]
) -> None:
    path = _write(tmp_path, text)
    outcome = CliRunner().invoke(app, ["serve", "--config", str(path)])
    assert outcome.exit_code == 3
    assert outcome.output.startswith(f"{path}: {problem}")
    assert outcome.output.count("\n") == 1
    assert not started


def test_all_wrong_keys_are_named_together_and_a_missing_file_too(tmp_path: Path) -> None:
    path = _write(tmp_path, "workers = 0\nqueue = -1\nlisten = 5\n")
    with pytest.raises(RequestError) as caught:
        read_config(path, list_options(serve_command))
    assert len(caught.value.problems) == 3
    with pytest.raises(RequestError, match=r"--config .*nothing\.toml: cannot be read \(No such file"):
        read_config(tmp_path / "nothing.toml", list_options(serve_command))


def test_every_option_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "service.md").read_text()
    assert [name for name in list_options(serve_command) if f"`--{name}" not in page] == []
