"""A tokens file says who may come in; it holds no token, and others may not read it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from service.trust import Identity, Role, Tokens, TrustError, hash_token, make_token


def _file(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "tokens.yaml"
    path.write_text(text)
    path.chmod(mode)
    return path


def _refused(folder: Path, text: str) -> str:
    with pytest.raises(TrustError) as caught:
        Tokens(_file(folder, text))
    return str(caught.value)


def test_the_line_that_comes_with_a_token_lets_it_in(tmp_path: Path) -> None:
    token, line = make_token("valve-team", [Role.PLAN, Role.REVIEW])
    other, more = make_token("watch", [Role.ADMIN])
    tokens = Tokens(_file(tmp_path, f"{line}\n{more}\n"))
    assert tokens.find_token(token) == Identity("valve-team", frozenset({Role.PLAN, Role.REVIEW}))
    assert tokens.find_token(other) == Identity("watch", frozenset({Role.ADMIN}))
    assert tokens.has_tokens
    assert not tokens.has_certificates


def test_a_token_is_long_random_and_not_in_its_line() -> None:
    drawn = [make_token("ann", [Role.PLAN]) for _ in range(20)]
    assert len({token for token, _ in drawn}) == 20
    assert all(len(token) >= 40 and token not in line for token, line in drawn)
    assert yaml.safe_load(drawn[0][1])[0]["token_sha256"] == hash_token(drawn[0][0])


@given(st.text())
def test_what_is_no_token_lets_nobody_in(text: str) -> None:
    entry = Tokens.__new__(Tokens)
    entry._entries = ()
    assert entry.find_token(text) is None


def test_neither_an_empty_token_nor_a_hash_lets_anybody_in(tmp_path: Path) -> None:
    token, line = make_token("ann", [Role.PLAN])
    tokens = Tokens(_file(tmp_path, f"{line}\n- {{name: bob, roles: [plan], certificate: bob.local}}\n"))
    for wrong in ("", token[:-1], token + "x", token.upper(), hash_token(token), "\udcff", "é"):
        assert tokens.find_token(wrong) is None
    assert tokens.find_common_name("") is None
    assert tokens.find_common_name("ann") is None


def test_a_certificate_is_known_by_its_common_name(tmp_path: Path) -> None:
    tokens = Tokens(_file(tmp_path, "- {name: robot-7, roles: [plan], certificate: robot-7.local}\n"))
    assert tokens.find_common_name("robot-7.local") == Identity("robot-7", frozenset({Role.PLAN}))
    assert tokens.find_common_name("robot-8.local") is None
    assert tokens.has_certificates
    assert not tokens.has_tokens


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o620, 0o602, 0o601])
def test_a_file_that_others_may_read_or_change_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(TrustError, match=r"others may read or change it \(mode \d+\); run chmod 600"):
        Tokens(_file(tmp_path, make_token("ann", [Role.PLAN])[1], mode))


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o440])
def test_a_file_that_only_its_owner_and_group_may_read_is_read(tmp_path: Path, mode: int) -> None:
    assert Tokens(_file(tmp_path, make_token("ann", [Role.PLAN])[1], mode)).has_tokens


def test_a_name_may_have_two_tokens_while_one_replaces_the_other(tmp_path: Path) -> None:
    (old, first), (new, second) = (make_token("ann", [Role.PLAN]) for _ in range(2))
    tokens = Tokens(_file(tmp_path, f"{first}\n{second}\n"))
    assert tokens.find_token(old) == tokens.find_token(new) == Identity("ann", frozenset({Role.PLAN}))
    _, other = make_token("ann", [Role.ADMIN])
    assert "ann: its entries have different roles" in _refused(tmp_path, f"{first}\n{other}\n")
    assert "token_sha256: two entries have the same" in _refused(tmp_path, f"{first}\n{first}\n")


def test_reading_anew_brings_changes_and_keeps_what_was_in_force_on_an_error(tmp_path: Path) -> None:
    old, line = make_token("ann", [Role.PLAN])
    path = _file(tmp_path, line)
    tokens = Tokens(path)
    path.write_text("- {name: ann}")
    with pytest.raises(TrustError, match=r"\[0\]\.roles: expected a list of plan, review, execute, command, admin"):
        tokens.reload()
    assert tokens.find_token(old) is not None
    new, line = make_token("bob", [Role.PLAN])
    path.write_text(line)
    tokens.reload()
    assert tokens.find_token(old) is None
    assert tokens.find_token(new) is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a list of {name, roles, token_sha256}"),
        ("ann: [plan]", "a list of"),
        ("- ann", "[0]: expected a mapping of name, roles, token_sha256, certificate"),
        ("- {name: ann, roles: [plan]}", "[0]: expected token_sha256 or certificate"),
        ("- {name: '../x', roles: [plan], certificate: a}", "[0].name: expected 1 to 100 letters"),
        (
            "- {name: ann, roles: [root], certificate: a}",
            "[0].roles: unknown role 'root'; expected plan, review, execute, command, admin",
        ),
        ("- {name: ann, roles: [[plan]], certificate: a}", "[0].roles: unknown role ['plan']"),
        (
            "- {name: ann, roles: [plan], token: a}",
            "unknown key 'token'; expected name, roles, token_sha256, certificate",
        ),
        ("- {name: ann, roles: [plan], certificate: 7}", "[0].certificate: expected the common name"),
        ("- [\n", "is no valid YAML (line 2)"),
        ("- !!python/object:os.system x", "is no valid YAML"),
        ("\x00", "is no valid YAML"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    message = _refused(tmp_path, text)
    assert words in message
    assert "tokens.yaml: " in message


def test_a_wrong_hash_or_a_token_in_the_file_is_not_repeated(tmp_path: Path) -> None:
    message = _refused(tmp_path, "- {name: ann, roles: [plan], token_sha256: scopt_secret}")
    assert "[0].token_sha256: expected 64 hexadecimal digits" in message
    assert "secret" not in message
    assert "secret" not in _refused(tmp_path, "- {name: ann, token_sha256: scopt_secret: x}")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrustError, match=r"tokens\.yaml: cannot be read \(No such file"):
        Tokens(tmp_path / "tokens.yaml")


def test_a_token_needs_a_plain_name_and_a_role() -> None:
    with pytest.raises(TrustError, match="letters, digits"):
        make_token("ann: {", [Role.PLAN])
    with pytest.raises(TrustError, match="roles: expected at least one"):
        make_token("ann", [])


def test_a_file_and_a_name_are_as_long_as_they_may_be_and_no_longer(tmp_path: Path) -> None:
    entry = "- {{name: ann, roles: [plan], certificate: {name}}}\n#"
    text = entry.format(name="c" * 200)
    tokens = Tokens(_file(tmp_path, text + "x" * (1_000_000 - len(text))))
    assert tokens.find_common_name("c" * 200) is not None
    assert "has more than 1000000 bytes" in _refused(tmp_path, text + "x" * (1_000_001 - len(text)))
    assert "expected the common name of a client certificate" in _refused(tmp_path, entry.format(name="c" * 201))
