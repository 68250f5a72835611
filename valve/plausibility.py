"""Wrong units: what a recording cannot be, given the valve's nameplate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from valve.errors import RecordingError
from valve.messages import Message, say
from valve.nameplate import Action, Nameplate
from valve.recording import FloatArray
from valve.units import METRE_PER_INCH, PASCAL_PER_BAR, PASCAL_PER_PSI

# Own choices. A stem cannot leave its travel; 3 times leaves room for a nameplate that names the rated part only.
_MOST_TRAVELS: Final = 3.0
_LEAST_MOVED: Final = 0.01  # of the travel: below it nothing says that a low pressure is wrong
_LEAST_PRESSURE: Final = 0.01  # of the signal's upper end: air at 1 % of it moves no stem
_MOST_PRESSURES: Final = 50.0
_LIKELY: Final = (0.2, 2.5)  # a unit is likely when the value read in it is this share of what is expected
_NEARLY_PERCENT: Final = 50.0
_MOST_PERCENT: Final = 105.0
_LOWEST_FULL_PRESSURE_PA: Final = 5.0e3  # no actuator works below it, where the nameplate says nothing
_CURRENT_LOOP_MA: Final = (-0.5, 25.0)  # what a 4-20 mA loop can carry (NAMUR NE 43 ends at 21)
_SURELY_MOVED: Final = 0.05  # of the travel: five times what a hundredth of the pressure moves
_MOST_STAND_INS: Final = 0.05  # of the values: more is a unit
_STAND_INS: Final = (-999.0, -9999.0, -99999.0, -999.25, -32768.0, 9999.0, 99999.0, 999999.0)
_APART: Final = 0.05  # of the other values' span: a measured value stands among its neighbours
_MOST_KINDS: Final = 3  # different numbers: a measured value in another unit hardly comes twice
_SLOWEST_PERIOD_S: Final = 5.0  # beyond it no motion of a stem is seen, only where it has been
_SLOW_PERIOD_S: Final = 0.5  # milliseconds of 1 kHz or less, and longer than any test that is sampled so slowly:
_LONGEST_SLOW_S: Final = 4.0 * 3600.0
_LONGEST_SERVICE_S: Final = 62.0 * 86400.0  # two months of a historian
_SHORTEST_PERIOD_S: Final = 2.0e-6  # no instrument of a valve samples at 500 kHz

_LENGTHS: Final = (
    ("millimetres", 1.0e-3),
    ("inches", METRE_PER_INCH),
    ("centimetres", 1.0e-2),
    ("micrometres", 1.0e-6),
)
_PRESSURES: Final = (("kPa", 1.0e3), ("bar", PASCAL_PER_BAR), ("psi", PASCAL_PER_PSI))


def require_channels_in_place(
    position_m: FloatArray, pressure_pa: FloatArray, nameplate: Nameplate, source: str
) -> None:
    """Raise RecordingError where position and pressure stand in each other's column; both of shape (n,)."""
    travel_m = nameplate.actuator.travel_m
    reached_m, reached_pa = _largest(position_m), _largest(pressure_pa)
    if reached_m >= _LOWEST_FULL_PRESSURE_PA and 0.0 < reached_pa <= _MOST_TRAVELS * travel_m:
        raise RecordingError(
            say(
                "channels_in_each_others_column",
                "{source}: position_m reaches {position:.4g}, pressure_pa {pressure:.4g}, and the travel of {tag} is "
                "{travel:g m}: the two channels are swapped: exchange their names",
                source=source,
                position=reached_m,
                pressure=reached_pa,
                tag=nameplate.tag,
                travel=travel_m,
            )
        )


