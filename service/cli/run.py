"""``breakaway run``: one test through the REST interface, watched to its end."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Annotated, Any, Final
from urllib.parse import quote

import httpx
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from service.cli.analysis_tables import print_analysis
from service.cli.client import asked, service_client
from service.cli.overrides import read_overrides
from service.cli.signals import ended_by_signals, signals_held_back
from service.cli.standing import is_astray, looked_at, stands_of
from service.model.acknowledgement import NOT_THERE
from service.model.run import Label
from service.model.until import early_words, pairs_of
from service.words.messages import in_units
from service.words.sentences import together, without
from service.words.units import UnitSystem
from valve.errors import MeasurementError, WireError
from valve.messages import TABLE, restored, say

_RECONNECTIONS: Final = 5
_NO_REASON: Final = say("no_reason_given", "no reason given")
_ENDED: Final = {
    "failed": say("ended_failed", "failed"),
    "stopped": say("ended_stopped", "was stopped"),
    "interrupted": say("ended_interrupted", "was interrupted"),
}


def run(
    tag: Annotated[str, typer.Argument(metavar="TAG", help="The valve's tag, as plant.toml has it.")],
    sequence: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="How it moves: multi_rate, triangle, sine, steps, dwell, small_loops, diagnostic, or separating where "
            "the last diagnosis asks for it. By default multi_rate, or triangle where the limits do not allow it.",
        ),
    ] = None,
    *,
    override: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="Change the sequence: cycles=2. Repeat it.")
    ] = None,
    label: Annotated[Label | None, typer.Option(help="What the test stands for beside a repair.")] = None,
    permit: Annotated[
        str | None, typer.Option(metavar="NUMBER", help="The work permit, where the valve demands one.")
    ] = None,
    until: Annotated[
        list[str] | None,
        typer.Option(metavar="SYMBOL=PERCENT", help="End once this is known: F_s=5%, F_c=2%, k=1%. Repeat it."),
    ] = None,
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8321",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the test as one JSON object instead of tables.")
    ] = False,
) -> None:
    """Run one test of one valve and print the methods' estimates and the diagnosis. Ctrl-C stops the test."""
    wanted = {"valve": tag, "sequence": sequence, "label": label, "permit": permit, "until": pairs_of(until or ())}
    overrides = read_overrides(override or ())
    with service_client(url) as client, ended_by_signals():
        location = ""
        try:
            with signals_held_back():  # a test that was accepted and not heard of could not be stopped
                location = _start(client, wanted | {"overrides": overrides or None})
            _watch(client, location, tag)
        except KeyboardInterrupt:
            stopped = asked(client, "POST", f"{location}/stop")
            raise MeasurementError(
                say(
                    "stopped_on_request",
                    "{tag}: the test was stopped on request. {stands}",
                    tag=tag,
                    stands=stands_of(stopped),
                )
            ) from None
        test = looked_at(client, asked(client, "GET", location))
    if as_json:
        sys.stdout.write(json.dumps(test, indent=2) + "\n")
    if test["state"] != "completed":
        raise MeasurementError(
            say(
                "test_without_result",
                "{tag}: the test {ended}: {reason}",
                tag=tag,
                ended=_ENDED.get(test["state"]) or say("is_in_state", "is {state}", state=test["state"]),
                reason=_reason(test),
            )
        )
    if not as_json:
        _print_test(Console(), test)
    if is_astray(test):
        raise MeasurementError(say("stem_not_there", "{tag}: {alarm}", tag=tag, alarm=NOT_THERE))


def _start(client: httpx.Client, wanted: dict[str, Any]) -> str:
    said = {name: value for name, value in wanted.items() if value is not None}
    test = asked(client, "POST", "/tests/run", said)
    return f"/tests/{quote(test['id'], safe='')}"


def _watch(client: httpx.Client, location: str, tag: str) -> None:
    """Follow the test to its end; a broken stream is taken up where it broke."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[phase]}"))
    screen = Console(stderr=True)
    with Progress(*columns, TimeElapsedColumn(), console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task(escape(tag), total=1.0, phase="queued")
        last, broken = "0", 0
        while True:
            try:
                for number, kind, data in _events(client, location, last):
                    last, broken = number, 0
                    if kind == "progress":
                        bar.update(task, completed=data["progress"], phase=data["phase"])
                    elif kind == "end":
                        bar.update(task, phase=data["state"], completed=1.0 if data["state"] == "completed" else None)
                        return
            except httpx.HTTPError as error:
                problem = str(error) or type(error).__name__
            else:
                problem = say("stream_ended", "the stream ended before the test")
            broken += 1
            if broken > _RECONNECTIONS:
                raise WireError(
                    say(
                        "service_not_heard",
                        "{tag}: the service is no longer heard ({why}): see {url}{path}",
                        tag=tag,
                        why=problem,
                        url=str(client.base_url),
                        path=location,
                    )
                )


def _events(client: httpx.Client, location: str, last: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Events of the stream as (id, kind, data)."""
    fields: dict[str, str] = {}
    with client.stream("GET", f"{location}/events", headers={"Last-Event-ID": last}) as answer:
        answer.raise_for_status()
        for line in answer.iter_lines():
            if line:
                name, _, value = line.partition(": ")
                fields[name] = value
            elif "data" in fields:
                yield fields["id"], fields["event"], json.loads(fields["data"])
                fields = {}


def _reason(test: dict[str, Any]) -> str:
    said = restored({"error": test["error"], TABLE: test.get(TABLE)})["error"]
    reason = in_units(without(said, test["valve"]) or _NO_REASON, UnitSystem.SI)
    return together([say("why_no_result", "{reason}.", reason=reason), stands_of(test)])


def _print_test(console: Console, test: dict[str, Any]) -> None:
    played = say(
        "played", "{tag}: {sequence}, test {test}.", tag=test["valve"], sequence=test["sequence"], test=test["id"]
    )
    console.print(Text(together([played, stands_of(test)], " ")))
    if early := early_words(test.get("until"), test.get("ended_early")):
        console.print(Text(early))
    print_analysis(console, restored(test["analysis"]), test["sequence"])
