"""``breakaway reload``: a running service reads its plant file again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import typer

from service.cli.client import asked, service_client
from valve.messages import say

_NAMED: Final = 5


def reload(
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8321",
) -> None:
    """Have a running service read its plant file again; a file with a fault changes nothing, exit code 1.

    A valve under test keeps its configuration until its test ends.
    """
    with service_client(url) as client:
        told = asked(client, "POST", "/plant/reload")
    for kind in ("valves", "schedules"):
        changed = [f"{_few(names)} {word}" for word, names in told[kind].items() if names]
        print(f"{kind}: {'; '.join(changed) or 'as they were'}")
    if told["buses_added"]:
        print(f"buses: added {', '.join(told['buses_added'])}")
    for tag in told["waiting"]:
        print(
            say("keeps_configuration", "{tag} is under test: it keeps its configuration until the test ends", tag=tag)
        )
    for key in told["needs_restart"]:
        print(f"needs a restart: {key}")


def _few(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
