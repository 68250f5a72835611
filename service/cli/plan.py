"""``breakaway plan``: what a test would tell of a valve, before anything moves."""

from __future__ import annotations

import ipaddress
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final
from urllib.parse import quote

import typer

from service.cli.client import service_client
from service.cli.output import STANDARD_OUTPUT, write_json
from service.cli.overrides import read_overrides
from valve.errors import NotFoundError, RequestError
from valve.messages import say

if TYPE_CHECKING:
    from service.config.plant import Plant

ALL: Final = "all"
_TIMEOUT_S: Final = 3.0  # a plan does without the service


def plan(  # noqa: PLR0917 - typer takes options by position
    tag: Annotated[str, typer.Argument(metavar="TAG", help="The valve's tag, as plant.toml has it.")],
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    sequence: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="One of multi_rate, triangle, sine, steps, dwell, small_loops, diagnostic; all compares them.",
        ),
    ] = ALL,
    override: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Change the sequence, as a test's overrides do: cycles=2."),
    ] = None,
    noise_um: Annotated[
        float | None, typer.Option(metavar="UM", min=1.0e-6, help="Noise of the position, um rms.", show_default=False)
    ] = None,
    lag_s: Annotated[
        float | None, typer.Option(metavar="S", min=1.0e-3, max=30.0, help="Lag of the I/P, s.", show_default=False)
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            envvar="BREAKAWAY_URL",
            help="Address of the service that knows the valve's last test; by default the plant file's.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> None:
    """Say how well each sequence would tell a valve's parameters, how long it takes and how fast it moves."""
    from service.config.settings import load_plant

    plant = load_plant(config)
    if tag not in plant.valves:
        raise NotFoundError(
            say(
                "valve_not_in_plant",
                "valve {tag} is unknown: {file} has {known:, }",
                tag=repr(tag[:64]),
                file=config.name,
                known=tuple(plant.valves),
            )
        )
    if override and sequence == ALL:
        raise RequestError(
            say(
                "override_of_one_sequence",
                "--override changes one sequence, and all are compared: name it by --sequence",
            )
        )
    overrides = read_overrides(override or ())
    from service.model.sequences import SEQUENCES
    from service.planning.expected_valve import expected_valve
    from service.planning.planning import plan_document, plan_sequence

    names = list(SEQUENCES) if sequence == ALL else [sequence]
    if names[0] not in SEQUENCES:
        raise RequestError(
            say(
                "sequence_unknown_or_all",
                "sequence {sequence} is unknown: choose one of {known:, }, or {all}",
                sequence=repr(names[0][:64]),
                known=tuple(SEQUENCES),
                all=ALL,
            )
        )
    last_test, why_none = _last_test(plant, tag, url)
    noise_m = None if noise_um is None else 1.0e-6 * noise_um
    valve = plant.valves[tag]
    expected = expected_valve(valve, last_test, why_none=why_none, noise_m=noise_m, lag_s=lag_s)
    plans = [plan_sequence(valve, expected, name, overrides) for name in names]
    document = plan_document(valve, expected, plans)
    if as_json:
        write_json(STANDARD_OUTPUT, document)
    else:
        from rich.console import Console

        from service.cli.plan_tables import print_plan

        print_plan(Console(), document)
    if not any(one["possible"] for one in document["sequences"]):
        raise RequestError(document["sequences"][0]["message"])


def _last_test(plant: Plant, tag: str, url: str | None) -> tuple[dict[str, Any] | None, str]:
    """Return the valve's last completed test as the service has it, or None and why."""
    import httpx

    if url is None:
        address, scheme = ipaddress.ip_address(plant.service.bind), "https" if plant.service.access.tls_key else "http"
        # a service that listens on every address also listens on this machine's own
        host = "127.0.0.1" if address.is_unspecified else str(address)
        url = f"{scheme}://{f'[{host}]' if address.version == 6 else host}:{plant.service.port}"
    try:
        with service_client(url) as client:
            answer = client.get(f"/valves/{quote(tag, safe='')}", timeout=_TIMEOUT_S)
        content = answer.json() if answer.is_success else None
    except (httpx.HTTPError, ValueError):
        return None, say("no_service_to_ask", "no service at {url} to ask for its last test", url=url)
    if answer.status_code in (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN):
        return None, say(
            "service_tells_nobody",
            "the service at {url} tells its last test to nobody without a token that may see it",
            url=url,
        )
    if not isinstance(content, dict) or "last_result" not in content:
        return None, say("service_knows_no_valve", "the service at {url} does not know the valve", url=url)
    last = content["last_result"]
    return (None, "it has not been tested yet") if last is None else (last, "")
