"""How a command speaks to a running service: its address, and a token where the service wants one."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Any, Final

import httpx

from valve.errors import ConfigurationError, RequestError, WireError
from valve.messages import from_json, message_of, say

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
        raise RequestError(
            say(
                "url_no_address",
                "--url {url} is no address ({why}): give one such as http://127.0.0.1:8321",
                url=repr(url),
                why=message_of(error),
            )
        ) from None
    token = own_token()
    if token is None:
        return httpx.Client(base_url=url, timeout=_TIMEOUT)
    if parsed.scheme == "http" and not _is_local(parsed.host):
        raise RequestError(
            say("token_unencrypted", "--url {url}: the token would cross the network unencrypted: use https", url=url)
        )
    return httpx.Client(base_url=url, timeout=_TIMEOUT, headers={"Authorization": f"Bearer {token}"})


def _refused(problem: dict[str, Any], status: int) -> str:
    """Return why the service refuses, as the message that it was made of where it sends that."""
    made_of = problem.get("message")
    if isinstance(made_of, dict) and {"code", "template", "values"} <= made_of.keys():
        return from_json(made_of)
    return str(problem["detail"]) if "detail" in problem else say("status", "status {status}", status=status)


def asked(client: httpx.Client, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return what the service answers as JSON. Raises WireError where it does not, RequestError where it refuses."""
    try:
        answer = client.request(method, path, json=body)
    except httpx.HTTPError as error:
        raise WireError(
            say(
                "no_answer_of_service",
                "{url}: no answer ({why}): start it by breakaway serve, or name it by --url",
                url=str(client.base_url),
                why=message_of(error),
            )
        ) from None
    try:
        content: dict[str, Any] = answer.json()
    except ValueError:
        raise WireError(
            say(
                "answer_no_json",
                "{url}: its answer is no JSON ({status}): is it breakaway?",
                url=str(client.base_url),
                status=answer.status_code,
            )
        ) from None
    if answer.is_error:
        raise RequestError(_refused(content, answer.status_code))
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
            raise ConfigurationError(
                say(
                    "token_readable_by_others",
                    "{path}: others may read this token (mode {mode:o}): chmod 600 {path}",
                    path=str(path),
                    mode=mode,
                )
            )
        return _checked(path.read_text(encoding="utf-8").strip(), str(path))
    except FileNotFoundError:
        if named is None:
            return None
        raise ConfigurationError(
            say(
                "token_file_missing",
                "{variable}: {path} does not exist: write the token into it",
                variable=TOKEN_FILE_VARIABLE,
                path=str(path),
            )
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(
            say(
                "token_unreadable",
                "{path}: the token cannot be read ({why}): make it readable for you",
                path=str(path),
                why=message_of(error),
            )
        ) from None


def _checked(token: str, where: str) -> str:
    if not token.isascii() or not token.isprintable() or " " in token or not token:
        raise ConfigurationError(
            say(
                "no_token_in_file",
                "{where}: it holds no token: write the one line that breakaway token create printed",
                where=str(where),
            )
        )
    return token


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
