"""``breakaway plan``: what is expected of a valve, what each sequence tells of it, and what a newcomer reads."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner, Result

from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.planned_scatter import PackingScatter, packing_half_widths
from service.cli import app
from service.config.plant import PlantValve
from service.config.settings import load_plant
from service.planning.expected_valve import expected_valve, measures_pressure
from service.planning.planning import plan_document, plan_sequence
from tests.support.rough_valves import case
from valve.errors import RequestError
from valve.parameter_sets import parameter_set
from valve.parameters import PARAMETER_SYMBOLS

EXAMPLE = Path(__file__).parents[2] / "examples" / "plant.toml"
NOBODY = "http://127.0.0.1:1"


@pytest.fixture(scope="module")
def valves() -> dict[str, PlantValve]:
    return dict(load_plant(EXAMPLE).valves)


def last_test(share: float | None = None, **missing: None) -> dict[str, Any]:
    """A completed test of the rough valve whose last method gave everything but what is ``missing``.

    Its friction varies by this ``share``.
    """
    values = {**parameter_set("rough").parameters.by_symbol(), **missing}
    none = {symbol: {"value": None} for symbol in PARAMETER_SYMBOLS}
    given = {
        symbol: {"value": value, "scatter": None if share is None or value is None else share * value}
        for symbol, value in values.items()
    }
    estimates = [
        {"method": "regression", "parameters": {**none, "F_c": {"value": 9.9e9}}},
        {"method": "maximum_likelihood", "parameters": given},
    ]
    return {
        "id": "20261121T000000Z-00000000",
        "quality": {"median_period_s": 0.0517},
        "analysis": {"estimates": estimates, "recording": {"position_noise_m": 3.0e-6}},
    }


def planned(*arguments: str) -> Result:
    return CliRunner(env={"COLUMNS": "80", "BREAKAWAY_URL": NOBODY}).invoke(
        app, ["plan", *arguments], catch_exceptions=True
    )


def test_a_valve_that_was_never_tested_is_assumed_from_its_nameplate(valves: dict[str, PlantValve]) -> None:
    expected = expected_valve(valves["FV-101"], None, why_none="no service")
    assert expected.parameters.spring_rate_n_per_m == pytest.approx(82737.0 * 0.06452 / 0.1016)
    assert expected.parameters.coulomb_friction_n == pytest.approx(0.1 * 82737.0 * 0.06452)
    assert expected.assumed == tuple(PARAMETER_SYMBOLS)
    assert "no service" in expected.parameters_from
    assert (expected.noise_from, expected.sample_period_s) == ("assumed", 0.001)


def test_the_last_test_is_believed_method_by_method(valves: dict[str, PlantValve]) -> None:
    expected = expected_valve(valves["FV-102"], last_test(DV=None))
    rough = parameter_set("rough").parameters
    assert replace(expected.parameters, limit_velocity_m_per_s=1.0) == replace(rough, limit_velocity_m_per_s=1.0)
    assert expected.assumed == ("DV",)
    assert "20261121T000000Z-00000000" in expected.parameters_from
    assert (expected.noise_m, expected.noise_from) == (3.0e-6, "last test")
    # what the line really kept, not what was asked for
    assert expected.sample_period_s == 0.0517
    assert expected_valve(valves["FV-102"], last_test(), noise_m=1.0e-5).noise_m == 1.0e-5


def test_a_valve_shows_whether_its_pressure_is_measured(valves: dict[str, PlantValve]) -> None:
    assert measures_pressure(valves["FV-101"].wiring)
    assert not measures_pressure(valves["FV-102"].wiring)


def test_a_valve_without_an_area_cannot_be_planned(valves: dict[str, PlantValve]) -> None:
    valve = valves["FV-101"]
    actuator = replace(valve.nameplate.actuator, diaphragm_area_m2=None)
    with pytest.raises(RequestError, match="diaphragm_area_m2 None"):
        expected_valve(replace(valve, nameplate=replace(valve.nameplate, actuator=actuator)), None)


def test_the_usual_sequence_tells_more_than_the_triangle_in_less_time(valves: dict[str, PlantValve]) -> None:
    valve = valves["FV-101"]
    expected = expected_valve(valve, last_test())
    many, one = (plan_sequence(valve, expected, name, {}) for name in ("multi_rate", "triangle"))
    assert many.waveform is not None
    assert one.waveform is not None
    assert many.waveform.duration_s <= one.waveform.duration_s
    assert many.score > one.score
    # a usual packing hides m and DV of this valve, whose slips are short
    assert set(many.identifiable) == set(one.identifiable) == set(PARAMETER_SYMBOLS) - {"m", "DV"}


def test_a_valve_that_is_known_to_repeat_itself_is_promised_what_the_sensor_allows(
    valves: dict[str, PlantValve],
) -> None:
    valve = valves["FV-101"]
    expected = expected_valve(valve, last_test(1.0e-5))
    assert expected.scatter.source == "the valve in its last test"
    many, one = (plan_sequence(valve, expected, name, {}) for name in ("multi_rate", "triangle"))
    assert set(many.identifiable) == set(PARAMETER_SYMBOLS)
    assert set(one.identifiable) == set(PARAMETER_SYMBOLS) - {"DV"}


@pytest.mark.long
def test_what_is_promised_of_a_usual_packing_is_what_the_engine_gives(valves: dict[str, PlantValve]) -> None:
    """F_c was promised to +-0.0073 %, which a usual packing leaves to no method."""
    for name, sequence, seed in (("nominal", "multi_rate", 21), ("nominal", "triangle", 21)):
        made = case(name, sequence, "usual", 1.0e-3, seed=seed)
        promised = packing_half_widths(
            made.settings.parameters, made.waveform, made.nameplate.actuator, PackingScatter()
        )
        found = MaximumLikelihoodEstimator().estimate(made.recording, made.nameplate)
        # slips show roughness too, which the promise of F_c does not count on
        for symbol, most in (("k", 1.5), ("F_c", 3.0), ("F_s", 1.5), ("F_0", 1.5)):
            ci95 = found.parameters[symbol].ci95
            assert ci95 is not None
            assert 1.0 / 1.5 < promised[symbol] / (0.5 * (ci95[1] - ci95[0])) < most, (name, symbol)


def test_what_the_limits_forbid_is_told_and_not_planned(valves: dict[str, PlantValve]) -> None:
    valve = valves["FV-101"]
    plan = plan_sequence(valve, expected_valve(valve, None), "steps", {})
    assert plan.knowledge is None
    assert "allow steps" in plan.problem
    document = plan_document(valve, expected_valve(valve, None), [plan])
    assert document["best_sequence"] is None
    assert document["sequences"][0]["fastest_rate_pa_per_s"] is None


def test_the_terminal_compares_all_sequences_in_80_columns() -> None:
    answer = planned("FV-101", "--config", str(EXAMPLE))
    assert answer.exit_code == 0, answer.output
    assert max(len(line) for line in answer.output.splitlines()) <= 80
    for words in ("triangle", "multi_rate", "dwell", "assumed", "Nothing moves", "steps is not possible"):
        assert words in answer.output
    assert "…" not in answer.output
    words = " ".join(answer.output.split())
    assert "Friction varies as that of a usual packing: by 2.5 % from breakaway to breakaway" in words
    assert "triangle does not tell m and DV: friction that varies hides it, whatever the sensor." in words
    assert "A test without --sequence runs multi_rate." in answer.output


def test_the_service_is_asked_for_the_last_test(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def get(client: httpx.Client, path: str, **_: object) -> httpx.Response:
        asked.append(f"{client.base_url}".rstrip("/") + path)
        return httpx.Response(200, json={"last_result": last_test(1.0e-5)})

    monkeypatch.setattr(httpx.Client, "get", get)
    answer = CliRunner().invoke(app, ["plan", "FV-101", "--config", str(EXAMPLE), "--json"])
    document = json.loads(answer.stdout)
    assert asked == ["http://127.0.0.1:8321/valves/FV-101"]
    assert document["schema"] == "breakaway/plan/1"
    assert document["parameters"]["values"]["F_c"] == 2241.1
    assert document["sampling"]["position_noise_m"] == 3.0e-6
    by_name = {one["sequence"]: one for one in document["sequences"]}
    assert by_name["multi_rate"]["parameters"]["m"]["half_width_percent"] < 3.0
    known = by_name["triangle"]["parameters"]["DV"]["known_instead"]
    assert known["value"] == pytest.approx(2669.4, abs=0.1)


def test_a_service_that_wants_a_token_is_not_said_to_know_nothing_of_the_valve(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("BREAKAWAY_TOKEN", "bw_1_secret")
    sent: list[str] = []

    def get(client: httpx.Client, _path: str, **_: object) -> httpx.Response:
        sent.append(client.headers["Authorization"])
        return httpx.Response(401, json={})

    monkeypatch.setattr(httpx.Client, "get", get)
    answer = CliRunner().invoke(app, ["plan", "FV-101", "--config", str(EXAMPLE), "--sequence", "triangle", "--json"])
    assert sent == ["Bearer bw_1_secret"]
    assert "without a token" in answer.stdout
    assert "does not know the valve" not in answer.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["FV-9"], "FV-9"),
        (["FV-101", "--sequence", "waltz"], "waltz"),
        (["FV-101", "--sequence", "triangle", "--override", "cycle=2"], "it knows low_pa"),
        (
            ["FV-101", "--sequence", "triangle", "--override", "speed=2"],
            "speed: this key is unknown, known here are low_pa, high_pa, period_s, cycles: correct them\n",
        ),
        (["FV-101", "--sequence", "triangle", "--override", "cycles:2"], "KEY=NUMBER"),
        (["FV-101", "--override", "cycles=2"], "name it by --sequence"),
        (["FV-101", "--sequence", "triangle", "--override", "period_s=2"], "limits.pressure_rate_pa_per_s"),
    ],
)
def test_a_request_that_cannot_be_planned_ends_with_one_sentence(arguments: list[str], words: str) -> None:
    answer = planned(*arguments, "--config", str(EXAMPLE))
    assert isinstance(answer.exception, RequestError)
    assert words in f"{answer.exception}\n"


def test_an_override_changes_the_one_sequence() -> None:
    answer = planned("FV-101", "--config", str(EXAMPLE), "--sequence", "triangle", "--override", "cycles=1", "--json")
    assert json.loads(answer.stdout)["sequences"][0]["duration_s"] == 20.0