def require_plausible_time(time_s: FloatArray, source: str, *, in_service: bool = False) -> None:
    """Raise RecordingError where the time cannot be in seconds, or is too slow to show any motion.

    ``in_service``: rows of a historian, which come slowly and where something changed only, over many days.
    ``time_s``: shape (n,).
    """
    if time_s.size < 2:
        return
    period_s, duration_s = float(np.median(np.diff(time_s))), float(time_s[-1] - time_s[0])
    if 0.0 < period_s < _SHORTEST_PERIOD_S:
        raise RecordingError(
            say(
                "time_in_days",
                "{source}: the rows are {period:.2g} s apart in time_s: it looks like days or hours: write it in "
                "seconds",
                source=source,
                period=period_s,
            )
        )
    if period_s < _SLOW_PERIOD_S or (period_s < _SLOWEST_PERIOD_S and duration_s <= _LONGEST_SLOW_S):
        return
    if in_service:
        if duration_s <= _LONGEST_SERVICE_S:
            return
        raise RecordingError(
            say(
                "time_in_milliseconds_or_long",
                "{source}: the rows are {period:.3g} s apart in time_s and span {days:.3g} days, the most is "
                "{most:g}: if it is in milliseconds, write it in seconds, or cut the file",
                source=source,
                period=period_s,
                days=duration_s / 86400.0,
                most=_LONGEST_SERVICE_S / 86400.0,
            )
        )
    slow = (
        say("record_faster", "record faster, at {period:g} s or less", period=_SLOW_PERIOD_S)
        if period_s >= _SLOWEST_PERIOD_S
        else say("cut_slow_record", "cut a record that is as slow to {hours:g} h", hours=_LONGEST_SLOW_S / 3600.0)
    )
    raise RecordingError(
        say(
            "time_in_milliseconds",
            "{source}: the rows are {period:.3g} s apart in time_s and span {hours:.3g} h: it looks like "
            "milliseconds: write it in seconds, or {slow}",
            source=source,
            period=period_s,
            hours=duration_s / 3600.0,
            slow=slow,
        )
    )


def require_plausible_position(position_m: FloatArray, nameplate: Nameplate, source: str) -> None:
    """Raise RecordingError where the position cannot be in metres: it goes far beyond the rated travel.

    ``position_m``: shape (n,).
    """
    travel_m = nameplate.actuator.travel_m
    reached, most_m = _largest(position_m), _MOST_TRAVELS * travel_m
    if reached <= most_m:
        return
    _require_no_stand_ins("position_m", position_m, most_m, source)
    likely = _likely_units(reached, travel_m, _LENGTHS)
    if 20.0 <= reached <= 120.0:
        likely.append(say("percent_of_travel", "percent of travel"))
    if 0.2 <= reached <= 1.2:
        likely.append(say("share_of_travel", "a share of travel"))
    remedy = say("write_in_metres", "write it in metres")
    if float(np.nanmin(np.abs(position_m))) > travel_m and 0.2 * travel_m <= _span(position_m) <= travel_m:
        remedy = say(
            "write_in_metres_or_subtract", "write it in metres, or subtract what it reads with the valve closed"
        )
    raise RecordingError(
        say(
            "position_beyond_travel",
            "{source}: position_m reaches {reached:.4g} and the travel of {tag} is {travel:g m}: "
            "{guess}{remedy}, or correct actuator.travel_m",
            source=source,
            reached=reached,
            tag=nameplate.tag,
            travel=travel_m,
            guess=_guess(likely),
            remedy=remedy,
        )
    )


