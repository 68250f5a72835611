"""``breakaway serve``: the service as a process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
) -> None:
    """Serve the plant of the file until a signal or a closed terminal ends it; running tests are made safe."""
    from service.config.settings import load_plant

    plant = load_plant(config)
    from service.server.logs import log_as_json
    from service.server.server import serve_plant

    log_as_json()
    serve_plant(plant)
