"""The signature as valve technicians know it: drive over travel, friction over travel below it, 0 to 100 % axes.

Written as plain SVG with attributes alone: the tablet puts it into its page, where no style may stand, and lets it zoom
(``signature.js`` reads the ``data-`` attributes); the report puts the same text on its first page.
"""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from service.figures.canvas import BLUE, GRID, INK, RED, SOFT
from service.words.plain_numbers import plus_minus
from service.words.reader import Reader
from valve.messages import Message, say
from valve.recording import FloatArray

WIDE: Final = 760
NARROW: Final = 280
MOST_LAYERS: Final = 4
LETTERS: Final = "ABCD"

_COLOURS: Final = (BLUE, RED, "#00694a", "#7d3c7a")  # each beside its letter: nothing is told by colour alone
_WAYS: Final = (("up", "opening", ""), ("down", "closing", ' stroke-dasharray="7 4"'))
_WHOLE: Final = 100.0
_BEYOND: Final = 4.0  # percent that an axis shows beyond its ends
_MOST_BEYOND: Final = 40.0
_ROOM: Final = 1.6  # a limit further away than this times what was measured is told, not drawn
_PRESSURE: Final = "pressure_pa"
_FORCE: Final = "force_n"
_TITLES: Final = {
    _PRESSURE: say("title_signature", "Signature: pressure over travel, friction below it"),
    _FORCE: say("title_signature_force", "Signature: force over travel, friction below it"),
}
_SHORT_TITLES: Final = {
    _PRESSURE: say("axis_pressure_percent", "Pressure, %"),
    _FORCE: say("axis_force_percent", "Force, %"),
}
_NO_LOOP: Final = say("no_loop", "the motion shows no loop of force over travel")
_MOST: Final = say("most_by_baseline", "most by baseline")
_LEAST: Final = say("least_by_baseline", "least by baseline")
_ACCEPTED: Final = say("acceptance_limit", "acceptance limit")
_CLOSED: Final = say("mark_closed", "closed")
_OPEN: Final = say("mark_open", "open")
_RATED: Final = say("mark_rated_travel", "rated travel")
_STOP: Final = say("mark_stop", "stop")
_STEM_LIMIT: Final = say("mark_stem_limit", "stem limit")
_MUST_REACH: Final = say("mark_must_reach", "must reach")
_BENCH_LIMITS: Final = say("mark_bench_limits", "bench set limits")
_BENCH_NOMINAL: Final = say("mark_bench_nominal", "bench set, nameplate")
_BENCH_MEASURED: Final = say("mark_bench_measured", "bench set, measured")
_LINE: Final = 16.0  # from one line of words to the next
_FONT: Final = "DejaVu Sans, Noto Sans, Arial, sans-serif"


@dataclass(frozen=True, slots=True)
class Frame:
    """What is known of a valve before it is measured, and what is allowed of it; None where nothing is said.

    ``friction_n`` are the least and the most friction that are allowed, N.
    """

    travel_m: float | None = None
    bench_set_pa: tuple[float, float] | None = None
    bench_allowed_percent: float | None = None
    travel_end_percent: float | None = None
    stem_limits_m: tuple[float, float] | None = None
    friction_share_percent: float | None = None
    friction_n: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True, slots=True)
class Layer:
    """One test in the figure: its name, its ``signature`` and, once it is diagnosed, its ``latent_friction``."""

    words: str
    signature: Mapping[str, Any]
    latent_friction: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True, slots=True)
class Drawing:
    """The figure as SVG text, with the words for those who do not see it."""

    svg: str
    title: str
    description: str


def has_signature(signature: Mapping[str, Any] | None) -> bool:
    """Whether a test shows a loop that can be drawn."""
    curve = None if signature is None else signature.get("curve")
    return isinstance(curve, Mapping) and any(
        len((curve.get(way) or {}).get("travel_m") or []) > 1 for way, *_ in _WAYS
    )


def why_no_signature(signature: Mapping[str, Any]) -> str:
    """Return why a test has no loop to draw; empty where it has one."""
    return "" if has_signature(signature) else next(iter((signature.get("notes") or {}).values()), _NO_LOOP)