def require_plausible_pressure(
    name: str,
    pressure_pa: FloatArray,
    position_m: FloatArray,
    nameplate: Nameplate,
    source: str,
    *,
    command_pa: FloatArray | None = None,
) -> None:
    """Raise RecordingError where a pressure cannot be in Pa: the stem moves at next to none, or it is beyond all.

    Where the nameplate has no range, a command of usual size says what the pressure should reach.
    All channels: shape (n,).
    """
    reached = _largest(pressure_pa)
    full_pa = _full_pressure_pa(nameplate)
    expected_pa = _LOWEST_FULL_PRESSURE_PA if full_pa is None else full_pa
    moved = np.ptp(position_m[np.isfinite(position_m)]) >= _LEAST_MOVED * nameplate.actuator.travel_m
    known = say(
        "pressure_range_ends",
        "the pressure range of {tag} ends at {expected:g Pa}",
        tag=nameplate.tag,
        expected=expected_pa,
    )
    if 0.0 < reached < _LEAST_PRESSURE * expected_pa or (full_pa is None and 0.0 < reached < 0.2 * expected_pa):
        if not moved:
            return
        likely = _likely_pressures(reached, full_pa, 0.0 if command_pa is None else _largest(command_pa))
        about = known if full_pa is not None else say("the_stem_moves", "the stem moves")
        percent = name == "command_pa" and _NEARLY_PERCENT < reached <= _MOST_PERCENT
        how = (
            say("write_in_pa_or_percent", "write it in Pa, or percent as command_ma (4 + 0.16 times percent)")
            if percent
            else say("write_in_pa", "write it in Pa")
        )
        raise RecordingError(
            say(
                "pressure_too_small",
                "{source}: {name} reaches {reached:.4g} and {about}: {guess}{how}",
                source=source,
                name=name,
                reached=reached,
                about=about,
                guess=_guess(likely),
                how=how,
            )
        )
    if full_pa is not None and reached > _MOST_PRESSURES * full_pa:
        _require_no_stand_ins(name, pressure_pa, _MOST_PRESSURES * full_pa, source)
        raise RecordingError(
            say(
                "pressure_too_large",
                "{source}: {name} reaches {reached:.4g} and {known}: write it in Pa, or correct the nameplate's "
                "signal.range_pa and actuator.bench_set_pa",
                source=source,
                name=name,
                reached=reached,
                known=known,
            )
        )


def require_moving_input(
    inputs_pa: Mapping[str, FloatArray], position_m: FloatArray, nameplate: Nameplate, source: str
) -> None:
    """Raise RecordingError where the stem of a spring-opposed actuator goes and no input does.

    ``inputs_pa`` are its pressure and its command by name, those that were recorded; all of shape (n,). Without a
    known range of the pressure nothing is said: then nobody knows what is little.
    """
    full_pa, went_m = _full_pressure_pa(nameplate), _span(position_m)
    if nameplate.actuator.action is not Action.SPRING or full_pa is None or not inputs_pa:
        return
    spans_pa = {name: _span(values_pa) for name, values_pa in inputs_pa.items()}
    if went_m < _SURELY_MOVED * nameplate.actuator.travel_m or max(spans_pa.values()) >= _LEAST_PRESSURE * full_pa:
        return
    stays = tuple(
        say("stays_within", "{name} stays within {span:.3g Pa}", name=name, span=span_pa)
        for name, span_pa in spans_pa.items()
    )
    raise RecordingError(
        say(
            "moved_by_something_else",
            "{source}: {stays: and } while the stem goes {went:.3g mm}: something else moves it (a handwheel, a "
            "bypass), or it is another valve's channel or a gauge that is shut off: record the pressure that "
            "moves the stem",
            source=source,
            stays=stays,
            went=went_m,
        )
    )


def require_plausible_current(command_ma: FloatArray, source: str) -> None:
    """Raise RecordingError where a current is beyond what a 4-20 mA loop carries; ``command_ma``: shape (n,)."""
    present = command_ma[np.isfinite(command_ma)]
    low, high = _CURRENT_LOOP_MA
    if present.size == 0:
        return
    if present.min() < low or present.max() > high:
        worst = present.max() if present.max() > high else present.min()
        raise RecordingError(
            say(
                "current_beyond_loop",
                "{source}: command_ma is {worst:.4g} and a current loop carries 0 to {high:g} mA: it looks like "
                "percent or a pressure: write it in mA, or a pressure as command_pa",
                source=source,
                worst=worst,
                high=high,
            )
        )
    if 0.0 < present.max() < 0.1:
        raise RecordingError(
            say(
                "current_in_amperes",
                "{source}: command_ma reaches {current:.4g} mA, it looks like amperes: write it in mA",
                source=source,
                current=float(present.max()),
            )
        )


