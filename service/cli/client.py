"""How a command speaks to a running service: its address, and a token where the service wants one."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Any, Final

import httpx

from valve.errors import ConfigurationError, RequestError, WireError

TOKEN_VARIABLE: Final = "BREAKAWAY_TOKEN"
TOKEN_FILE_VARIABLE: Final = "BREAKAWAY_TOKEN_FILE"
DEFAULT_TOKEN_FILE: Final = Path("~/.config/breakaway/token")
_OTHERS: Final = 0o077
_TIMEOUT: Final = httpx.Timeout(10.0, read=30.0)  # a stream of events says that it lives every 15 s


def service_client(url: str) -> httpx.Client:
    """Return a client of the service at ``url``, with this user's token if there is one.

    Raises RequestError for what is no address or would carry the token unencrypted, ConfigurationError for its file.
    """
    try:
        parsed = httpx.URL(url)
        if parsed.scheme not in ("http", "https") or not parsed.host:
            raise ValueError("it begins with http:// or https:// and a host")
    except (httpx.InvalidURL, ValueError) as error:
        raise RequestError(f"--url {url!r} is no address ({error}): give one such as http://127.0.0.1:8321") from None
    token = own_token()
    if token is None:
        return httpx.Client(base_url=url, timeout=_TIMEOUT)
    if parsed.scheme == "http" and not _is_local(parsed.host):
        raise RequestError(f"--url {url}: the token would cross the network unencrypted: use https")
    return httpx.Client(base_url=url, timeout=_TIMEOUT, headers={"Authorization": f"Bearer {token}"})


def asked(client: httpx.Client, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return what the service answers as JSON. Raises WireError where it does not, RequestError where it refuses."""
    try:
        answer = client.request(method, path, json=body)
    except httpx.HTTPError as error:
        raise WireError(
            f"{client.base_url}: no answer ({error}): start it by breakaway serve, or name it by --url"
        ) from None
    try:
        content: dict[str, Any] = answer.json()
    except ValueError:
        raise WireError(f"{client.base_url}: its answer is no JSON ({answer.status_code}): is it breakaway?") from None
    if answer.is_error:
        raise RequestError(str(content.get("detail", f"status {answer.status_code}")))
    return content


def own_token() -> str | None:
    """Return the token from the environment or from its file, None without one. Raises ConfigurationError."""
    from_environment = os.environ.get(TOKEN_VARIABLE, "").strip()
    if from_environment:
        return _checked(from_environment, TOKEN_VARIABLE)
    named = os.environ.get(TOKEN_FILE_VARIABLE)
    path = Path(named or DEFAULT_TOKEN_FILE).expanduser()
    try:
        mode = path.stat().st_mode & 0o777
        if mode & _OTHERS:
            raise ConfigurationError(f"{path}: others may read this token (mode {mode:o}): chmod 600 {path}")
        return _checked(path.read_text(encoding="utf-8").strip(), str(path))
    except FileNotFoundError:
        if named is None:
            return None
        raise ConfigurationError(f"{TOKEN_FILE_VARIABLE}: {path} does not exist: write the token into it") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: the token cannot be read ({error}): make it readable for you") from None


def _checked(token: str, where: str) -> str:
    if not token.isascii() or not token.isprintable() or " " in token or not token:
        raise ConfigurationError(f"{where}: it holds no token: write the one line that breakaway token create printed")
    return token


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
