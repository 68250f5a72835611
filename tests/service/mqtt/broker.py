"""A broker of a test's own: mosquitto on a free loopback port, with TLS and accounts, ended with the test."""

from __future__ import annotations

import contextlib
import getpass
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from service.cli.demo_plant import free_ports

_DAYS = "2"
_DEADLINE_S = 60.0


def why_no_broker() -> str:
    """Return which program is missing; "" where none is."""
    missing = [name for name in ("mosquitto", "mosquitto_passwd", "openssl") if _program(name) is None]
    return f"not installed: {', '.join(missing)}" if missing else ""


def authority(folder: Path, name: str) -> Path:
    """Make a certificate authority; return its certificate, its key stands beside it."""
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    _openssl("req", "-x509", *_new_key(key), "-subj", f"/CN={name}", "-days", _DAYS, "-out", certificate)
    return certificate


def certificate(folder: Path, name: str, signed_by: Path, of_host: str) -> Path:
    """Make a certificate of a host, signed by an authority; its key stands beside it."""
    request, signed, key = folder / f"{name}.csr", folder / f"{name}.pem", folder / f"{name}.key"
    _openssl(
        "req", "-new", *_new_key(key), "-subj", f"/CN={name}", "-addext", f"subjectAltName={of_host}", "-out", request
    )
    by = ("-CA", signed_by, "-CAkey", signed_by.with_suffix(".key"), "-CAcreateserial", "-copy_extensions", "copy")
    _openssl("x509", "-req", "-in", request, *by, "-days", _DAYS, "-out", signed)
    return signed


@contextlib.contextmanager
def broker(folder: Path, certificate: Path, name: str, password: str) -> Iterator[int]:
    """Serve MQTT over TLS alone, for one account; hand out the port."""
    accounts = folder / "accounts"
    _run(_program("mosquitto_passwd"), "-b", "-c", accounts, name, password)
    (port,) = free_ports(1)
    (folder / "mosquitto.conf").write_text(
        f"listener {port} 127.0.0.1\n"
        f"certfile {certificate}\nkeyfile {certificate.with_suffix('.key')}\n"
        f"allow_anonymous false\npassword_file {accounts}\npersistence false\n"
        f"user {getpass.getuser()}\n",  # it would give up root's rights, and with them the files above
        encoding="utf-8",
    )
    with (folder / "mosquitto.log").open("wb") as log:
        command = [str(_program("mosquitto")), "-c", str(folder / "mosquitto.conf")]
        with subprocess.Popen(command, stdout=log, stderr=log) as process:
            try:
                _wait(process, port, folder / "mosquitto.log")
                yield port
            finally:
                process.terminate()


def _program(name: str) -> str | None:
    return shutil.which(name) or shutil.which(name, path="/usr/sbin:/usr/local/sbin")


def _new_key(key: Path) -> tuple[str | Path, ...]:
    return ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", key)


def _openssl(*arguments: str | Path) -> None:
    _run(_program("openssl"), *arguments)


def _run(program: str | None, *arguments: str | Path) -> None:
    assert program is not None
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=30.0, check=False)
    assert done.returncode == 0, done.stderr


def _wait(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    ends_s = time.monotonic() + _DEADLINE_S
    while True:
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            return
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < ends_s, log.read_text()
        time.sleep(0.05)
