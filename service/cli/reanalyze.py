"""``breakaway reanalyze``: stored tests of a time analysed anew by a running service, watched to the end."""

from __future__ import annotations

import json
import sys
import time
from datetime import UTC, datetime
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from service.cli.client import asked, service_client
from valve.errors import MeasurementError, RequestError, WireError
from valve.messages import message_of, say

_LOOK_S: Final = 1.0
_LOST_S: Final = 300.0  # a service that is restarted, or upgraded, goes on with it
_SHOWN: Final = 5


def reanalyze(  # noqa: PLR0917 - typer takes options by position
    since: Annotated[
        str | None,
        typer.Option(metavar="DATE", help="Tests asked for then or later: 2026-11-01, or 2026-11-01T14:00+01:00."),
    ] = None,
    until: Annotated[str | None, typer.Option(metavar="DATE", help="Tests asked for before then.")] = None,
    valve: Annotated[str | None, typer.Option(metavar="TAG", help="Tests of this valve alone.")] = None,
    older: Annotated[bool, typer.Option("--older", help="Only those that an earlier engine analysed.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say how many tests are meant; change nothing.")] = False,
    stop: Annotated[
        int | None, typer.Option(metavar="NUMBER", min=1, help="Stop a re-analysis; what is done stays.")
    ] = None,
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8321",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of words.")] = False,
) -> None:
    """Analyse the stored recordings of a time anew with the version that the service runs; nothing moves.

    A date without a zone is UTC. The service goes on with it when this command ends or the service is restarted; the
    same command then shows how far it is. A result stands until the new one is there, and if that fails.
    """
    if (since is None) == (stop is None):
        raise typer.BadParameter("give --since DATE, or --stop NUMBER")
    with service_client(url) as client:
        if stop is not None:
            found = asked(client, "POST", f"/reanalyses/{stop}/stop")
            _print(found, as_json, _told(found))
            return
        wanted = {"since": _instant("--since", since), "until": _instant("--until", until), "valve": valve}
        body = {**{key: value for key, value in wanted.items() if value is not None}, "older_only": older}
        if dry_run:
            plan = asked(client, "POST", "/reanalyses", {**body, "dry_run": True})
            _print(plan, as_json, _planned(plan))
            return
        begun = asked(client, "POST", "/reanalyses", body)
        try:
            found = _watched(client, begun)
        except KeyboardInterrupt:
            raise RequestError(
                say(
                    "reanalysis_goes_on",
                    "re-analysis {number} goes on in the service: the same command shows how far it is, breakaway "
                    "reanalyze --stop {number} stops it",
                    number=begun["number"],
                )
            ) from None
    found["elsewhere"] = begun["elsewhere"]
    _print(found, as_json, _told(found))
    if found["state"] == "stopped":
        raise MeasurementError(
            say(
                "reanalysis_stopped",
                "re-analysis {number}: {person} stopped it",
                number=found["number"],
                person=found["stopped_by"],
            )
        )
    if found["tests"]["failed"]:
        raise MeasurementError(
            say(
                "analyses_failed",
                "{failed} of {all} analyses failed, former results stand",
                failed=found["tests"]["failed"],
                all=found["total"],
            )
        )


def _instant(option: str, text: str | None) -> str | None:
    if text is None:
        return None
    try:
        instant = datetime.fromisoformat(text)
        return (instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)).isoformat()
    except (ValueError, OverflowError):
        raise typer.BadParameter(
            say(
                "no_date",
                "{option} {text} is no date: write 2026-11-01 or 2026-11-01T14:00+01:00",
                option=option,
                text=repr(text[:40]),
            )
        ) from None


def _watched(client: Any, found: dict[str, Any]) -> dict[str, Any]:
    """Return a re-analysis when it has ended, with a bar meanwhile; a service that is away is waited for."""
    screen = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[said]}"))
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, *times, console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task(f"re-analysis {found['number']}", total=found["total"], completed=found["done"], said="")
        heard_s = time.monotonic()
        while found["state"] in ("queued", "running"):
            time.sleep(_LOOK_S)
            try:
                found = asked(client, "GET", found["href"])
                heard_s = time.monotonic()
                failed = found["tests"]["failed"]
                bar.update(task, completed=found["done"], said=f"{failed} failed" if failed else "")
            except WireError as error:
                if time.monotonic() - heard_s > _LOST_S:
                    raise WireError(
                        say(
                            "reanalysis_unwatched",
                            "{why} (re-analysis {number} goes on when the service is back; the same command shows "
                            "how far it is)",
                            why=message_of(error),
                            number=found["number"],
                        )
                    ) from None
                bar.update(task, said="the service does not answer, waiting")
    return found


def _print(found: dict[str, Any], as_json: bool, words: str) -> None:
    sys.stdout.write(json.dumps(found, indent=2) + "\n" if as_json else words)


def _elsewhere(found: dict[str, Any]) -> list[str]:
    return [
        say(
            "more_recordings_elsewhere",
            "{count} more have their recordings at gateway {gateway}: ask there, by --url",
            count=count,
            gateway=name or "(none)",
        )
        for name, count in found["elsewhere"].items()
    ]


def _lines(lines: list[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


def _planned(plan: dict[str, Any]) -> str:
    lines: list[str] = [
        say("would_be_analysed", "{tests} tests would be analysed anew; nothing was changed", tests=plan["tests"])
    ]
    if plan["queued_already"]:
        lines.append(say("queued_by_other", "{n} more are queued by another re-analysis", n=plan["queued_already"]))
    if plan["without_recording"]:
        lines.append(say("without_recording", "{n} more have no recording any more", n=plan["without_recording"]))
    return _lines([*lines, *_elsewhere(plan)])


def _told(found: dict[str, Any]) -> str:
    lines: list[str] = [
        say(
            "reanalysis_stands",
            "re-analysis {number}, {software}: {all} tests, {counts:, }",
            number=found["number"],
            software=found["software"],
            all=found["total"],
            counts=tuple(f"{count} {state}" for state, count in found["tests"].items() if count),
        )
    ]
    lines += [
        say(
            "trouble",
            "  {test} {valve} {state}: {why}",
            test=one["test"],
            valve=one["valve"],
            state=one["state"],
            why=one["reason"],
        )
        for one in found["troubles"][:_SHOWN]
    ]
    if len(found["troubles"]) > _SHOWN:
        lines.append(say("and_others", "  and others: GET {address}", address=found["href"]))
    return _lines([*lines, *_elsewhere(found)])