def signature_drawing(layers: Sequence[Layer], frame: Frame, reader: Reader, width: int = WIDE) -> Drawing | None:
    """Return the figure of a test, the first layer, with others laid over it; None where it shows no loop.

    A test that was driven by a force is not laid over one that was driven by a pressure.
    """
    if not layers or not has_signature(layers[0].signature):
        return None
    drive = _driven_by(layers[0])
    shown = [one for one in layers if has_signature(one.signature) and _driven_by(one) == drive][:MOST_LAYERS]
    axes = _axes(shown, frame, drive)
    above, below = _panels(shown, frame, axes, reader, width)
    unit_n = reader.unit("N").in_si
    marks = [
        *_loop_marks(above, shown, frame, axes, reader),
        *_friction_marks(below, shown, frame, unit_n, reader),
    ]
    _draw_loops(above, shown, axes)  # over the marks
    _draw_friction(below, shown, axes, unit_n)
    title, description = reader.told(_TITLES[drive]), reader.told(_description(shown, reader))
    height = below.top + below.height + 46
    size = f'viewBox="0 0 {width} {height:g}" width="{width}" height="{height:g}"'
    words = f'role="img" aria-labelledby="t d" data-travel="{axes.travel_words(reader)}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {words} font-family="{_FONT}" font-size="13">',
        f'<title id="t">{html.escape(title)}</title><desc id="d">{html.escape(description)}</desc>',
        *_legend(shown, reader, width),
        *above.svg(0),
        *below.svg(1),
        *marks,
        "</svg>",
    ]
    return Drawing("".join(parts), title, description)


def signature_svg(layers: Sequence[Layer], frame: Frame, reader: Reader, width: int = WIDE) -> str | None:
    """Return the figure as SVG text."""
    drawing = signature_drawing(layers, frame, reader, width)
    return None if drawing is None else drawing.svg


def _driven_by(layer: Layer) -> str:
    curve = layer.signature["curve"]
    return _FORCE if any(_FORCE in (curve.get(way) or {}) for way, *_ in _WAYS) else _PRESSURE


@dataclass(frozen=True, slots=True)
class _Axes:
    """What 0 and 100 % are: of the travel, m, and of the drive, Pa or N; and whether each is known or only seen."""

    travel_m: tuple[float, float]
    is_rated: bool
    drive: str
    ends: tuple[float, float]
    is_span: bool

    def travel(self, values_m: Any) -> FloatArray:
        low_m, high_m = self.travel_m
        return np.asarray(_WHOLE * (np.asarray(values_m, dtype=np.float64) - low_m) / (high_m - low_m))

    def driven(self, values: Any) -> FloatArray:
        low, high = self.ends
        return np.asarray(_WHOLE * (np.asarray(values, dtype=np.float64) - low) / (high - low))

    def travel_words(self, reader: Reader) -> str:
        return html.escape(reader.quantity(self.travel_m[1] - self.travel_m[0], "m"))


def _axes(layers: Sequence[Layer], frame: Frame, drive: str) -> _Axes:
    seen_m, seen = (_extent(layers, key) for key in ("travel_m", drive))
    span = layers[0].signature.get("span") or {}
    ends = span.get("pressure_pa") if drive == _PRESSURE else None
    travel_m = seen_m if frame.travel_m is None else (0.0, frame.travel_m)
    chosen = seen if ends is None else (float(ends[0]), float(ends[1]))
    return _Axes(travel_m, frame.travel_m is not None, drive, chosen, ends is not None)


def _extent(layers: Sequence[Layer], key: str) -> tuple[float, float]:
    values = [value for one in layers for way, *_ in _WAYS for value in _branch(one, way).get(key, ())]
    low, high = min(values), max(values)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _branch(layer: Layer, way: str) -> Mapping[str, Any]:
    branch: Mapping[str, Any] = layer.signature["curve"].get(way) or {}
    return branch if len(branch.get("travel_m") or ()) > 1 else {}


