"""``breakaway simulate``: the plant's valves as Modbus slaves, from the file that the service reads."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TextIO

import typer

from valve.errors import ConfigurationError, RequestError
from valve.messages import say

if TYPE_CHECKING:
    from simulator.assembly import SimulatedPlant

# Nobody needs to read: a valve's log goes on, so that it shows what happened after the last request.
_LOOK_EVERY_S: Final = 0.1
# Without a log too: a night of a stem on bristles, made up at the first read, takes seconds and every valve waits;
# and a record's truth is told soon after its end.
_CATCH_UP_EVERY_S: Final = 2.0


def simulate(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    *,
    speed: Annotated[float, typer.Option("--speed", metavar="N", help="Run the valves' clock N times faster.")] = 1.0,
    log: Annotated[
        Path | None, typer.Option("--log", metavar="FILE", help="Write every event and position there, JSON lines.")
    ] = None,
    truths: Annotated[
        Path | None,
        typer.Option("--truths", metavar="FILE", help="Write what it says of each test there too, JSON lines."),
    ] = None,
    tls_certificate: Annotated[
        Path | None, typer.Option("--tls-certificate", metavar="FILE", help="Certificate of simulated TLS devices.")
    ] = None,
    tls_key: Annotated[Path | None, typer.Option("--tls-key", metavar="FILE", help="Its private key.")] = None,
) -> None:
    """Serve the plant's valves as Modbus slaves and gauges until SIGTERM or SIGINT.

    Says for each test that ends what its valve truly was, as an estimate is judged: F_c and F_0 averaged over the
    travel swept and the time recorded, F_s the mean of the breakaways that it might have had.
    """
    # heavy imports stand here: --help and wrong usage do without
    import uvloop

    from drivers.addresses import Mode
    from service.cli.simulated_plant import ServerCertificate, plant_from_settings
    from service.config.settings import load_plant

    if (tls_certificate is None) != (tls_key is None):
        raise ConfigurationError(
            say("tls_files_together", "--tls-certificate and --tls-key belong together, give both")
        )
    certificate = None if tls_certificate is None or tls_key is None else ServerCertificate(tls_certificate, tls_key)
    settings = load_plant(config)
    polled = [tag for tag, valve in settings.valves.items() if valve.wiring.acquisition.mode is Mode.POLLED]
    if speed != 1.0 and polled:
        raise ConfigurationError(
            say(
                "speed_of_polled",
                "{config}: --speed is {speed:g} and {polled:, } have acquisition.mode = polled: such a test plays by "
                "the service's clock and would see another valve; leave --speed out, or say captured",
                config=str(config),
                speed=speed,
                polled=tuple(polled),
            )
        )
    plant = plant_from_settings(settings, speed, certificate)
    uvloop.run(_serve(plant, log, truths))


async def _serve(plant: SimulatedPlant, log: Path | None, truths: Path | None = None) -> None:
    """Serve until a signal comes. Raises ConfigurationError where an address cannot be had."""
    from service.cli.truths import record_truth, write_truth
    from simulator.record import RecordFile
    from simulator.samples import EndedRecord

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    with contextlib.ExitStack() as stack:
        told = None if truths is None else stack.enter_context(_added_to(truths))

        def tell(tag: str, ended: EndedRecord) -> None:
            truth = record_truth(tag, ended)
            print(truth.in_words(), flush=True)
            if told is not None:
                write_truth(told, truth)

        if log is not None:
            file = RecordFile(stack.enter_context(_added_to(log)))
            for record in plant.records.values():
                file.attach(record)
        try:
            await plant.start(_CATCH_UP_EVERY_S if log is None else _LOOK_EVERY_S)
            for address, served in zip(plant.addresses, plant.descriptions, strict=True):
                print(f"{address}: {served}", flush=True)
            plant.tell_of_records(tell)
            await stopped.wait()
        finally:
            await plant.stop()


def _added_to(path: Path) -> TextIO:
    """Return a file to which lines are added. Raises RequestError where it cannot be written."""
    try:
        return path.open("a", encoding="utf-8")
    except OSError as error:
        raise RequestError(
            say(
                "log_unwritable",
                "{log}: the log cannot be written there ({reason}): give another file",
                log=str(path),
                reason=str(error.strerror),
            )
        ) from error
