"""The extended valve: the Karnopp valve with slots for what a real one does beside it, each neutral by default.

With x the travel, t the time, F_a = S_a P the actuator force and s the direction, the stem obeys

    m x'' = F_a A(x) + p(t) - k x - F_0 - G(x) - friction,

G the spring's slot, A the area's (1 when neutral), p the vibration. Friction has the levels C_s = (F_c + L)(1 + s a_c)
and S_s = (F_s + q L + E)(1 + s a_s), where L(x, t, F_a) is what place, time and pressure add and E what a rest adds:
at rest up to S_s, below DV S_s, above C_s + (S_s - C_s) exp(-(v/v_s)^2) + F_v (1 + s a_v) |v|.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError
from valve.kernel.slots import AREA_CURVE, FRICTION_CURVE, SLOTS, SPRING_CURVE
from valve.messages import say
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, ValveParameters

FloatArray = npt.NDArray[np.float64]

_NUMBER_OF_CURVE: Final = say("number_of_curve", "a curve over travel: a number")


def require_finite(subject: str, value: float, *, least: float = -math.inf, most: float = math.inf) -> None:
    """Raise ParameterError unless the value is a finite number from ``least`` to ``most``."""
    if not (math.isfinite(value) and least <= value <= most):
        raise ParameterError(
            say(
                "value_outside",
                "{subject} is {value:g}, it must be a finite number from {least:g} to {most:g}",
                subject=subject,
                value=value,
                least=least,
                most=most,
            )
        )


def require_above(subject: str, value: float, limit: float = 0.0) -> None:
    """Raise ParameterError unless the value is a finite number above ``limit``."""
    if not (math.isfinite(value) and value > limit):
        raise ParameterError(
            say(
                "value_not_above",
                "{subject} is {value:g}, it must be a finite number above {limit:g}",
                subject=subject,
                value=value,
                limit=limit,
            )
        )


@dataclass(frozen=True, slots=True)
class Curve:
    """A smooth curve over travel: cubic through evenly spaced values from start_m to end_m, held beyond."""

    start_m: float
    end_m: float
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.values) < 2:
            raise ParameterError(
                say(
                    "curve_too_short",
                    "a curve over travel has {count} values, it needs at least 2",
                    count=len(self.values),
                )
            )
        for value in (self.start_m, self.end_m, *self.values):
            require_finite(_NUMBER_OF_CURVE, value)
        if not self.start_m < self.end_m:
            raise ParameterError(
                say(
                    "curve_falls",
                    "a curve over travel goes from {start:g in m} to {end:g m}, it must rise",
                    start=self.start_m,
                    end=self.end_m,
                )
            )


@dataclass(frozen=True, slots=True)
class SpringSlots:
    """G = hardening x^2/2 + bend x^2/2 (x/3 - middle) + knee_rate max(x - knee, 0) - flow_force exp(-x/decay) + curve.

    All in N.
    """

    hardening_n_per_m2: float = 0.0
    hardening_bend_n_per_m3: float = 0.0
    hardening_middle_m: float = 0.0
    knee_m: float = 0.0
    knee_rate_n_per_m: float = 0.0
    flow_force_n: float = 0.0
    flow_decay_m: float = 1.0
    curve_n: Curve | None = None

    def __post_init__(self) -> None:
        require_above("flow_decay_m", self.flow_decay_m)


@dataclass(frozen=True, slots=True)
class AreaSlots:
    """A(x) = 1 + slope (x - reference) + curve(x), the effective area as a share of the nameplate's."""

    slope_per_m: float = 0.0
    reference_m: float = 0.0
    curve: Curve | None = None


