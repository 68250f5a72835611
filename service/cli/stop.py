"""``breakaway stop``: the valve of a test goes to its safe value at once."""

from __future__ import annotations

import asyncio
import getpass
import tomllib
from pathlib import Path
from typing import Annotated, Any, Final
from urllib.parse import quote

import httpx
import typer

from service.cli.client import service_client
from service.cli.standing import is_astray, is_moving, looked_at, stands_of
from service.model.acknowledgement import NOT_THERE
from service.model.run import RUN_ID
from service.model.stands_words import NOT_CONFIRMED
from valve.errors import ConfigurationError, MeasurementError, RequestError, WireError
from valve.messages import message_of, say

_OVER: Final = ("completed", "stopped", "failed", "interrupted", "analyzing")
_TIMEOUT_S: Final = 15.0  # the service waits 8 s for the safe value


def stop(
    what: Annotated[str, typer.Argument(metavar="TEST|TAG", help="A test's id, or the tag of the valve that moves.")],
    url: Annotated[
        str, typer.Option(metavar="URL", envvar="BREAKAWAY_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8321",
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="The plant file, on the gateway itself: its motion process stops the valve, also without the service.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Stop a test; exit code 0 only where its safe value was read back, and the stem is not known to be elsewhere.

    Where the stem still moves it is waited for, as long as plant.toml says.
    """
    if config is not None:
        _stop_here(what, config)
        return
    folder = "tests" if RUN_ID.fullmatch(what) else "valves"
    try:
        with service_client(url) as client:
            answer = client.post(f"/{folder}/{quote(what, safe='')}/stop", timeout=_TIMEOUT_S)
        test: dict[str, Any] = answer.json()
    except httpx.HTTPError as error:
        raise WireError(
            say(
                "no_answer_to_stop",
                "{url}: no answer ({why}): name the service by --url, or on the gateway itself the plant file by "
                "--config: its motion process stops a valve without the service; where that is gone, too, the "
                "watchdog of the valve's device makes it safe",
                url=str(url),
                why=message_of(error),
            )
        ) from None
    except ValueError:
        raise WireError(say("stop_answer_no_json", "{url}: its answer is no JSON: is it breakaway?", url=url)) from None
    if answer.is_error:
        raise RequestError(test.get("detail") or say("status", "status {status}", status=answer.status_code))
    if test["safe_confirmed"] is False:
        raise MeasurementError(
            say(
                "not_confirmed_of",
                "{valve}: {why}. {stands}",
                valve=test["valve"],
                why=test["error"],
                stands=stands_of(test),
            )
        )
    is_over = test["state"] in _OVER
    if test["safe_confirmed"] is None and not is_over:
        raise MeasurementError(
            say(
                "still_in_state",
                "{valve}: test {test} is still {state}: look at the valve",
                valve=test["valve"],
                test=test["id"],
                state=test["state"],
            )
        )
    state = test["state"] if is_over else "stopped, its samples are being fetched"
    if test["safe_confirmed"] is None and test["commanded"] is not False:
        raise MeasurementError(
            say(
                "ended_in_state",
                "{valve}: test {test} is {state}: {why}; look at the valve",
                valve=test["valve"],
                test=test["id"],
                state=test["state"],
                why=test["error"],
            )
        )
    told = f"{test['valve']}: test {test['id']} is {state}"
    if test["commanded"] is False:
        print(say("not_moved_by_it", "{told}, the valve was not moved by it", told=told))
        return
    print(f"{told}. {stands_of(test)}", flush=True)
    if is_moving(test) and is_over:
        with service_client(url) as client:
            test = looked_at(client, test)
        print(f"{test['valve']}: {stands_of(test)}")
    if is_astray(test):
        raise MeasurementError(say("stem_not_there", "{tag}: {alarm}", tag=test["valve"], alarm=NOT_THERE))


def _stop_here(what: str, config: Path) -> None:
    """Stop a valve by the motion process of this machine."""
    from drivers.motion.client import stopped_here
    from drivers.motion.local_socket import NAME

    try:  # no more than this is needed of a file that somebody may be editing
        store = tomllib.loads(config.read_text(encoding="utf-8"))["service"]["store"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            say(
                "store_unreadable",
                "{config}: service.store cannot be read ({why}): name the plant file",
                config=str(config),
                why=message_of(error),
            )
        ) from error
    who = getpass.getuser()
    ends = asyncio.run(
        stopped_here(
            (config.parent / store).resolve() / NAME,
            what,
            say("stopped_on_gateway", "stopped on the gateway by {who}", who=who),
        )
    )
    if not ends:
        raise RequestError(say("no_test_moves_it", "{what}: no test moves it: there is nothing to stop", what=what))
    for order, end in ends:
        if not end.outcome.safe_confirmed:
            why = end.outcome.why_unsafe or say("look_at_the_valve", "look at the valve")
            raise MeasurementError(
                say("unsafe_because", "{tag}: {alarm}: {why}", tag=order.tag, alarm=NOT_CONFIRMED, why=why)
            )
        print(
            say(
                "stopped_look_at_stem",
                "{tag}: test {test} is stopped, its safe value was read back; look at its stem",
                tag=order.tag,
                test=order.run_id,
            )
        )