@dataclass(slots=True)
class _Panel:
    """One picture with its axes: ``box`` in units of the SVG, ``x`` and ``y`` what its ends stand for."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]
    x_title: str
    y_title: str
    y_unit: str
    right: tuple[str, tuple[float, float]] | None = None  # a second scale: its unit and what the ends stand for
    drawn: list[str] = field(default_factory=list)

    def at_x(self, value: float) -> float:
        return self.left + self.width * (value - self.x[0]) / (self.x[1] - self.x[0])

    def at_y(self, value: float) -> float:
        return self.top + self.height * (self.y[1] - value) / (self.y[1] - self.y[0])

    def points(self, x: FloatArray, y: FloatArray) -> str:
        return " ".join(f"{self.at_x(a):.1f},{self.at_y(b):.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))

    def line(self, x: Sequence[float], y: Sequence[float], stroke: str, more: str = "") -> None:
        ends = " ".join(f"{self.at_x(a):.1f},{self.at_y(b):.1f}" for a, b in zip(x, y, strict=True))
        self.drawn.append(f'<polyline points="{ends}" fill="none" stroke="{stroke}"{more}/>')

    def curve(self, x: FloatArray, y: FloatArray, about: str) -> None:
        self.drawn.append(f'<polyline class="curve" points="{self.points(x, y)}" fill="none" {about}/>')

    def label(self, x: float, y: float, words: str, fill: str, more: str = "") -> str:
        """Return words at a place of the data: where that moves, they move along."""
        return (
            f'<text class="at p{0 if self.right else 1}" x="{self.at_x(x):.1f}" y="{self.at_y(y):.1f}" fill="{fill}" '
            f'font-size="12" stroke="#fff" stroke-width="3" paint-order="stroke"{more}>{html.escape(words)}</text>'
        )

    def svg(self, number: int) -> Iterator[str]:
        """Yield the panel: grid and numbers first, then what was drawn, within the frame."""
        low, high = (f"{end:.6g}" for end in self.x)
        data = f'data-box="{self.left:g} {self.top:g} {self.width:g} {self.height:g}" data-x="{low} {high}"'
        data += f' data-y="{self.y[0]:.6g} {self.y[1]:.6g}" data-unit="{html.escape(self.y_unit)}"'
        if self.right is not None:
            data += f' data-right="{self.right[1][0]:.8g} {self.right[1][1]:.8g}" data-right-unit="{self.right[0]}"'
        yield f'<g class="pane" {data}><clipPath id="c{number}"><rect x="{self.left:g}" y="{self.top:g}"'
        yield f' width="{self.width:g}" height="{self.height:g}"/></clipPath><g class="ticks">'
        yield from self._ticks()
        yield f'</g><g clip-path="url(#c{number})"><g class="data">{"".join(self.drawn)}</g></g>'
        yield f'<rect x="{self.left:g}" y="{self.top:g}" width="{self.width:g}" height="{self.height:g}" fill="none"'
        yield f' stroke="{SOFT}"/>{_words(self.left, self.top - 8.0, self.y_title)}'
        if self.x_title:
            yield _words(self.left + self.width / 2, self.top + self.height + 38.0, self.x_title, "middle")
        if self.right is not None:
            end = self.left + self.width
            yield f'<text x="{end + 6:g}" y="{self.top - 8:g}" fill="{SOFT}">{self.right[0]}</text>'
        yield "</g>"

    def _ticks(self) -> Iterator[str]:
        foot, end = self.top + self.height, self.left + self.width
        for value in _steps(*self.x, most=10 if self.width > 450 else 5):
            x = self.at_x(value)
            yield f'<path d="M{x:.1f} {self.top:g}V{foot:g}" stroke="{GRID}"/>'
            yield f'<text x="{x:.1f}" y="{foot + 17:g}" text-anchor="middle" fill="{INK}">{value:g}</text>'
        for value in _steps(*self.y, most=10 if self.height > 250 else 5):
            y = self.at_y(value)
            yield f'<path d="M{self.left:g} {y:.1f}H{end:g}" stroke="{GRID}"/>'
            yield f'<text x="{self.left - 6:g}" y="{y + 4.5:.1f}" text-anchor="end" fill="{INK}">{value:g}</text>'
            if self.right is not None:
                low, high = self.right[1]
                there = low + (high - low) * (value - self.y[0]) / (self.y[1] - self.y[0])
                yield f'<text x="{end + 6:g}" y="{y + 4.5:.1f}" fill="{SOFT}">{_short(there, high - low)}</text>'


def _words(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{INK}">{html.escape(words)}</text>'


def _short(value: float, span: float) -> str:
    digits = max(0, 2 - int(np.floor(np.log10(span)))) if span > 0.0 else 0
    return f"{value + 0.0:.{digits}f}" if abs(value) > 0.5 * 10.0**-digits else "0"


def _steps(low: float, high: float, most: int) -> list[float]:
    """Return round numbers within a range, at most ``most`` or a few more."""
    raw = (high - low) / most
    size = 10.0 ** np.floor(np.log10(raw))
    step = next(one * size for one in (1.0, 2.0, 2.5, 5.0, 10.0) if one * size >= raw * (1.0 - 1.0e-9))
    first, last = int(np.ceil(low / step - 1.0e-9)), int(np.floor(high / step + 1.0e-9))
    return [float(f"{number * step:.10g}") for number in range(first, last + 1)]


def _panels(layers: Sequence[Layer], frame: Frame, axes: _Axes, reader: Reader, width: int) -> tuple[_Panel, _Panel]:
    left, right = (58.0, 60.0) if width >= WIDE else (46.0, 50.0)
    x = _shown_range(axes.travel(_extent(layers, "travel_m")))
    y = _shown_range(axes.driven(_extent(layers, axes.drive)))
    si_unit = "Pa" if axes.drive == _PRESSURE else "N"
    unit = reader.unit(si_unit)
    low, high = axes.ends
    scale = (unit.shown(low + (high - low) * y[0] / _WHOLE), unit.shown(low + (high - low) * y[1] / _WHOLE))
    ends = (reader.quantity(end, si_unit) for end in axes.ends)
    y_title = reader.told(_drive_title(axes, *ends) if width >= WIDE else _SHORT_TITLES[axes.drive])
    top = 44.0 + 20.0 * (len(layers) if width < WIDE else 1)
    tall = 330.0 if width >= WIDE else 250.0
    above = _Panel(left, top, width - left - right, tall, x, y, "", y_title, "%", (unit.name, scale))
    travel = axes.travel_words(reader)
    rated = reader.told(
        say("axis_travel_rated", "Travel, % of {travel} rated", travel=travel)
        if axes.is_rated
        else say("axis_travel_seen", "Travel, % of {travel} that were seen", travel=travel)
    )
    force = reader.unit("N")
    most = _most_friction(layers, frame) / force.in_si
    foot = min(0.0, 1.1 * _least_friction(layers) / force.in_si)
    friction_title = reader.told(
        say("axis_friction_ways", "Friction, {unit}: opening, closing dashed", unit=force.name)
        if width >= WIDE
        else say("axis_friction", "Friction, {unit}", unit=force.name)
    )
    below_top = top + tall + 52.0
    below = _Panel(
        left, below_top, width - left - right, 0.5 * tall, x, (foot, most), rated, friction_title, force.name
    )
    return above, below


def _drive_title(axes: _Axes, low: str, high: str) -> Message:
    if axes.drive == _PRESSURE:
        return (
            say("axis_pressure_of", "Pressure, % of {low} to {high}", low=low, high=high)
            if axes.is_span
            else say("axis_pressure_seen", "Pressure, % of {low} to {high} that were seen", low=low, high=high)
        )
    return (
        say("axis_force_of", "Force, % of {low} to {high}", low=low, high=high)
        if axes.is_span
        else say("axis_force_seen", "Force, % of {low} to {high} that were seen", low=low, high=high)
    )


def _shown_range(percent: FloatArray) -> tuple[float, float]:
    low, high = float(np.min(percent)), float(np.max(percent))
    return (
        max(min(-_BEYOND, low - 2.0), -_MOST_BEYOND),
        min(max(_WHOLE + _BEYOND, high + 2.0), _WHOLE + _MOST_BEYOND),
    )


def _draw_loops(panel: _Panel, layers: Sequence[Layer], axes: _Axes) -> None:
    for number in reversed(range(len(layers))):
        for way, words, dash in _WAYS:
            branch = _branch(layers[number], way)
            if branch:
                x, y = axes.travel(branch["travel_m"]), axes.driven(branch[axes.drive])
                panel.curve(x, y, _about(number, words, dash))


def _about(number: int, words: str, dash: str) -> str:
    width = 2.2 if number == 0 else 1.6
    return f'stroke="{_COLOURS[number]}" stroke-width="{width}"{dash} data-of="{LETTERS[number]}" data-way="{words}"'


def friction_over_travel(layer: Layer) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return friction over travel, m and N, for each direction that the loop shows: its distance from the spring.

    S_a P - (k x + F_0) opening and the opposite closing, Romano & Garcia (2007), Eq. 1-2; with a force, that. Empty
    where neither area nor spring are known.
    """
    signature: Mapping[str, Any] = layer.signature
    found: dict[str, tuple[FloatArray, FloatArray]] = {}
    span, rate, bench = signature.get("span") or {}, signature.get("spring_rate_n_per_m"), signature.get("bench_set_pa")
    is_force, area_m2, rest_n = _driven_by(layer) == _FORCE, 1.0, 0.0
    if not is_force:
        force_n, pressures = span.get("force_n"), span.get("pressure_pa")
        if not force_n or not pressures or rate is None or not bench or bench[0] is None:
            return {}
        area_m2 = float(force_n) / (float(pressures[1]) - float(pressures[0]))
        rest_n = area_m2 * float(bench[0])
    for way, words, _ in _WAYS:
        branch = _branch(layer, way)
        if branch:
            travel_m = np.asarray(branch["travel_m"], dtype=np.float64)
            drive_n = area_m2 * np.asarray(branch[_FORCE if is_force else _PRESSURE], dtype=np.float64)
            beyond_n = drive_n - ((rate or 0.0) * travel_m + rest_n)
            found[words] = (travel_m, beyond_n if way == "up" else -beyond_n)
    return found


