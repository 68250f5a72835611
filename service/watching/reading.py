"""Reads a record of normal operation, with or without a nameplate, and says which units that leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from drivers.motion.watch_file import SUFFIX, read_watch_file
from estimators.in_service.result import Scale
from service.own_files.reader import read_own
from service.own_files.understood import Reading
from service.watching.day import recording_of
from valve.errors import RecordingError
from valve.messages import joined, message_of, messages_in, say
from valve.nameplate import Actuator, Nameplate, Signal

_STAND_IN: Final = Nameplate("the valve", Actuator(travel_m=1.0))  # percent of it are hundredths of a metre
_PERCENT_PA: Final = 1.0e3  # a command in percent or mA becomes so many Pa each, and back
_STAND_IN_SIGNAL: Final = Signal((4.0, 20.0), (0.0, 100.0 * _PERCENT_PA))
# Codes of what ``read_own`` says.
_NEEDS_SIGNAL: Final = frozenset({"nameplate_without_signal", "column_needs_signal"})
_NO_COLUMN: Final = "no_column_surely"
_STEM: Final = "position_m"
_LOOP_INSTEAD: Final = say(
    "name_loops_columns",
    "if the stem was not recorded, name the loop's columns instead: "
    '--map "controller_output=HEADER,process_value=HEADER"',
)


def read_in_service(path: Path, nameplate: Nameplate | None, mapping: Mapping[str, str]) -> tuple[Reading, Scale]:
    """Return the recording of a file and its scale.

    Without a nameplate, or with one that lacks ``[signal]``, percent stay percent. A day's file of the store is read,
    too. Raises RecordingError as ``read_own``.
    """
    if path.suffix == SUFFIX:
        return _of_the_store(path, nameplate)
    plate = nameplate or _STAND_IN
    percent_pa: float | None = None
    try:
        reading = read_own(path, plate, mapping, in_service=True)
    except RecordingError as error:
        said = list(messages_in(message_of(error)))
        without = [one.values["names"] for one in said if one.code == _NO_COLUMN]
        if any(isinstance(names, tuple) and names[0] == _STEM for names in without):
            raise RecordingError(joined("; ", (message_of(error), _LOOP_INSTEAD))) from None
        if plate.signal is not None or not any(one.code in _NEEDS_SIGNAL for one in said):
            raise
        reading = read_own(path, replace(plate, signal=_STAND_IN_SIGNAL), mapping, in_service=True)
        percent_pa = _PERCENT_PA
        reading = _said(
            reading,
            {
                "command_pa": say("percent_of_signal", "percent of the signal"),
                "command_ma": say("percent_of_current", "percent of 4 to 20 mA"),
            },
        )
    if nameplate is not None:
        actuator = nameplate.actuator
        return reading, Scale(actuator.travel_m, actuator.diaphragm_area_m2, command_percent_pa=percent_pa)
    reading = _said(reading, {"position_m": say("percent_of_unknown_travel", "percent, the travel is not known")})
    columns = () if reading.understood is None else reading.understood.columns
    is_share = any(one.column == "position_m" and one.unit == "%" for one in columns)
    return reading, Scale(is_share=is_share, command_percent_pa=percent_pa)


def _of_the_store(path: Path, nameplate: Nameplate | None) -> tuple[Reading, Scale]:
    try:
        header, rows = read_watch_file(path)
    except OSError as error:
        raise RecordingError(
            say(
                "day_unreadable",
                "{path}: it cannot be read ({why}): give an existing file",
                path=str(path),
                why=error.strerror or "",
            )
        ) from error
    actuator = None if nameplate is None else nameplate.actuator
    scale = Scale() if actuator is None else Scale(actuator.travel_m, actuator.diaphragm_area_m2)
    return Reading(recording_of(rows, str(header.get("valve", path.name)))), scale


def _said(reading: Reading, words: Mapping[str, str]) -> Reading:
    """Return what was understood in other words for these columns, where the stand-in's would mislead."""
    if reading.understood is None:
        return reading
    columns = tuple(
        replace(one, how=words[one.column]) if one.column in words and one.unit in ("%", "mA") else one
        for one in reading.understood.columns
    )
    return replace(reading, understood=replace(reading.understood, columns=columns))
