"""The commands against a real server in a process of its own, with TLS and tokens."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import trustme
import yaml
from click.testing import Result
from given_doors import door_request
from typer.testing import CliRunner

from service.cli.app import app
from service.wire.hashes import hash_trajectory

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"


LONG_S = 1200


@dataclass(frozen=True)
class Served:
    """Running server: address, authority, and tokens by role."""

    target: str
    tls_ca: Path
    tokens: dict[str, str]

    def scopt(self, role: str, *arguments: object) -> Result:
        """A command as a client that has this role."""
        words = [*arguments, "--target", self.target, "--tls-ca", self.tls_ca]
        return CliRunner().invoke(app, [str(word) for word in words], env={"SCOPT_TOKEN": self.tokens.get(role, "")})


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("server")
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(folder / "ca.pem"))
    leaf = authority.issue_cert("localhost")
    leaf.private_key_pem.write_to_path(str(folder / "server.key"))
    (folder / "server.key").chmod(0o600)
    leaf.cert_chain_pems[0].write_to_path(str(folder / "server.pem"))
    tokens, lines = {}, ""
    for role in ("plan", "review", "admin"):
        extra = ("--role", "plan") if role == "review" else ()  # who reviews looks at plans
        made = CliRunner().invoke(app, ["token", f"{role}-desk", "--role", role, *extra])
        tokens[role], lines = made.stdout.strip(), lines + made.stderr
    (folder / "tokens.yaml").touch(mode=0o600)
    (folder / "tokens.yaml").write_text(lines)
    options = {"listen": "localhost:0", "workers": 1, "drain": 0, "data": folder / "kept"}
    options |= {"tls-cert": folder / "server.pem", "tls-key": folder / "server.key", "tokens": folder / "tokens.yaml"}
    command = [sys.executable, "-c", "from service.cli.app import main; main()", "serve"]
    command += [word for name, value in options.items() for word in (f"--{name}", str(value))]
    for kind in ("valve", "door", "contacts"):  # as long as a busy machine takes
        command += ["--budget", f"{kind}={LONG_S}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().removeprefix("listening on ").strip()
        yield Served(f"localhost:{address.rpartition(':')[2]}", folder / "ca.pem", tokens)
    finally:
        process.terminate()
        process.communicate(timeout=120)


@pytest.mark.parametrize("name", ["joint_goal", "pose_goal", "valve"])
def test_example_requests_are_certified_by_a_server(served: Served, tmp_path: Path, name: str) -> None:
    result = served.scopt("plan", "request", REQUESTS / f"{name}.yaml", "--out", tmp_path / "plan")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.splitlines()[-1].startswith("CERTIFIED  clearance ")
    verified = CliRunner().invoke(app, ["verify", str(tmp_path / "plan"), "--json"])
    assert json.loads(verified.stdout)["verdict"] == "CERTIFIED"
    assert {path.name for path in (tmp_path / "plan").iterdir()} == {
        "result.json", "manifest.json", "trajectory.csv", "viewer.html", "scene.glb", "openrave", "robot",
    }  # fmt: skip


def test_a_door_is_opened_alike_by_the_server_and_here(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "door.yaml"
    path.write_text(json.dumps({**door_request(open_deg=20.0), "options": {"time_limit_s": LONG_S}}))
    there = served.scopt("plan", "request", path, "--out", tmp_path / "there")
    assert there.stdout.splitlines()[-1].startswith("CERTIFIED  clearance "), there.stdout
    here = CliRunner().invoke(app, ["plan", str(path), "--out", str(tmp_path / "here")])
    assert here.exit_code == 0, here.stdout
    tables = [(tmp_path / place / "trajectory.csv").read_bytes() for place in ("there", "here")]
    assert tables[0] == tables[1]


def test_contacts_change_alike_by_the_server_and_here(served: Served, tmp_path: Path) -> None:
    request = yaml.safe_load((REQUESTS / "stair.yaml").read_text())
    contacts = request["task"]["contacts"]
    del contacts["stances"][1:]
    contacts.pop("finish")
    request["options"] = {**request.get("options", {}), "time_limit_s": LONG_S}
    path = tmp_path / "contacts.yaml"
    path.write_text(json.dumps(request))
    there = served.scopt("plan", "request", path, "--out", tmp_path / "there")
    assert there.stdout.splitlines()[-1].startswith("CERTIFIED  clearance "), there.stdout
    here = CliRunner().invoke(app, ["plan", str(path), "--out", str(tmp_path / "here")])
    assert here.exit_code == 0, here.stdout
    results = [json.loads((tmp_path / place / "result.json").read_text()) for place in ("there", "here")]
    hashes = [
        hash_trajectory(r["trajectory"]["joint_names"], r["trajectory"]["times"], r["trajectory"]["positions"])
        for r in results
    ]
    assert hashes[0] == hashes[1]


def test_wrong_fields_are_reported_by_the_server_as_by_scopt_plan(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("robot: {name: atlas}\nstart: {joints: {elbow: 1}}\ngoal: {joints: {knee: 1}}\n")
    there = served.scopt("plan", "request", path, "--out", tmp_path / "plan")
    here = CliRunner().invoke(app, ["plan", str(path), "--out", str(tmp_path / "plan")])
    assert (there.exit_code, there.stdout) == (here.exit_code, here.stdout)
    assert there.stderr.splitlines()[-1] == here.stderr.splitlines()[-1]


def test_a_plan_is_approved_by_a_reviewer_and_returned_again_for_its_request_id(served: Served, tmp_path: Path) -> None:
    command = ("request", REQUESTS / "joint_goal.yaml", "--out", tmp_path / "plan", "--request-id", "mine", "--json")
    first, again = (json.loads(served.scopt("plan", *command).stdout) for _ in range(2))
    assert first["plan_id"] == again["plan_id"]
    assert served.scopt("plan", "review", first["plan_id"], "--accept").exit_code == 77
    accepted = json.loads(served.scopt("review", "review", first["plan_id"], "--accept", "--json").stdout)
    assert accepted["is_approved"]
    assert accepted["reviews"][0]["reviewer"] == "review-desk"
    rejected = served.scopt("review", "review", first["plan_id"], "--reject", "--comment", "too close")
    assert rejected.stdout.splitlines()[0] == f"plan {first['plan_id']} is not approved"


def test_the_status_needs_a_token_with_its_role(served: Served) -> None:
    assert served.scopt("", "top", "--once").exit_code == 77
    assert served.scopt("plan", "top", "--once").exit_code == 77
    seen = json.loads(served.scopt("admin", "top", "--json").stdout)
    assert len(seen["workers"]) == 2  # one plans, the other is for light calls