def _bands(layer: Layer) -> Iterator[tuple[str, FloatArray, FloatArray, FloatArray]]:
    """Yield direction, travel, m, and both ends of friction's 95 % band, N."""
    mean_n = layer.signature.get("friction_mean_n")
    for curve in layer.latent_friction:
        if mean_n is not None and curve["coordinate"] == "travel_m" and len(curve["at"]) > 1:
            low, high = np.asarray(curve["ci95"], dtype=np.float64).T + float(mean_n)
            yield str(curve["direction"]), np.asarray(curve["at"], dtype=np.float64), low, high


def _most_friction(layers: Sequence[Layer], frame: Frame) -> float:
    """Return the upper end of friction's axis, N: what was seen, and limits that are not far above it."""
    seen = [float(np.percentile(values, 98)) for one in layers for _, values in friction_over_travel(one).values()]
    seen += [float(np.max(high)) for one in layers for *_, high in _bands(one)]
    seen += [float(one.signature.get("friction_mean_n") or 0.0) for one in layers]
    most = max([*seen, 0.0])
    near = [limit for limit, _ in _friction_limits(layers, frame) if limit <= _ROOM * most]
    return 1.15 * max([most, *near]) or 1.0


def _least_friction(layers: Sequence[Layer]) -> float:
    return min([0.0, *(float(np.min(low)) for one in layers for _, _, low, _ in _bands(one))])


