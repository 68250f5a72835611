"""``breakaway motion``: the process that moves valves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def motion(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
) -> None:
    """Move the valves of the plant of the file, as the service asks, until a signal ends it; they are made safe first.

    It goes on where the service ends: a test is then played to its end, and the service fetches it when it is back.
    """
    from importlib.metadata import version

    from drivers.motion.program import Moved, Place, run
    from service.config.settings import load_plant
    from service.server.logs import log_as_json

    def read() -> Moved:
        plant = load_plant(config)
        return Moved(plant.buses, {tag: valve.wiring for tag, valve in plant.valves.items() if plant.is_ours(tag)})

    log_as_json()
    service = load_plant(config).service
    place = Place.in_store(service.store, service.motion_socket, service.gateway)
    run(read, place, f"breakaway {version('breakaway')}")
