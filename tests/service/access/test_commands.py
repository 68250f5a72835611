from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from drivers.motion.audit_log import AuditLog
from service.cli import main
from service.cli.client import own_token, service_client
from valve.errors import ConfigurationError, RequestError

PASSWORD = "stem packing seat 7"


class Breakaway:
    """The command line in this process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch = monkeypatch
        self._capsys = capsys

    def __call__(self, folder: Path, *arguments: str, **environment: str) -> tuple[int, str, str]:
        """Exit code, standard output and standard error of one command."""
        code = 0
        with self._monkeypatch.context() as patch:
            patch.chdir(folder)
            patch.setattr(sys, "argv", ["breakaway", *arguments])
            patch.setattr("getpass.getpass", _nobody_types)
            patch.delenv("BREAKAWAY_PASSWORD", raising=False)
            for name, value in environment.items():
                patch.setenv(name, value)
            try:
                main()
            except SystemExit as end:
                code = int(end.code or 0)
        return code, *self._capsys.readouterr()


def _nobody_types(_prompt: str) -> str:
    raise EOFError


@pytest.fixture
def breakaway(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Breakaway:
    return Breakaway(monkeypatch, capsys)


def test_the_first_admin_a_token_and_their_trace_in_the_audit_log(breakaway: Breakaway, plant_file: Path) -> None:
    folder = plant_file.parent
    config = ("--config", "plant.toml")
    code, out, _ = breakaway(folder, "user", "add", "root", "--role", "admin", *config, BREAKAWAY_PASSWORD=PASSWORD)
    assert (code, out) == (0, "root is admin now\n")
    code, out, said = breakaway(folder, "token", "create", "cmms", "--role", "operator", "--valve", "FV-101", *config)
    assert code == 0, said
    secret = out.strip()
    assert secret.startswith("breakaway_")
    code, out, _ = breakaway(folder, "token", "list", "--json", *config)
    (token,) = json.loads(out)["tokens"]
    assert (token["name"], token["valves"]) == ("cmms", ["FV-101"])
    assert breakaway(folder, "token", "revoke", token["id"], *config)[0] == 0
    code, out, _ = breakaway(folder, "audit", "show", "--json", *config)
    assert [json.loads(line)["event"] for line in out.splitlines()] == ["user.added", "token.created", "token.revoked"]
    assert PASSWORD not in out
    assert secret not in out
    code, out, _ = breakaway(folder, "audit", "verify", *config)
    assert code == 0
    assert "3 entries" in out
    log = folder / "plant-data" / "audit" / "gateway.audit"
    log.write_bytes(log.read_bytes().replace(b"operator", b"engineer"))
    code, _, said = breakaway(folder, "audit", "verify", str(log.parent))
    assert code == 1
    assert "line 2" in said
    assert len(said.splitlines()) == 1


def test_a_user_who_is_removed_is_gone_and_the_log_still_names_them(breakaway: Breakaway, plant_file: Path) -> None:
    folder, config = plant_file.parent, ("--config", "plant.toml")
    breakaway(folder, "user", "add", "otto", "--role", "viewer", *config, BREAKAWAY_PASSWORD=PASSWORD)
    code, out, _ = breakaway(folder, "user", "remove", "otto", *config)
    assert (code, out) == (0, "otto is removed; every session of theirs has ended\n")
    assert breakaway(folder, "user", "list", *config) == (0, "", "")
    code, _, said = breakaway(folder, "user", "remove", "otto", *config)
    assert code == 1
    assert "'otto' is unknown" in said
    code, out, _ = breakaway(folder, "audit", "show", "--json", *config)
    last = json.loads(out.splitlines()[-1])
    assert (last["event"], last["details"]["name"]) == ("user.removed", "otto")


@pytest.mark.parametrize(
    ("arguments", "password", "part"),
    [
        (("user", "add", "otto", "--role", "viewer"), "short", "12 to 256"),
        (("user", "passwd", "otto"), PASSWORD, "otto"),
        (("token", "create", "x", "--role", "admin"), "", "admin"),
        (("token", "create", "x", "--role", "viewer", "--valve", "FV-9"), "", "FV-9"),
        (("token", "revoke", "nothing"), "", "nothing"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_exit_code_1(
    breakaway: Breakaway, plant_file: Path, arguments: tuple[str, ...], password: str, part: str
) -> None:
    code, _, said = breakaway(plant_file.parent, *arguments, "--config", plant_file.name, BREAKAWAY_PASSWORD=password)
    assert code == 1
    assert said.startswith("breakaway: ")
    assert part in said
    assert len(said.splitlines()) == 1


def test_a_password_is_never_asked_of_nobody(breakaway: Breakaway, plant_file: Path) -> None:
    code, _, said = breakaway(plant_file.parent, "user", "add", "otto", "--role", "viewer", "--config", "plant.toml")
    assert code == 1
    assert "--generate" in said


def test_audit_needs_to_know_which_log(breakaway: Breakaway, tmp_path: Path) -> None:
    code, _, said = breakaway(tmp_path, "audit", "verify")
    assert code == 1
    assert "FOLDER" in said
    AuditLog(tmp_path).append("x", who="y")
    assert breakaway(tmp_path, "audit", "verify", ".")[0] == 0
    code, _, said = breakaway(tmp_path, "audit", "verify", ".", "--head", "0" * 64)
    assert code == 1
    assert "cut off" in said


def test_the_token_comes_from_the_environment_or_from_a_file_that_nobody_else_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("BREAKAWAY_TOKEN", raising=False)
    monkeypatch.delenv("BREAKAWAY_TOKEN_FILE", raising=False)
    assert own_token() is None
    file = tmp_path / ".config" / "breakaway" / "token"
    file.parent.mkdir(parents=True)
    file.write_text("breakaway_x\n")
    file.chmod(0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        own_token()
    file.chmod(0o600)
    assert own_token() == "breakaway_x"
    with service_client("http://127.0.0.1:1") as client:
        assert client.headers["Authorization"] == "Bearer breakaway_x"
    with pytest.raises(RequestError, match="unencrypted"):
        service_client("http://plant.example:8321")
    monkeypatch.setenv("BREAKAWAY_TOKEN_FILE", str(tmp_path / "none"))
    with pytest.raises(ConfigurationError, match="does not exist"):
        own_token()
    monkeypatch.setenv("BREAKAWAY_TOKEN", "two lines\n here")
    with pytest.raises(ConfigurationError, match="no token"):
        own_token()
