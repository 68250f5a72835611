"""What plant.toml says of sign-in and TLS, and a service that speaks it."""

from __future__ import annotations

import contextlib
import ssl
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from service.config.settings import load_plant
from service.server.certificates import Certificates, context_of
from tests.service.conftest import PLANT
from valve.errors import ConfigurationError

_OPENSSL = (
    "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 30 -subj /CN=127.0.0.1 "
    "-addext subjectAltName=IP:127.0.0.1 -keyout key.pem -out certificate.pem"
)
LOCAL = 'bind = "127.0.0.1"'


@pytest.fixture
def tls_folder(quick_path: Path) -> Path:
    """Return a folder with a certificate for 127.0.0.1 and its key."""
    made = subprocess.run(
        _OPENSSL.split(),
        cwd=quick_path,
        capture_output=True,
        check=False,
    )
    if made.returncode != 0:
        pytest.skip("this machine's openssl makes no certificate")
    (quick_path / "key.pem").chmod(0o600)
    return quick_path


def plant(folder: Path, bind: str, *more: str) -> Path:
    path = folder / "plant.toml"
    path.write_text(PLANT.replace(LOCAL, "\n".join([f'bind = "{bind}"', *more])), encoding="utf-8")
    return path


TLS = ('tls_certificate = "certificate.pem"', 'tls_key = "key.pem"')


def test_sign_in_is_the_default_wherever_others_can_come(tls_folder: Path) -> None:
    def sign_in(bind: str, *more: str) -> bool:
        return load_plant(plant(tls_folder, bind, *more)).service.access.sign_in

    assert not sign_in("127.0.0.1")
    assert not sign_in("::1")
    assert sign_in("127.0.0.1", 'access = "sign-in"')
    assert sign_in("127.0.0.1", "behind_proxy = true")
    assert sign_in("0.0.0.0", *TLS)
    assert sign_in("0.0.0.0", "behind_proxy = true")
    assert sign_in("0.0.0.0", "trusted_network = true")
    assert not sign_in("0.0.0.0", "trusted_network = true", 'access = "open"')


@pytest.mark.parametrize(
    ("bind", "more", "parts"),
    [
        ("0.0.0.0", (), ("service.bind", "unencrypted", "tls_certificate")),
        ("0.0.0.0", ('access = "sign-in"',), ("unencrypted",)),
        ("0.0.0.0", (*TLS, 'access = "open"'), ("service.access", "may move valves", "sign-in")),
        ("127.0.0.1", ("behind_proxy = true", 'access = "open"'), ("service.access", "proxy")),
        ("127.0.0.1", ('access = "maybe"',), ("service.access", "sign-in")),
        ("127.0.0.1", TLS[:1], ("tls_key", "both")),
        ("127.0.0.1", (TLS[0], 'tls_key = "none.pem"'), ("none.pem", "No such file")),
        ("127.0.0.1", (TLS[0], 'tls_key = "certificate.pem"'), ("tls_certificate", "PEM")),
        ("127.0.0.1", ('approved_sequences = ["waltz"]',), ("approved_sequences[0]", "waltz", "triangle")),
        ("127.0.0.1", ('allowed_hosts = ["*"]',), ("allowed_hosts[0]", "stands for every one", "without scheme")),
        ("127.0.0.1", ('allowed_hosts = ["a", "http://b"]',), ("allowed_hosts[1]", "http://b", "*.example.org")),
    ],
)
def test_what_would_let_anybody_in_is_refused_with_the_remedy(
    tls_folder: Path, bind: str, more: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant(tls_folder, bind, *more))
    for part in parts:
        assert part in str(caught.value)


def test_a_key_that_others_can_read_is_refused(tls_folder: Path) -> None:
    (tls_folder / "key.pem").chmod(0o640)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        load_plant(plant(tls_folder, "127.0.0.1", *TLS))


