"""``breakaway analyze --report``: the report of recordings that no service has stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from service.cli.output import STANDARD_OUTPUT, require_writable
from valve.errors import RequestError
from valve.messages import say
from valve.nameplate import Nameplate

_KINDS: Final = (".pdf", ".html")


def require_report_name(target: str | None) -> None:
    """Raise RequestError where no report can be written to ``target``: said before the work is done, not after."""
    if target is None:
        return
    if target == STANDARD_OUTPUT or Path(target).suffix.lower() not in _KINDS:
        raise RequestError(
            say(
                "report_file_name",
                "{target}: a report is a PDF or an HTML file: name it x.pdf or x.html",
                target=str(target),
            )
        )
    require_writable(target)


def write_report(
    target: str, recordings: Sequence[Path], valve: Nameplate, plate_file: str, analysis: Mapping[str, Any]
) -> None:
    """Write the report of an analysis; ``plate_file`` is where the nameplate stands.

    Raises RequestError where the file cannot be written.
    """
    from service.figures.signature import Frame
    from service.report.source import ReportSource
    from service.report.valve_facts import nameplate_facts
    from service.report.written import report_html, report_pdf
    from service.words.reader import Reader
    from valve.recording_files import file_sha256

    facts = [(f"Recording {path.name}, SHA-256", file_sha256(path)) for path in recordings]
    facts += [("Nameplate", plate_file), ("Software", f"breakaway {version('breakaway')}")]
    facts += [("Analysis", str(analysis["schema"])), ("Written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC")]
    names = ", ".join(path.name for path in recordings)
    told = tuple(nameplate_facts(valve, Reader()))
    frame = Frame(valve.actuator.travel_m, valve.actuator.bench_set_pa)
    source = ReportSource(valve.tag, f"recording {names}", analysis, tuple(facts), valve=told, frame=frame)
    write = report_pdf if Path(target).suffix.lower() == ".pdf" else report_html
    try:
        Path(target).write_bytes(write(source))
    except OSError as error:
        raise RequestError(
            say(
                "report_unwritable",
                "{target}: it cannot be written ({reason}): give another file name",
                target=str(target),
                reason=str(error.strerror),
            )
        ) from None
