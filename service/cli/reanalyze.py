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
                f"re-analysis {begun['number']} goes on in the service: the same command shows how far it is, "
                f"breakaway reanalyze --stop {begun['number']} stops it"
            ) from None
    found["elsewhere"] = begun["elsewhere"]
    _print(found, as_json, _told(found))
    if found["state"] == "stopped":
        raise MeasurementError(f"re-analysis {found['number']}: {found['stopped_by']} stopped it")
    if found["tests"]["failed"]:
        raise MeasurementError(f"{found['tests']['failed']} of {found['total']} analyses failed, former results stand")


def _instant(option: str, text: str | None) -> str | None:
    if text is None:
        return None
    try:
        instant = datetime.fromisoformat(text)
        return (instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)).isoformat()
    except (ValueError, OverflowError):
        raise typer.BadParameter(
            f"{option} {text[:40]!r} is no date: write 2026-11-01 or 2026-11-01T14:00+01:00"
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
                        f"{error} (re-analysis {found['number']} goes on when the service is back; the same command "
                        "shows how far it is)"
                    ) from None
                bar.update(task, said="the service does not answer, waiting")
    return found


def _print(found: dict[str, Any], as_json: bool, words: str) -> None:
    sys.stdout.write(json.dumps(found, indent=2) + "\n" if as_json else words)


def _elsewhere(found: dict[str, Any]) -> str:
    return "".join(
        f"{count} more have their recordings at gateway {name or '(none)'}: ask there, by --url\n"
        for name, count in found["elsewhere"].items()
    )


def _planned(plan: dict[str, Any]) -> str:
    lines = f"{plan['tests']} tests would be analysed anew; nothing was changed\n"
    if plan["queued_already"]:
        lines += f"{plan['queued_already']} more are queued by another re-analysis\n"
    if plan["without_recording"]:
        lines += f"{plan['without_recording']} more have no recording any more\n"
    return lines + _elsewhere(plan)


def _told(found: dict[str, Any]) -> str:
    counts = ", ".join(f"{count} {state}" for state, count in found["tests"].items() if count)
    lines = f"re-analysis {found['number']}, {found['software']}: {found['total']} tests, {counts}\n"
    for one in found["troubles"][:_SHOWN]:
        lines += f"  {one['test']} {one['valve']} {one['state']}: {one['reason']}\n"
    if len(found["troubles"]) > _SHOWN:
        lines += f"  and others: GET {found['href']}\n"
    return lines + _elsewhere(found)
