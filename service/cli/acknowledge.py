"""``breakaway acknowledge``: somebody has looked at the valve of a test that ended badly."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote

import typer

from service.cli.client import asked, service_client
from service.model.run import RUN_ID
from valve.errors import RequestError
from valve.messages import say


def acknowledge(
    what: Annotated[str, typer.Argument(metavar="TEST|TAG", help="A test's id, or the tag of the valve.")],
    note: Annotated[str, typer.Option(metavar="TEXT", help="What was found at the valve; it is kept with the test.")],
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8321",
) -> None:
    """Say that somebody looked at a valve whose test ended badly: then its next test may start."""
    with service_client(url) as client:
        test_id = what
        if not RUN_ID.fullmatch(what):
            newest = asked(client, "GET", f"/tests?valve={quote(what, safe='')}&limit=1")["tests"]
            if not newest:
                raise RequestError(
                    say(
                        "no_test_to_acknowledge",
                        "{what}: no test of a valve with this tag: name the valve as plant.toml does",
                        what=what,
                    )
                )
            test_id = newest[0]["id"]
        test = asked(client, "POST", f"/tests/{quote(test_id, safe='')}/acknowledge", {"note": note})
    print(
        say(
            "is_acknowledged",
            "{valve}: test {test} ({state}) is acknowledged: the next test may start",
            valve=test["valve"],
            test=test["id"],
            state=test["state"],
        )
    )
