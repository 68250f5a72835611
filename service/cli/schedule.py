"""``breakaway schedule``: the coming night as a table, or a schedule run at once."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import quote

import typer

from valve.errors import RequestError, WireError
from valve.messages import message_of, say

if TYPE_CHECKING:
    from service.config.plant import Plant
    from service.schedules.plan import PlannedCheck


class Action(StrEnum):
    """What to do."""

    SHOW = "show"
    RUN = "run"


def schedule(  # noqa: PLR0917 - typer takes options by position
    action: Annotated[Action, typer.Argument(metavar="show|run", help="Show the coming night, or run a schedule now.")],
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="The schedule: needed by run.", show_default=False)
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="The plant file: needed by show.", show_default=False),
    ] = None,
    hours: Annotated[float, typer.Option(metavar="H", min=0.1, max=744.0, help="How far ahead to show.")] = 24.0,
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service that run asks.")
    ] = "http://127.0.0.1:8321",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")] = False,
) -> None:
    """Show what the schedules of a plant file will check and when, with no service; or run one now through REST."""
    if action is Action.RUN:
        if name is None:
            raise RequestError(
                say("schedule_needs_name", "schedule run needs the name of a schedule: schedule show lists them")
            )
        _run(name, url, as_json)
        return
    if config is None:
        raise RequestError(say("schedule_needs_file", "schedule show needs the plant file: give --config plant.toml"))
    from service.config.settings import load_plant
    from service.schedules.plan import plan_night

    plant = load_plant(config)
    if name is not None and name not in {one.name for one in plant.schedules}:
        known = ", ".join(one.name for one in plant.schedules) or "none"
        raise RequestError(
            say(
                "schedule_not_in_file",
                "schedule {name} is unknown: {file} has {known}",
                name=repr(name[:64]),
                file=config.name,
                known=known,
            )
        )
    now = datetime.now(UTC)
    checks = plan_night(plant, now, now + timedelta(hours=hours))
    chosen = [check for check in checks if name in (None, check.schedule)]
    if as_json:
        sys.stdout.write(json.dumps({"checks": [_as_json(check) for check in chosen]}, indent=2) + "\n")
    else:
        _print(plant, chosen, hours)


def _as_json(check: PlannedCheck) -> dict[str, Any]:
    return {
        "valve": check.valve,
        "schedule": check.schedule,
        "gateway": check.gateway,
        "bus": check.bus,
        "sequence": check.sequence,
        "due_at": check.due_at.isoformat(),
        "starts_at": check.starts_at.isoformat(),
        "ends_at": check.ends_at.isoformat(),
        "window_ends_at": check.window_ends_at.isoformat(),
        "fits": check.fits,
    }


def _print(plant: Plant, checks: list[PlannedCheck], hours: float) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not plant.schedules:
        console.print(
            say(
                "no_schedules",
                "{file} has no [[schedules]]: docs/nightly.md says how to plan a night.",
                file=plant.file.name,
            ),
            markup=False,
        )
        return
    if not checks:
        console.print(say("nothing_due", "Nothing is due within {hours:g} h.", hours=hours))
        return
    zones = {schedule.name: schedule.zone for schedule in plant.schedules}
    is_one_zone = len({zones[check.schedule] for check in checks}) == 1
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("Starts about", no_wrap=True)
    for heading in ("Valve", "Bus", "Sequence", "Ends", "Window ends", "Schedule"):
        table.add_column(heading, overflow="fold")  # a name is never cut
    for check in checks:
        zone = zones[check.schedule]
        start = Text(f"{check.starts_at.astimezone(zone):%a %Y-%m-%d %H:%M}")
        if not check.fits:
            start.append(" too late", style="bold")
        bus = f"{check.gateway}/{check.bus}" if check.gateway else check.bus
        ends, window = (f"{one.astimezone(zone):%H:%M}" for one in (check.ends_at, check.window_ends_at))
        schedule = check.schedule if is_one_zone else f"{check.schedule} ({zone.key})"
        table.add_row(start, check.valve, bus, check.sequence, ends, window, schedule)
    console.print(table)
    if is_one_zone:
        console.print(say("times_of_zone", "Times are those of {zone}.", zone=zones[checks[0].schedule].key))
    late = [check.valve for check in checks if not check.fits]
    if late:
        console.print(
            say(
                "checks_too_late",
                "{count} of {all} checks will come after their window and be skipped ({tags:, }): shorten the tests, "
                "widen window_s, or move valves to another schedule.",
                count=len(late),
                all=len(checks),
                tags=tuple(late[:5]),
            )
        )


def _run(name: str, url: str, as_json: bool) -> None:
    import httpx

    from service.cli.client import service_client

    with service_client(url) as client:
        try:
            answer = client.post(f"/schedules/{quote(name, safe='')}/run")
        except httpx.HTTPError as error:
            raise WireError(
                say(
                    "no_answer_of_service",
                    "{url}: no answer ({why}): start it by breakaway serve, or name it by --url",
                    url=url,
                    why=message_of(error),
                )
            ) from None
    try:
        last = answer.json()
    except ValueError:
        raise WireError(
            say(
                "answer_no_json",
                "{url}: its answer is no JSON ({status}): is it breakaway?",
                url=url,
                status=answer.status_code,
            )
        ) from None
    if answer.is_error:
        raise RequestError(str(last.get("detail", f"status {answer.status_code}")))
    if as_json:
        sys.stdout.write(json.dumps(last, indent=2) + "\n")
    elif last is None:
        print(say("no_valve_in_schedule", "{name}: no valve of this gateway is in it", name=name))
    else:
        states = ", ".join(f"{count} {state}" for state, count in last["states"].items())
        print(
            say(
                "schedule_was_run",
                "{name}: {states}; GET {url}/schedules/night says how each goes",
                name=name,
                states=states,
                url=url,
            )
        )