@dataclass(frozen=True, slots=True)
class FrictionSlots:
    """What friction has beside F_c, F_s and F_v.

    L = gradient (x - reference) + bend (x - reference)^2 + spot exp(-((x - centre)/width)^2/2) + curve(x)
    + drift (1 - exp(-t/drift_time))
    + pressure_share |F_a|, of which the static friction takes q = ``static_share``; E = dwell_rise T/(T + dwell_time)
    after a rest of T, + first_rise before the first slip.
    ``stribeck_velocity_m_per_s`` 0: the friction is C as soon as the stem slips. ``presliding_m`` is F_s over the
    bristles' stiffness; 0: a stem at rest does not give.
    """

    gradient_n_per_m: float = 0.0
    gradient_reference_m: float = 0.0
    gradient_bend_n_per_m2: float = 0.0
    spot_n: float = 0.0
    spot_centre_m: float = 0.0
    spot_width_m: float = 1.0
    curve_n: Curve | None = None
    drift_n: float = 0.0
    drift_time_s: float = 1.0
    pressure_share: float = 0.0
    static_share: float = 1.0
    coulomb_asymmetry: float = 0.0
    static_asymmetry: float = 0.0
    viscous_asymmetry: float = 0.0
    stribeck_velocity_m_per_s: float = 0.0
    dwell_rise_n: float = 0.0
    dwell_time_s: float = 1.0
    first_rise_n: float = 0.0
    presliding_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("spot_width_m", "drift_time_s", "dwell_time_s"):
            require_above(name, getattr(self, name))
        for name in ("stribeck_velocity_m_per_s", "presliding_m"):
            require_finite(name, getattr(self, name), least=0.0)
        for name in ("coulomb_asymmetry", "static_asymmetry", "viscous_asymmetry"):
            require_finite(name, getattr(self, name), least=-1.0, most=1.0)


@dataclass(frozen=True, slots=True)
class StopSlots:
    """Ends of the travel, m; a rate, N/m, says how hard they give, infinite that they do not."""

    low_m: float = -math.inf
    high_m: float = math.inf
    low_rate_n_per_m: float = math.inf
    high_rate_n_per_m: float = math.inf

    def __post_init__(self) -> None:
        TravelStops(self.low_m, self.high_m)
        for name in ("low_rate_n_per_m", "high_rate_n_per_m"):
            if not getattr(self, name) > 0.0:
                raise ParameterError(
                    say(
                        "stop_rate_not_positive",
                        "{name} is {value:g N/m}, it must be above 0",
                        name=name,
                        value=getattr(self, name),
                    )
                )


@dataclass(frozen=True, slots=True)
class Vibration:
    """p(t) = force sin(2 pi frequency t + phase), N."""

    force_n: float = 0.0
    frequency_hz: float = 1.0
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        require_above("frequency_hz", self.frequency_hz)


@dataclass(frozen=True, slots=True)
class InputPath:
    """From the actuator force that the command asks for to the one that acts.

    T F' = (1 - leak) min(gain u(t - dead_time), limit) - F; with a measured pressure all of it is in the measurement.
    """

    gain: float = 1.0
    leak: float = 0.0
    limit_n: float = math.inf
    lag_s: float = 0.0
    dead_time_s: float = 0.0

    def __post_init__(self) -> None:
        require_above("gain", self.gain)
        require_finite("leak", self.leak, least=0.0, most=1.0)
        for name in ("lag_s", "dead_time_s"):
            require_finite(name, getattr(self, name), least=0.0)
        if math.isnan(self.limit_n):
            raise ParameterError(say("limit_no_number", "limit_n is not a number: correct it"))

    @property
    def is_neutral(self) -> bool:
        """Whether what is asked for acts at once."""
        return self == InputPath()


@dataclass(frozen=True, slots=True)
class SensorPath:
    """From the stem to the position that is read: play, then bow and gain, then lag.

    The play's lever stays within half of ``play_m`` of the stem; with r the reference, u = (w - bow_low)/bow_span and
    z = 2 u - 1, y = r + gain (w + 4 bow u (1 - u) (1 + z (skew + ends z)) - r); lag T y' = y(w) - y.
    """

    gain: float = 1.0
    gain_reference_m: float = 0.0
    bow_m: float = 0.0
    bow_low_m: float = 0.0
    bow_span_m: float = 1.0
    bow_skew: float = 0.0
    bow_ends: float = 0.0
    lag_s: float = 0.0
    play_m: float = 0.0

    def __post_init__(self) -> None:
        require_above("gain", self.gain)
        require_above("bow_span_m", self.bow_span_m)
        for name in ("lag_s", "play_m"):
            require_finite(name, getattr(self, name), least=0.0)


