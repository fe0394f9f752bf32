"""Files of ``deploy/``: they name metrics, options, files and states that exist."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import grpc
import pytest
import yaml
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from service.cli.app import app
from service.cli.server.config import list_options, read_config
from service.cli.server.serve import serve_command
from service.executor import PoolStats, WorkerState, WorkerStats
from service.server.methods import SERVICE
from service.store import CloudStore, Store
from service.telemetry import Metrics

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
USED = re.compile(r"\b((?:scopt|process)_\w+)(?:\{([^}]*)\})?")
MATCHER = re.compile(r'(\w+)\s*(?:=~|!=|=)\s*"([^"]*)"')
BY = re.compile(r"\bby \(([^)]*)\)")
OF_PROMETHEUS = {"instance", "job", "le"}  # labels that Prometheus and histograms add


def _exported(folder: Path) -> dict[str, dict[str, set[str]]]:
    """Values of each label by sample of a server's metrics, after a plan of each kind of end."""
    metrics = Metrics()
    workers = tuple(WorkerStats(number, state, 1, 1000) for number, state in enumerate(WorkerState))
    for code in grpc.StatusCode:
        for method in SERVICE.methods:
            metrics.request_began(method.name)
            metrics.request_ended(method.name, code.name, 0.1)
    steps = ("queue", "load_robot", "perceive", "reach", "curve and timing", "certificate", "explain", "total")
    metrics.plan_finished("valve", "CERTIFIED", dict.fromkeys(steps, 1.0))
    with Store(folder / "plans") as store, CloudStore(folder / "clouds") as clouds:
        metrics.watch(pool=lambda: PoolStats(workers, 3, 7, 1, 11), store=store, clouds=clouds)
        text = generate_latest(metrics.registry).decode()
    samples: dict[str, dict[str, set[str]]] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            labels = samples.setdefault(sample.name, {})
            for label, value in sample.labels.items():
                labels.setdefault(label, set()).add(value)
    return samples


def _expressions() -> list[str]:
    rules = yaml.safe_load((DEPLOY / "alerts.yml").read_text())["groups"][0]["rules"]
    panels = json.loads((DEPLOY / "grafana" / "dashboards" / "scopt.json").read_text())["panels"]
    shown = [target["expr"] for panel in panels for target in panel["targets"]]
    assert len(rules) >= 5
    assert len(shown) >= 10
    return [*(rule["expr"] for rule in rules), *shown]


def test_alerts_and_dashboard_use_metrics_labels_and_values_that_a_server_exports(tmp_path: Path) -> None:
    exported = _exported(tmp_path)
    for expression in _expressions():
        used = USED.findall(expression)
        labels = set().union(*(exported[name] for name, _ in used)) | OF_PROMETHEUS
        for names in BY.findall(expression):
            assert {name.strip() for name in names.split(",")} <= labels, expression
        for name, matchers in used:
            for label, values in MATCHER.findall(matchers):
                if label not in OF_PROMETHEUS:
                    assert set(values.split("|")) <= exported[name][label], expression


def test_the_server_in_the_container_is_configured_with_options_that_exist() -> None:
    values = read_config(DEPLOY / "server.toml", list_options(serve_command))
    assert values["remote_metrics"] is True
    services = _read("compose.yaml")["services"]
    mounted = {entry.split(":")[1] for entry in services["scopt"]["volumes"]}
    for path in (values["tls_cert"], values["tls_key"], values["tokens"], values["data"]):
        assert path in mounted or str(Path(path).parent) in mounted
    scrape = _read("prometheus.yml")["scrape_configs"][0]["static_configs"][0]["targets"]
    assert scrape == [f"scopt:{values['metrics'].rpartition(':')[2]}"]
    data_sources = _read("grafana/provisioning/datasources/prometheus.yaml")["datasources"]
    dashboard = (DEPLOY / "grafana" / "dashboards" / "scopt.json").read_text()
    assert {source["uid"] for source in data_sources} == set(re.findall(r'"uid": "(\w+)"', dashboard)) - {"scopt"}


def test_files_that_the_composition_mounts_are_there() -> None:
    services = _read("compose.yaml")["services"]
    for service in services.values():
        for entry in service["volumes"]:
            source = entry.split(":")[0]
            assert not source.startswith("./") or source == "./secrets" or (DEPLOY / source).exists(), entry


def test_the_image_has_the_packages_the_libraries_and_an_unprivileged_user() -> None:
    lines = (ROOT / "Dockerfile").read_text()
    for source in re.findall(r"^COPY (?!--from)(.*) \S+$", lines, flags=re.MULTILINE):
        for path in source.split():
            assert (ROOT / path).exists(), path
            assert f"!{path}" in (ROOT / ".dockerignore").read_text().splitlines()
    setup = (ROOT / "tools" / "setup.sh").read_text()
    libraries = set(re.findall(r"then echo (lib\S+);", setup))
    assert libraries
    assert all(library in lines for library in libraries)
    users = re.findall(r"^USER (\S+)$", lines, flags=re.MULTILINE)
    assert users == ["scopt"]
    probe = json.loads(re.findall(r"HEALTHCHECK .*?CMD (\[.*?\])", lines, flags=re.DOTALL)[0])
    assert probe[-1] == f"unix:{read_config(DEPLOY / 'server.toml', list_options(serve_command))['socket']}"


def test_commands_of_image_and_unit_exist() -> None:
    commands = {command.name for command in app.registered_commands}
    unit = (DEPLOY / "scopt.service").read_text()
    started = re.findall(r"^ExecStart=\S+/scopt (\w+) (.*)$", unit, flags=re.MULTILINE)
    assert [name for name, _ in started] == ["serve"]
    options = set(re.findall(r"--([\w-]+)", started[0][1])) - {"config"}
    assert options <= set(list_options(serve_command))
    assert {"serve", "health"} <= commands


def _read(name: str) -> Any:
    return yaml.safe_load((DEPLOY / name).read_text())


def test_errors_on_which_an_alert_fires_are_counted_from_zero():
    """``increase`` of a series that begins at 1 is 0, so that the first error would go unseen."""
    metrics = Metrics([method.name for method in SERVICE.methods])
    text = generate_latest(metrics.registry).decode()
    rows = {
        (sample.labels["method"], sample.labels["code"]): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name == "scopt_requests_total"
    }
    rules = yaml.safe_load((DEPLOY / "alerts.yml").read_text())["groups"][0]["rules"]
    codes = {
        code
        for rule in rules
        if rule["alert"] in ("ScoptInternalErrors", "ScoptDamagedData")
        for name, values in MATCHER.findall(rule["expr"])
        if name == "code"
        for code in values.split("|")
    }
    assert codes
    assert rows == {(method.name, code): 0.0 for method in SERVICE.methods for code in codes}


def test_every_alert_is_seen_to_fire_by_promtool() -> None:
    rules = yaml.safe_load((DEPLOY / "alerts.yml").read_text())["groups"][0]["rules"]
    tests = yaml.safe_load((DEPLOY / "alerts_test.yml").read_text())["tests"]
    fired = {one["alertname"] for test in tests for one in test["alert_rule_test"] if one["exp_alerts"]}
    assert fired == {rule["alert"] for rule in rules}
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool is not installed; it is in Debian's package prometheus")
    command = [promtool, "test", "rules", "alerts_test.yml"]
    ran = subprocess.run(command, cwd=DEPLOY, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
