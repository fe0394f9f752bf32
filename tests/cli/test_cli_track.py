"""``scopt track``: verdicts, orders at given times, one line for wrong input."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import pytest
from click.testing import Result
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from typer.testing import CliRunner

from service import parse_request, plan, write_result
from service.cli.app import app
from service.cli.run import EXIT_CODES
from service.result.approval import Approval, Revocation, Signer
from service.result.folder import read_result
from service.result.manifest import hash_certificate, hash_file, list_files


@pytest.fixture(scope="module")
def reach(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result folder of a short reach."""
    folder = tmp_path_factory.mktemp("plans") / "reach"
    goal = {"link": "l_tool", "position": [0.5, 0.35, 1.0], "position_tolerance_m": 0.02}
    write_result(plan(parse_request({"robot": {"name": "atlas"}, "goal": {"poses": [goal]}})), folder)
    return folder


def _track(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["track", *(str(argument) for argument in arguments)])


def test_a_plan_is_tracked_to_its_end(reach: Path) -> None:
    done = _track(reach)
    assert done.exit_code == 0
    assert done.stdout.splitlines()[-1].startswith("TRACKED  to the end of the plan")
    assert "ms median" in done.stdout


def test_json_is_one_object_with_changes_and_computing_times(reach: Path, tmp_path: Path) -> None:
    done = _track(reach, "--json", "--shift", "r_hand:0.02,0,0@0.3", "-o", tmp_path / "deep" / "track.json")
    data = json.loads(done.stdout)
    assert data["verdict"] == "TRACKED"
    assert [change["mode"] for change in data["changes"]] == ["running", "done"]
    assert max(data["off_m"].values()) < 5e-3
    assert data["acceleration_share"] <= 1.0 + 1e-9
    assert len(data["control_ms"]) == len(data["cycle_ms"]) == 3
    assert json.loads((tmp_path / "deep" / "track.json").read_text()) == data


def test_a_pause_and_a_resume_come_at_their_times(reach: Path) -> None:
    data = json.loads(_track(reach, "--json", "--pause", 0.3, "--resume", 0.9).stdout)
    assert [(change["mode"], round(change["at_s"], 1)) for change in data["changes"]][:3] == [
        ("running", 0.0),
        ("paused", 0.3),
        ("running", 0.9),
    ]
    assert data["verdict"] == "TRACKED"


def test_an_abort_has_an_exit_code_of_its_own(reach: Path) -> None:
    done = _track(reach, "--abort", 0.4)
    assert done.exit_code == EXIT_CODES["ABORTED"] == 8
    assert "ABORTED  aborted by the operator" in done.stdout


def test_table_1_lags_behind_and_still_ends(reach: Path) -> None:
    followed, printed = (json.loads(_track(reach, "--json", "--gains", name).stdout) for name in ("follow", "table-1"))
    assert printed["verdict"] == "TRACKED"
    assert printed["off_m"]["l_hand"] > 10.0 * followed["off_m"]["l_hand"]


def test_an_adjusted_goal_leaves_a_result_of_its_own(reach: Path, tmp_path: Path) -> None:
    rest = tmp_path / "rest"
    done = _track(reach, "--adjust", "l_tool:0.02,0,0.03@0.4", "--rest", rest, "--json")
    assert json.loads(done.stdout)["verdict"] == "TRACKED"
    assert json.loads((rest / "result.json").read_text())["verdict"] == "CERTIFIED"
    assert [path.name for path in tmp_path.iterdir()] == ["rest"]  # no state file is left


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--shift", "r_hand:0.02,0@1"], "expected LINK:X,Y,Z@TIME"),
        (["--shift", "r_hand:0.02,0,nan@1"], "expected LINK:X,Y,Z@TIME"),
        (["--shift", "r_hand:0,0,0@-1"], "expected LINK:X,Y,Z@TIME"),
        (["--shift", "r_hnd:0.02,0,0@0.1"], "unknown link 'r_hnd'"),
        (["--shift", "r_hand:2,0,0@0.1"], "2 m long"),
        (["--gains", "folow"], "unknown preset 'folow'; expected"),
        (["--speed", "7"], "expected 0.01 to 1"),
        (["--adjust", "nose:0,0,0.1@0.2"], "no target 'nose'"),
    ],
)
def test_wrong_options_are_refused_in_one_line(reach: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    done = _track(reach, *arguments, "--rest", tmp_path / "rest")
    assert done.exit_code == EXIT_CODES["INVALID_REQUEST"]
    assert message in done.stdout
    assert len(done.stdout.strip().splitlines()) == 1


def test_a_folder_without_a_result_is_refused_in_one_line(tmp_path: Path) -> None:
    done = _track(tmp_path)
    assert done.exit_code == EXIT_CODES["INVALID_REQUEST"]
    assert len(done.stdout.strip().splitlines()) == 1


def test_a_changed_folder_is_refused(reach: Path, tmp_path: Path) -> None:
    data = json.loads((reach / "result.json").read_text())
    data["curve"]["positions"][1][12] += 0.1
    (tmp_path / "result.json").write_text(json.dumps(data))
    (tmp_path / "robot").symlink_to(reach / "robot")
    done = _track(tmp_path)
    assert done.exit_code == EXIT_CODES["INVALID_REQUEST"]
    assert done.stdout.startswith("INVALID_REQUEST")


def test_only_an_approved_plan_is_tracked_and_verified_where_a_key_is_trusted(reach: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(reach, tmp_path / "out")
    key = Ed25519PrivateKey.generate()
    private, public = tmp_path / "key.pem", tmp_path / "key.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    private.chmod(0o600)
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    unsigned = _track(folder, "--trust", public)
    assert (unsigned.exit_code, "there is no approval.json" in unsigned.stderr) == (3, True)
    files = {name: hash_file(path).removeprefix("sha256:") for name, path in list_files(folder).items()}
    proof = hash_certificate(read_result(folder)).removeprefix("sha256:")
    approval = Approval("p1", "CERTIFIED", "ada", "", time.time(), "", "", proof, files["viewer.html"], files)
    (folder / "approval.json").write_bytes(Signer(private).sign(approval))
    assert _track(folder, "--trust", public).stdout.splitlines()[-1].startswith("TRACKED  to the end")
    verified = CliRunner().invoke(app, ["verify", str(folder), "--trust", str(public)])
    assert "approved by      ada on 20" in verified.stdout
    assert "not checked:" not in verified.stdout
    assert "not checked: 'approval.json' (--trust KEY checks the signature)" in (
        CliRunner().invoke(app, ["verify", str(folder)]).stdout
    )
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "p1.json").write_bytes(Signer(private).sign_revocation(Revocation("p1", "bob", "", time.time())))
    for command in ("track", "verify"):
        options = [command, str(folder), "--trust", str(public), "--revocations", str(kept)]
        refused = CliRunner().invoke(app, options)
        assert (refused.exit_code, "was revoked by bob on 20" in refused.stderr) == (3, True)
    assert CliRunner().invoke(app, ["verify", str(folder), "--revocations", str(kept)]).exit_code == 2
    assert _track(folder, "--trust", public, "--shift", "r_hand:0.02,0,0@0.3").exit_code == 2