# Which slot of the kernel each field fills, in the field order of its class.
_SLOTS: Final[dict[type, tuple[str, ...]]] = {
    SpringSlots: ("hardening", "hardening_bend", "hardening_middle", "knee", "knee_rate", "flow", "flow_decay"),
    AreaSlots: ("area_slope", "area_reference"),
    FrictionSlots: (
        "gradient", "gradient_reference", "gradient_bend", "spot", "spot_centre", "spot_width",
        "drift", "drift_time", "pressure_share",
        "static_share",
        "coulomb_asymmetry", "static_asymmetry", "viscous_asymmetry", "stribeck_velocity", "dwell_rise", "dwell_time",
        "first_rise", "presliding",
    ),
    StopSlots: ("low", "high", "low_rate", "high_rate"),
    SensorPath: (
        "position_gain", "gain_reference", "bow", "bow_low", "bow_span", "bow_skew", "bow_ends", "position_lag", "play",
    ),
}  # fmt: skip
_PLACE: Final = {name: place for place, name in enumerate(SLOTS)}
_PLACES: Final = {kind: tuple(_PLACE[name] for name in names) for kind, names in _SLOTS.items()}
_NEUTRAL: Final = tuple(SLOTS.values())


@dataclass(frozen=True, slots=True)
class ExtendedValve:
    """A Karnopp valve and its slots. Raises ParameterError where a number is not finite or not physical."""

    parameters: ValveParameters
    spring: SpringSlots = field(default_factory=SpringSlots)
    area: AreaSlots = field(default_factory=AreaSlots)
    friction: FrictionSlots = field(default_factory=FrictionSlots)
    stops: StopSlots = field(default_factory=StopSlots)
    vibration: Vibration = field(default_factory=Vibration)
    input: InputPath = field(default_factory=InputPath)
    sensor: SensorPath = field(default_factory=SensorPath)

    def __post_init__(self) -> None:
        for part in (self.spring, self.area, self.friction, self.vibration, self.sensor):
            values = _VALUES[type(part)](part)
            if not all(map(math.isfinite, values)):
                for name, value in zip(_NUMBERS[type(part)], values, strict=True):
                    require_finite(name, value)

    def vector(self) -> FloatArray:
        """All slots but the input path's in the order of ``valve.kernel.slots.SLOTS``, as the kernel takes them."""
        # a fit makes thousands of valves: a list is filled several times as fast as an array
        q = list(_NEUTRAL)
        for symbol, entry in PARAMETER_SYMBOLS.items():
            q[_PLACE[symbol]] = getattr(self.parameters, entry.field)
        for part in (self.spring, self.area, self.friction, self.stops, self.sensor):
            for place, value in zip(_PLACES[type(part)], _VALUES[type(part)](part), strict=True):
                q[place] = value
        q[_PLACE["vibration"]] = self.vibration.force_n
        q[_PLACE["vibration_rate"]] = 2.0 * math.pi * self.vibration.frequency_hz
        q[_PLACE["vibration_phase"]] = self.vibration.phase_rad
        for name, curve in self._curves():
            if curve is not None:
                first = _PLACE[f"{name}_points"]
                q[first : first + 3] = (len(curve.values), curve.start_m, curve.end_m)
        return np.array(q)

    def curves(self) -> FloatArray:
        """Values of the three curves over travel, shape (3, longest); a curve that is not there is empty."""
        rows = [(row, curve) for row, (_, curve) in zip(_CURVE_ROWS, self._curves(), strict=True) if curve is not None]
        values = np.zeros((3, max((len(curve.values) for _, curve in rows), default=1)))
        for row, curve in rows:
            values[row, : len(curve.values)] = curve.values
        return values

    def _curves(self) -> tuple[tuple[str, Curve | None], ...]:
        return ("spring", self.spring.curve_n), ("area", self.area.curve), ("friction", self.friction.curve_n)


_CURVE_ROWS: Final = (SPRING_CURVE, AREA_CURVE, FRICTION_CURVE)


# Fields of a group of slots that are numbers, in their order, and what reads all of them.
_NUMBERS: Final[dict[type, tuple[str, ...]]] = {
    kind: tuple(entry.name for entry in fields(kind) if not entry.name.startswith("curve"))
    for kind in (SpringSlots, AreaSlots, FrictionSlots, StopSlots, Vibration, SensorPath)
}
_VALUES: Final[dict[type, Callable[[Any], tuple[float, ...]]]] = {
    kind: attrgetter(*names) for kind, names in _NUMBERS.items()
}
