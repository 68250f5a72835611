"""The pictures of tablet and report: what they draw and say of a test."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any
from xml.etree import ElementTree
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from service.figures.canvas import svg_text
from service.figures.friction import friction_picture
from service.figures.methods import methods_picture
from service.figures.misfit import time_picture
from service.figures.signature import (
    NARROW,
    WIDE,
    Frame,
    Layer,
    friction_over_travel,
    signature_drawing,
    why_no_signature,
)
from service.figures.trace import trace_picture
from service.figures.trend import Ahead, Trend, TrendPoint, trends_picture, trends_svg
from service.words import messages
from service.words.languages import Catalogue, Language
from service.words.reader import Reader
from service.words.units import UnitSystem
from valve.recording import Recording


def _estimates(preload_n: float, half_n: float) -> list[dict[str, Any]]:
    """Return two methods that differ by 0.1 % in friction and by twice in preload."""
    return [
        {
            "method": method,
            "parameters": {
                "F_c": {"value": friction_n, "unit": "N", "ci95": [friction_n - 1.0, friction_n + 1.0]},
                "F_0": {"value": offset_n, "unit": "N", "ci95": [offset_n - half_n, offset_n + half_n]},
            },
        }
        for method, friction_n, offset_n in (("regression", 1000.0, preload_n), ("garcia", 1001.0, 2.0 * preload_n))
    ]


def test_a_trace_of_many_samples_keeps_the_one_that_stands_out_and_its_holes() -> None:
    time_s = np.linspace(0.0, 59.999, 60_000)
    position_m = np.full(time_s.size, 0.05)
    position_m[31_234] = 0.09
    position_m[10_000:20_000] = np.nan
    recording = Recording(time_s, position_m, command_pa=np.linspace(0.0, 8.0e4, time_s.size))
    picture = trace_picture(recording, Reader())
    above, below = picture.figure.axes
    drawn_s, drawn = (np.asarray(one, dtype=np.float64) for one in above.get_lines()[0].get_data())
    assert drawn.size < 2000
    assert np.nanmax(drawn) > 1.5 * np.nanmin(drawn)
    assert np.isnan(drawn[(drawn_s > 10.1) & (drawn_s < 19.9)]).all()
    assert [line.get_label() for line in below.get_lines()] == ["command"]
    assert "60000 samples" in picture.description


def test_labels_and_description_are_told_in_the_language_of_the_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    said = Catalogue(
        {
            "axis_travel": ("travel, {unit}", "Hub, {unit}"),
            "with_its_band": ("{way}, with its 95 % band", "{way}, mit 95-%-Band"),
            "title_friction": ("Friction along the travel", "Reibung über dem Hub"),
            "mark_closed": ("closed", "zu"),
            "axis_friction": ("Friction, {unit}", "Reibung, {unit}"),
            "month_oct": ("Oct", "Okt"),
        },
        {"opening": "beim Öffnen"},
    )
    monkeypatch.setattr(messages, "catalogue", lambda language: said if language is Language.GERMAN else Catalogue())
    latent = [
        {"coordinate": "travel_m", "direction": "opening", "at": [0, 0.1], "force_n": [1, 2], "ci95": [[0, 2]] * 2}
    ]
    german, english = (friction_picture(latent, Reader(language=one)) for one in (Language.GERMAN, Language.ENGLISH))
    assert german is not None
    assert english is not None
    assert (german.title, english.title) == ("Reibung über dem Hub", "Friction along the travel")
    assert german.figure.axes[0].get_xlabel() == "Hub, mm"
    assert "beim Öffnen 1 to 2 N" in german.description
    assert "beim Öffnen, mit 95-%-Band" in svg_text(german)
    assert "opening, with its 95 % band" in svg_text(english)
    drawing = signature_drawing([Layer("closed", _signature())], Frame(0.2), Reader(language=Language.GERMAN), NARROW)
    assert drawing is not None
    assert ">zu<" in drawing.svg
    assert ">closed<" in drawing.svg, "what somebody called a test stays"
    assert "Reibung, N" in drawing.svg
    at = datetime(2026, 10, 10, tzinfo=UTC)
    points = tuple(TrendPoint(at + timedelta(days=day), 600.0) for day in range(20))
    trend = trends_picture(
        [Trend("friction_mean_n", "friction", "N", points)], Reader(zone=UTC, language=Language.GERMAN)
    )
    assert trend is not None
    assert "2026-Okt" in svg_text(trend)


def test_the_noise_of_a_stem_that_stood_still_is_not_drawn_as_motion() -> None:
    time_s = np.linspace(0.0, 10.0, 1001)
    still = Recording(time_s, 2.0e-6 * np.sin(900.0 * time_s), command_pa=np.zeros(time_s.size))
    for system in UnitSystem:
        low, high = trace_picture(still, Reader(system)).figure.axes[0].get_ylim()
        drawn = trace_picture(still, Reader(system)).figure.axes[0].get_lines()[0].get_ydata()
        assert np.ptp(np.asarray(drawn, dtype=np.float64)) < 0.01 * (high - low)


def test_a_trace_without_a_single_position_says_so() -> None:
    recording = Recording(np.array([0.0, 1.0]), np.full(2, np.nan), command_pa=np.zeros(2))
    assert "never measured" in trace_picture(recording, Reader()).description


def test_a_parameter_that_may_be_zero_is_not_drawn_in_percent() -> None:
    picture = methods_picture(_estimates(0.01, 0.05), Reader())
    assert picture is not None
    assert "F_c" in picture.description
    assert "F_0" not in picture.description
    (axes,) = picture.figure.axes
    assert max(abs(end) for end in axes.get_xlim()) < 1.0


def test_a_preload_that_is_known_is_drawn() -> None:
    picture = methods_picture(_estimates(100.0, 1.0), Reader())
    assert picture is not None
    assert "F_0" in picture.description


@pytest.mark.parametrize("language", Language)
def test_the_names_of_all_methods_and_of_the_model_with_a_cause_fit_into_the_picture(language: Language) -> None:
    one = _estimates(100.0, 1.0)[0]
    methods = ("regression", "garcia", "maximum_likelihood", "extended")
    picture = methods_picture([one | {"method": method} for method in methods], Reader(language=language))
    assert picture is not None
    picture.figure.draw_without_rendering()
    (legend,) = picture.figure.legends
    assert len(legend.get_texts()) == len(methods)
    assert legend.get_window_extent().x1 <= picture.figure.bbox.x1


def test_a_misfit_without_a_cause_is_not_called_one_without_the_cause() -> None:
    time = {"time_s": [0.0, 1.0], "measured_m": [0.0, 1.0e-3], "before_m": [0.0, 1.1e-3]}
    healthy, found = (time_picture({"time": one}, Reader()) for one in (time, time | {"after_m": [0.0, 1.0e-3]}))
    assert healthy is not None
    assert found is not None
    assert "the cause" not in svg_text(healthy)
    assert "without the cause" in svg_text(found)


AREA_M2, RATE_N_PER_M, FRICTION_N, REST_PA, SPAN_PA = 0.05, 40_000.0, 200.0, 10_000.0, (0.0, 100_000.0)


def _signature(channel: str = "pressure_pa", friction_n: float = FRICTION_N) -> dict[str, Any]:
    """Return the signature of a valve whose spring and friction are known, over ``channel``."""
    travel_m = np.linspace(0.0, 0.1, 21)
    branches = {}
    for way, sign in (("up", 1.0), ("down", -1.0)):
        force_n = RATE_N_PER_M * travel_m + AREA_M2 * REST_PA + sign * friction_n
        driven = force_n / AREA_M2 if channel == "pressure_pa" else sign * friction_n + 0.0 * travel_m
        branches[way] = {"travel_m": travel_m.tolist(), channel: driven.tolist()}
    return {
        "curve": branches,
        "friction_mean_n": friction_n,
        "spring_rate_n_per_m": RATE_N_PER_M,
        "bench_set_pa": [REST_PA, REST_PA + 0.1 * RATE_N_PER_M / AREA_M2],
        "span": {"force_n": AREA_M2 * (SPAN_PA[1] - SPAN_PA[0]), "pressure_pa": list(SPAN_PA)},
        "stops_m": [0.0, None],
    }


def _ends_of(svg: str, way: str, letter: str = "A") -> list[tuple[float, float]]:
    """Return first and last point of a curve of the loop, in percent of both axes."""
    root = ElementTree.fromstring(svg)
    pane = next(one for one in root.iter() if one.get("class") == "pane")
    left, top, width, height = (float(one) for one in pane.attrib["data-box"].split())
    (x_low, x_high), (y_low, y_high) = (
        [float(one) for one in pane.attrib[key].split()] for key in ("data-x", "data-y")
    )
    curve = next(one for one in pane.iter() if (one.get("data-of"), one.get("data-way")) == (letter, way))
    places = [[float(one) for one in pair.split(",")] for pair in curve.attrib["points"].split()]
    return [
        (x_low + (x_high - x_low) * (x - left) / width, y_high - (y_high - y_low) * (y - top) / height)
        for x, y in (places[0], places[-1])
    ]


@pytest.mark.parametrize("width", [WIDE, NARROW])
def test_the_signature_is_drawn_in_percent_of_rated_travel_and_of_the_signals_span(width: int) -> None:
    drawing = signature_drawing([Layer("this test", _signature())], Frame(0.2), Reader(), width)
    assert drawing is not None
    ((x_low, y_low), (x_high, y_high)) = _ends_of(drawing.svg, "opening")
    assert (x_low, x_high) == pytest.approx((0.0, 50.0), abs=0.3)  # 100 mm of 200 mm rated
    assert (y_low, y_high) == pytest.approx((14.0, 94.0), abs=0.3)
    assert _ends_of(drawing.svg, "closing")[0][1] == pytest.approx(6.0, abs=0.3)
    assert "Travel, % of 200.0 mm rated" in drawing.svg


def test_friction_over_travel_is_that_of_the_valve_in_both_directions() -> None:
    for channel in ("pressure_pa", "force_n"):
        found = friction_over_travel(
            Layer("", _signature(channel) | ({"spring_rate_n_per_m": 0.0} if channel == "force_n" else {}))
        )
        assert set(found) == {"opening", "closing"}
        for _, friction_n in found.values():
            assert friction_n == pytest.approx(FRICTION_N)
    assert friction_over_travel(Layer("", _signature() | {"spring_rate_n_per_m": None})) == {}


def test_stops_bench_set_and_limits_are_drawn_where_they_are_known() -> None:
    layer = Layer("this test", _signature())
    frame = Frame(0.1, (9_000.0, 91_000.0), 5.0, 5.0, (-0.002, 0.103), 5.0, (150.0, 250.0))
    drawing, bare = (signature_drawing([layer], one, Reader()) for one in (frame, Frame()))
    assert drawing is not None
    assert bare is not None
    words = set(re.findall(r">([^<>]+)</text>", drawing.svg))
    told = {"closed", "rated travel", "stop", "stem limit", "must reach", "bench set, nameplate", "bench set limits"}
    assert told | {"acceptance limit", "most by baseline", "least by baseline"} <= words
    bare_words = set(re.findall(r">([^<>]+)</text>", bare.svg))
    assert not {"rated travel", "stem limit", "must reach", "bench set limits", "acceptance limit"} & bare_words
    assert "bench set, measured" in bare_words


def test_limits_of_friction_that_are_alike_are_written_at_the_two_ends_of_the_figure() -> None:
    frame = Frame(0.1, friction_share_percent=5.0, friction_n=(150.0, 250.0))  # both 250 N
    drawing = signature_drawing([Layer("this test", _signature())], frame, Reader())
    assert drawing is not None
    ends = dict(re.findall(r'text-anchor="(start|end)">(most by baseline|acceptance limit)<', drawing.svg))
    assert ends == {"start": "most by baseline", "end": "acceptance limit"}


def test_a_limit_far_above_what_was_measured_is_told_and_does_not_flatten_the_curve() -> None:
    frame = Frame(0.1, friction_share_percent=60.0)  # 3,000 N
    drawing = signature_drawing([Layer("this test", _signature())], frame, Reader())
    assert drawing is not None
    assert "acceptance limit 3000 N, above" in drawing.svg


def test_tests_are_laid_over_each_other_by_letter_and_a_drive_by_force_never_over_a_pressure() -> None:
    """A recording with force_n has no pressure: its report ended in a KeyError."""
    own, other, forced = (
        Layer("now", _signature()),
        Layer("as found", _signature(friction_n=400.0)),
        _signature("force_n"),
    )
    both = signature_drawing([own, other, Layer("a motor", forced)], Frame(0.1), Reader())
    assert both is not None
    assert _ends_of(both.svg, "opening", "B")[0][1] == pytest.approx(18.0, abs=0.3)
    assert 'data-of="C"' not in both.svg
    assert "B  as found" in both.svg
    assert "A, now: friction 200 N; B, as found: friction 400 N" in both.description
    driven = signature_drawing([Layer("a motor", forced), own], Frame(0.1), Reader())
    assert driven is not None
    assert "Force, %" in driven.svg
    assert "Pressure" not in driven.svg
    assert 'data-of="B"' not in driven.svg


def test_the_band_of_friction_lies_about_its_mean() -> None:
    latent = [
        {"coordinate": "travel_m", "direction": "opening", "at": [0.0, 0.1], "ci95": [[-10.0, 10.0], [-5.0, 15.0]]}
    ]
    drawing = signature_drawing([Layer("x", _signature(), latent)], Frame(0.1), Reader())
    assert drawing is not None
    root = ElementTree.fromstring(drawing.svg)
    below = [one for one in root.iter() if one.get("class") == "pane"][1]
    _, top, _, height = (float(one) for one in below.attrib["data-box"].split())
    low_n, high_n = (float(one) for one in below.attrib["data-y"].split())
    band = next(one for one in below.iter() if one.get("class") == "band")
    drawn = [
        high_n - (high_n - low_n) * (float(pair.split(",")[1]) - top) / height for pair in band.attrib["points"].split()
    ]
    assert drawn == pytest.approx([210.0, 215.0, 195.0, 190.0], abs=0.5)


def test_words_of_a_test_are_never_markup() -> None:
    drawing = signature_drawing([Layer("<script>&", _signature())], Frame(0.1), Reader())
    assert drawing is not None
    assert "<script>" not in drawing.svg
    ElementTree.fromstring(drawing.svg)


def _trends(ci95: tuple[float, float] | None = (590.0, 610.0)) -> list[Trend]:
    at = datetime(2026, 10, 1, 22, 30, tzinfo=UTC)
    points = tuple(TrendPoint(at + timedelta(days=days), 600.0, ci95) for days in range(3))
    return [Trend(name, name, "N", points) for name in ("friction_mean_n", "spring_rate_n_per_m")]


@pytest.mark.parametrize("narrow", [False, True])
def test_a_trend_says_what_its_bars_hold(narrow: bool) -> None:
    drawn = trends_svg(_trends(), Reader(zone=UTC), narrow)
    assert drawn is not None
    words = " ".join(re.findall(r"<text[^>]*>([^<]*)</text>", drawn))
    for said in (
        "Bars: 95 % interval of each test, without what the figure differs by from test to test.",
        "The bar of friction holds what friction varies by within its test.",
        "Time: UTC.",
    ):
        assert said in words
    bare = trends_svg(_trends(None), Reader(zone=UTC), narrow)
    assert bare is not None
    assert "Bars" not in bare
    spring = trends_picture(_trends()[1:], Reader(zone=UTC))
    assert spring is not None
    assert "bar of friction" not in spring.description


def test_four_trends_of_a_month_are_small_on_any_day_of_it() -> None:
    # on the last days of a month two more dates stand below each of them
    at = datetime(2026, 11, 30, 12, tzinfo=UTC)
    points = tuple(TrendPoint(at - timedelta(days=days), 600.0, (590.0, 610.0)) for days in (30, 20, 10, 1))
    trends = [Trend(name, name, "N", points, 600.0, (500.0, 700.0)) for name in ("a", "b", "c", "d")]
    drawn = trends_svg(trends, Reader(zone=UTC), narrow=False)
    assert drawn is not None
    assert len(drawn.encode()) < 40_000


def test_a_forecast_is_drawn_on_to_its_limit_where_it_is_near() -> None:
    last = datetime(2026, 10, 3, 22, 30, tzinfo=UTC)

    def drawn(days: float, latest_days: float | None) -> tuple[list[float], list[Any], str]:
        latest = None if latest_days is None else last + timedelta(days=latest_days)
        ahead = Ahead(605.0, 650.0, last + timedelta(days=days), last + timedelta(days=0.5 * days), latest)
        picture = trends_picture([replace(_trends()[0], limits=(None, 650.0), ahead=ahead)], Reader(zone=UTC))
        assert picture is not None
        axes = picture.figure.axes[0]
        dotted = [line for line in axes.get_lines() if line.get_linestyle() == ":"]
        ends = [float(one) for line in dotted for one in np.asarray(line.get_ydata(), dtype=np.float64)]
        assert axes.get_ylim()[1] >= 650.0
        right = float(axes.get_xlim()[1]) - float(np.asarray(axes.get_lines()[0].get_xdata(), dtype=np.float64)[-1])
        assert right >= (days if dotted else 0.0)
        return ends, list(axes.patches), picture.description

    for latest_days in (6.0, 60.0, None):
        ends, wedge, words = drawn(3.0, latest_days)
        assert ends == [605.0, 650.0]
        assert len(wedge) == 1
        assert "Dotted: the trend on to its limit" in words
    ends, wedge, words = drawn(5.0, 6.0)  # the tests span two days
    assert (ends, wedge) == ([], [])
    assert "Dotted" not in words


def test_a_trend_is_drawn_by_the_plants_clock() -> None:
    for zone, day, hour in ((UTC, "2026-10-01", 22.5), (ZoneInfo("Asia/Kolkata"), "2026-10-02", 4.0)):
        picture = trends_picture(_trends(), Reader(zone=zone))
        assert picture is not None
        assert f"on {day};" in picture.description
        assert f"Time: {zone}." in picture.description
        first = np.asarray(picture.figure.axes[0].get_lines()[0].get_xdata(), dtype=np.float64)[0]
        assert 24.0 * (first % 1.0) == pytest.approx(hour)


@pytest.mark.parametrize(
    ("signature", "told"),
    [
        ({"curve": {"up": {"travel_m": [0.0, 0.01]}}, "notes": {}}, ""),
        ({"curve": None, "notes": {"friction_mean_n": "the stem did not move"}}, "the stem did not move"),
        ({"curve": None, "notes": {}}, "the motion shows no loop of force over travel"),
    ],
)
def test_a_signature_that_is_missing_is_missing_for_a_reason(signature: dict[str, Any], told: str) -> None:
    assert str(why_no_signature(signature)) == told