def _friction_limits(layers: Sequence[Layer], frame: Frame) -> list[tuple[float, Message]]:
    force_n = (layers[0].signature.get("span") or {}).get("force_n")
    least_n, most_n = frame.friction_n
    limits = [(one, words) for one, words in ((most_n, _MOST), (least_n, _LEAST)) if one]
    if force_n and frame.friction_share_percent is not None:
        limits.append((frame.friction_share_percent / _WHOLE * float(force_n), _ACCEPTED))
    return limits


def _draw_friction(panel: _Panel, layers: Sequence[Layer], axes: _Axes, unit_n: float) -> None:
    for number in reversed(range(len(layers))):
        layer, colour = layers[number], _COLOURS[number]
        for way, at_m, low, high in _bands(layer):
            x = axes.travel(at_m)
            points = f"{panel.points(x, high / unit_n)} {panel.points(x[::-1], low[::-1] / unit_n)}"
            panel.drawn.append(
                f'<polygon class="band" points="{points}" fill="{colour}" fill-opacity="0.16" '
                f'data-of="{LETTERS[number]}" data-way="{way}"/>'
            )
        for words, (travel_m, friction_n) in friction_over_travel(layer).items():
            dash = next(one for _, name, one in _WAYS if name == words)
            panel.curve(axes.travel(travel_m), friction_n / unit_n, _about(number, words, dash))