def require_no_stand_ins(name: str, values: FloatArray, source: str) -> None:
    """Raise RecordingError where few values are a number that loggers write for none, far from all the others.

    ``values``: shape (n,), in any unit.
    """
    odd = np.isin(values, _STAND_INS)
    count = int(np.count_nonzero(odd))
    others = values[np.isfinite(values) & ~odd]
    if count == 0 or others.size == 0 or count > _MOST_STAND_INS * values.size:
        return
    low, high = float(others.min()), float(others.max())
    margin = _APART * (high - low)
    odd &= (values < low - margin) | (values > high + margin)
    if not odd.any():
        return
    row = int(np.argmax(odd)) + 1
    raise RecordingError(
        say(
            "no_value_number",
            "{source}: row {row}, column {name}: it is {value:.7g}, which loggers write for no value, and the "
            "others are {low:.4g} to {high:.4g}: leave the cell empty where there was no value",
            source=source,
            row=row,
            name=name,
            value=float(values[row - 1]),
            low=low,
            high=high,
        )
    )


def _require_no_stand_ins(name: str, values: FloatArray, most: float, source: str) -> None:
    """Raise RecordingError where few values are beyond ``most``: numbers that a logger writes where it has none."""
    present = values[np.isfinite(values)]
    beyond = np.abs(present) > most
    count = int(np.count_nonzero(beyond))
    if count > _MOST_STAND_INS * present.size or np.unique(present[beyond]).size > _MOST_KINDS:
        return
    row = int(np.flatnonzero(np.isfinite(values))[int(np.argmax(beyond))]) + 1
    others = (
        say("other_values_stay", "the other values stay")
        if count == 1
        else say("all_but_stay", "all but {count} values stay", count=count)
    )
    raise RecordingError(
        say(
            "value_beyond_others",
            "{source}: row {row}, column {name}: it is {value:.4g}, and {others} within {most:.4g}: leave the "
            "cell empty where there was no value",
            source=source,
            row=row,
            name=name,
            value=float(values[row - 1]),
            others=others,
            most=float(_largest(present[~beyond])),
        )
    )


def _span(values: FloatArray) -> float:
    """Return what 98 % of the values span; 0 without any."""
    present = values[np.isfinite(values)]
    low, high = np.percentile(present, (1.0, 99.0)) if present.size else (0.0, 0.0)
    return float(high - low)


def _largest(values: FloatArray) -> float:
    present = values[np.isfinite(values)]
    return float(np.abs(present).max()) if present.size else 0.0


def _full_pressure_pa(nameplate: Nameplate) -> float | None:
    ends = [nameplate.signal.range_pa[1]] if nameplate.signal is not None else []
    if nameplate.actuator.bench_set_pa is not None:
        ends.append(nameplate.actuator.bench_set_pa[1])
    return max(ends, default=None)


def _likely_units(reached: float, expected: float, units: tuple[tuple[str, float], ...]) -> list[str]:
    low, high = _LIKELY
    return [unit for unit, factor in units if low * expected <= reached * factor <= high * expected]


def _likely_pressures(reached: float, full_pa: float | None, commanded_pa: float) -> list[str]:
    if full_pa is not None:
        return _likely_units(reached, full_pa, _PRESSURES)
    if commanded_pa >= _LOWEST_FULL_PRESSURE_PA:
        return _likely_units(reached, commanded_pa, _PRESSURES)
    return [unit for unit, _ in _PRESSURES]


def _guess(units: Sequence[str]) -> Message:
    if not units:
        return say("nothing_guessed", "")
    return say("looks_like", "it looks like {units: or }: ", units=tuple(units))
