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
from valve.nameplate import Actuator, Nameplate, Signal

_STAND_IN: Final = Nameplate("the valve", Actuator(travel_m=1.0))  # percent of it are hundredths of a metre
_PERCENT_PA: Final = 1.0e3  # a command in percent or mA becomes so many Pa each, and back
_STAND_IN_SIGNAL: Final = Signal((4.0, 20.0), (0.0, 100.0 * _PERCENT_PA))
_NEEDS_SIGNAL: Final = "has no [signal]"
_NO_STEM: Final = "no column is surely position_m"
_LOOP_INSTEAD: Final = (
    "if the stem was not recorded, name the loop's columns instead: "
    '--map "controller_output=HEADER,process_value=HEADER"'
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
        if _NO_STEM in str(error):
            raise RecordingError(f"{error}; {_LOOP_INSTEAD}") from None
        if plate.signal is not None or _NEEDS_SIGNAL not in str(error):
            raise
        reading = read_own(path, replace(plate, signal=_STAND_IN_SIGNAL), mapping, in_service=True)
        percent_pa = _PERCENT_PA
        reading = _said(reading, {"command_pa": "percent of the signal", "command_ma": "percent of 4 to 20 mA"})
    if nameplate is not None:
        actuator = nameplate.actuator
        return reading, Scale(actuator.travel_m, actuator.diaphragm_area_m2, command_percent_pa=percent_pa)
    reading = _said(reading, {"position_m": "percent, the travel is not known"})
    columns = () if reading.understood is None else reading.understood.columns
    is_share = any(one.column == "position_m" and one.unit == "%" for one in columns)
    return reading, Scale(is_share=is_share, command_percent_pa=percent_pa)


def _of_the_store(path: Path, nameplate: Nameplate | None) -> tuple[Reading, Scale]:
    try:
        header, rows = read_watch_file(path)
    except OSError as error:
        raise RecordingError(f"{path}: it cannot be read ({error.strerror}): give an existing file") from error
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