def _loop_marks(panel: _Panel, layers: Sequence[Layer], frame: Frame, axes: _Axes, reader: Reader) -> Iterator[str]:
    """Draw rated travel, stops, bench set and limits, and yield their words."""
    low, high = panel.y
    ends = (0.0, _CLOSED, "start"), (_WHOLE, _RATED if axes.is_rated else _OPEN, "end")
    for place, words, anchor in ends:
        panel.line([place, place], [low, high], INK, ' stroke-width="1.2"')
        shift = 5 if anchor == "start" else -5
        yield panel.label(place, low, reader.told(words), INK, f' dx="{shift}" dy="-6" text-anchor="{anchor}"')
    for stop_m in layers[0].signature.get("stops_m") or ():
        if stop_m is not None:
            (place,) = axes.travel([stop_m])
            panel.line([place, place], [low, high], INK, ' stroke-width="6" stroke-opacity="0.35"')
            anchor, shift = ("start", 8) if place < _WHOLE / 2 else ("end", -8)
            yield panel.label(place, low, reader.told(_STOP), INK, f' dx="{shift}" dy="-22" text-anchor="{anchor}"')
    yield from _travel_limits(panel, frame, axes, reader)
    yield from _bench_marks(panel, layers[0], frame, axes, reader)
    for number, layer in enumerate(layers):
        if len(layers) > 1:
            yield _letter(panel, axes, layer, number)


def _travel_limits(panel: _Panel, frame: Frame, axes: _Axes, reader: Reader) -> Iterator[str]:
    _, high = panel.y
    if frame.stem_limits_m is not None:
        for place in axes.travel(frame.stem_limits_m).tolist():
            if panel.x[0] <= place <= panel.x[1]:
                panel.line([place, place], panel.y, RED, ' stroke-width="1.4" stroke-dasharray="8 3 2 3"')
                anchor, shift = ("start", 5) if place < _WHOLE / 2 else ("end", -5)
                yield panel.label(
                    place, high, reader.told(_STEM_LIMIT), RED, f' dx="{shift}" dy="32" text-anchor="{anchor}"'
                )
    share = frame.travel_end_percent
    if axes.is_rated and share is not None and share < 25.0:
        for place, anchor, shift in ((share, "start", 5), (_WHOLE - share, "end", -5)):
            panel.line([place, place], panel.y, RED, ' stroke-width="1" stroke-dasharray="2 3"')
            yield panel.label(
                place, high, reader.told(_MUST_REACH), RED, f' dx="{shift}" dy="16" text-anchor="{anchor}"'
            )