def test_the_service_speaks_tls_and_its_cookie_is_for_tls_alone(tls_folder: Path) -> None:
    password = "stem packing seat 7"
    config = plant(tls_folder, "127.0.0.1", *TLS, 'access = "sign-in"')
    command = [sys.executable, "-m", "service.cli"]
    added = subprocess.run(
        [*command, "user", "add", "anna", "--role", "viewer", "--config", str(config)],
        env={"BREAKAWAY_PASSWORD": password, "PATH": "/usr/bin:/bin"},
        capture_output=True,
        timeout=60.0,
        check=False,
    )
    assert added.returncode == 0, added.stderr
    log = tls_folder / "serve.log"
    with log.open("wb") as output:
        process = subprocess.Popen([*command, "serve", "--config", str(config)], stdout=output, stderr=output)
    try:
        url = _listening(log, process)
        trusted = ssl.create_default_context(cafile=tls_folder / "certificate.pem")
        with httpx.Client(base_url=url, verify=trusted, timeout=120.0) as client:
            answer = client.post("/session", json={"name": "anna", "password": password})
            assert answer.status_code == 200, answer.text
            cookie = answer.headers["set-cookie"]
            assert cookie.startswith("__Host-breakaway=")
            assert "Secure" in cookie
            assert "max-age" in answer.headers["strict-transport-security"]
            assert client.get("/valves").status_code == 200
        _renew(tls_folder)
        deadline = time.monotonic() + 120.0
        renewed = ssl.PEM_cert_to_DER_cert((tls_folder / "certificate.pem").read_text(encoding="utf-8"))
        while _shown(url) != renewed:
            assert time.monotonic() < deadline, "the renewed certificate is not taken up"
            time.sleep(0.5)
        with httpx.Client(timeout=120.0) as plain, pytest.raises(httpx.HTTPError):
            plain.get(url.replace("https", "http") + "/healthz")
    finally:
        process.terminate()
        process.wait(120.0)
    assert password not in log.read_text(encoding="utf-8")


def _renew(folder: Path) -> None:
    subprocess.run(_OPENSSL.split(), cwd=folder, capture_output=True, check=True)
    (folder / "key.pem").chmod(0o600)


def _shown(url: str) -> bytes:
    """Return the certificate that a server shows, DER."""
    host, _, port = url.removeprefix("https://").partition(":")
    return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate((host, int(port)), timeout=60.0))


def test_a_renewed_pair_is_taken_up_whole_and_one_that_does_not_fit_never(tls_folder: Path) -> None:
    kept = tls_folder / "kept"
    kept.mkdir()
    for name in ("certificate.pem", "key.pem"):  # as certbot does: a link to the newest of several files
        (tls_folder / name).rename(kept / f"1-{name}")
        (tls_folder / name).symlink_to(kept / f"1-{name}")
    access = load_plant(plant(tls_folder, "127.0.0.1", *TLS)).service.access
    assert access.tls_certificate is not None
    assert access.tls_key is not None
    certificates = Certificates(access.tls_certificate, access.tls_key)
    listening = context_of(access.tls_certificate, access.tls_key)
    certificates.show_on(listening)
    first, renewed = _der(kept / "1-certificate.pem"), tls_folder / "renewed"
    renewed.mkdir()
    _renew(renewed)
    for name in ("certificate.pem", "key.pem"):
        (renewed / name).rename(kept / f"2-{name}")
    assert (certificates.look(), _handshaken(listening)) == (False, first)
    _point(tls_folder / "certificate.pem", kept / "2-certificate.pem")
    assert (certificates.look(), _handshaken(listening)) == (False, first), "its key is still the former one"
    _point(tls_folder / "key.pem", kept / "2-key.pem")
    (kept / "2-key.pem").chmod(0o644)
    assert (certificates.look(), _handshaken(listening)) == (False, first), "others may read its key"
    (kept / "2-key.pem").chmod(0o600)
    _point(tls_folder / "key.pem", kept / "2-key.pem")
    (kept / "2-key.pem").touch()
    assert (certificates.look(), _handshaken(listening)) == (True, _der(kept / "2-certificate.pem"))
    (tls_folder / "key.pem").unlink()
    assert (certificates.look(), _handshaken(listening)) == (False, _der(kept / "2-certificate.pem"))


def _der(path: Path) -> bytes:
    return ssl.PEM_cert_to_DER_cert(path.read_text(encoding="utf-8"))


def _point(link: Path, to: Path) -> None:
    link.unlink()
    link.symlink_to(to)


def _handshaken(listening: ssl.SSLContext) -> bytes:
    """Return the certificate that a connection to this context is shown, DER; no name is asked for."""
    asking = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    asking.check_hostname, asking.verify_mode = False, ssl.CERT_NONE
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    client, server = asking.wrap_bio(back, there), listening.wrap_bio(there, back, server_side=True)
    for one in (client, server, client, server):
        with contextlib.suppress(ssl.SSLWantReadError):
            one.do_handshake()
    shown = client.getpeercert(binary_form=True)
    assert shown is not None
    return shown


def _listening(log: Path, process: subprocess.Popen[bytes]) -> str:
    deadline = time.monotonic() + 180.0
    while time.monotonic() < deadline and process.poll() is None:
        for line in log.read_text(encoding="utf-8").splitlines():
            if '"listening"' in line:
                return "https://127.0.0.1:" + line.partition("https://127.0.0.1:")[2].partition('"')[0]
        time.sleep(0.1)
    raise AssertionError(log.read_text(encoding="utf-8"))