def _bench_marks(panel: _Panel, layer: Layer, frame: Frame, axes: _Axes, reader: Reader) -> Iterator[str]:
    """Draw the bench set of the nameplate with its limits, or the measured one where the nameplate has none."""
    found = layer.signature.get("bench_set_pa")
    nominal = frame.bench_set_pa
    bench = nominal if nominal is not None else found
    if axes.drive != _PRESSURE or not bench or None in bench:
        return
    low, high = axes.driven(list(bench)).tolist()
    allowed = frame.bench_allowed_percent
    if nominal is not None and allowed is not None and axes.is_span:
        for shift in (-allowed, allowed):
            panel.line([0.0, _WHOLE], [low + shift, high + shift], RED, ' stroke-width="1" stroke-dasharray="2 3"')
        yield panel.label(
            98.0, low + 0.98 * (high - low) - allowed, reader.told(_BENCH_LIMITS), RED, ' dy="34" text-anchor="end"'
        )
    panel.line([0.0, _WHOLE], [low, high], SOFT, ' stroke-width="1.2" stroke-dasharray="8 3 2 3"')
    words = reader.told(_BENCH_NOMINAL if nominal is not None else _BENCH_MEASURED)
    yield panel.label(16.0, low + 0.16 * (high - low), words, SOFT, ' dx="12" dy="20" text-anchor="start"')


def _letter(panel: _Panel, axes: _Axes, layer: Layer, number: int) -> str:
    for way, *_ in _WAYS:
        branch = _branch(layer, way)
        if branch:
            x, y = axes.travel(branch["travel_m"]), axes.driven(branch[axes.drive])
            row = int(np.argmin(np.abs(x - (38.0 + 12.0 * number))))
            more = ' font-weight="700" dx="-4" dy="-8" text-anchor="end"'
            return panel.label(float(x[row]), float(y[row]), LETTERS[number], _COLOURS[number], more)
    return ""


def _friction_marks(
    panel: _Panel, layers: Sequence[Layer], frame: Frame, unit_n: float, reader: Reader
) -> Iterator[str]:
    """Draw the limits of friction, and yield their words beside each other; one that lies far above is told."""
    written, beyond = list[float](), 0
    for limit_n, words in _friction_limits(layers, frame):
        at = limit_n / unit_n
        if at <= panel.y[1]:
            panel.line(panel.x, [at, at], RED, ' stroke-width="1.4" stroke-dasharray="8 3 2 3"')
            is_free = all(abs(panel.at_y(at) - y) > _LINE for y in written)
            x, dx, anchor = (panel.x[0], 6, "start") if is_free else (panel.x[1], -6, "end")
            written += [panel.at_y(at)] if is_free else []
            yield panel.label(x, at, reader.told(words), RED, f' dx="{dx}" dy="-5" text-anchor="{anchor}"')
        else:
            beyond += 1
            limit = f"{plus_minus(at, None, digits=3)} {panel.y_unit}"
            above = say("limit_above", "{what} {limit}, above", what=words, limit=limit)
            more = f' dx="-6" dy="{_LINE * beyond:g}" text-anchor="end"'
            yield panel.label(panel.x[1], panel.y[1], reader.told(above), RED, more)


def _legend(layers: Sequence[Layer], reader: Reader, width: int) -> Iterator[str]:
    wide = width >= WIDE
    step = (width - 16) / max(len(layers), 2)
    for number, layer in enumerate(layers):
        x, y = (8 + step * number, 20) if wide else (8, 20 + 20 * number)
        letter = f"{LETTERS[number]}  " if len(layers) > 1 else ""
        yield f'<path d="M{x:g} {y - 4}h24" stroke="{_COLOURS[number]}" stroke-width="3"/>'
        words = html.escape(letter + reader.shown(layer.words))
        yield f'<text x="{x + 30:g}" y="{y}" fill="{INK}" font-size="12">{words}</text>'


def _description(layers: Sequence[Layer], reader: Reader) -> Message:
    told = []
    for number, layer in enumerate(layers):
        friction = reader.measured(layer.signature.get("friction_mean_n"), None, "N")
        dead_band = layer.signature.get("dead_band_percent")
        said = say(
            "layer_friction",
            "{letter}, {test}: friction {friction}",
            letter=LETTERS[number],
            test=layer.words,
            friction=friction,
        )
        if dead_band is not None:
            band = reader.measured(dead_band, None, "percent")
            said = say("layer_dead_band", "{said}, dead band {band}", said=said, band=band)
        told.append(said)
    return say(
        "loop_said",
        "The loop that the valve draws opening and closing; half of its width is friction. {layers:; }.",
        layers=tuple(told),
    )
