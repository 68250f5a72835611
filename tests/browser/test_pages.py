from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from service.model.run import RunState
from service.store.store import Store
from service.tablet import script
from service.words.languages import Language
from tests.browser.conftest import store_test
from tests.support.gateway import Gateway
from tests.support.wired_plant import TAG
from valve.messages import say

PAGES = ("/", "/ui/night", "/ui/recordings", f"/ui/valves/{TAG}", f"/ui/valves/{TAG}/start", "/ui/sign-in", "TEST")
FIRST_LOAD_BYTES = 100_000
PICTURE_BYTES = 40_000


def _address(service: Gateway, page: str) -> str:
    if page != "TEST":
        return page
    return f"/ui/tests/{service.client.get('/tests', params={'valve': TAG}).json()['tests'][-1]['id']}"


def _linked(text: str) -> set[str]:
    return {address.replace("&amp;", "&") for address in re.findall(r'(?:src|href)="([^"#]+)"', text)}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_loads_nothing_from_elsewhere_and_says_so_to_the_browser(service: Gateway, page: str) -> None:
    answer = service.client.get(_address(service, page))
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"].startswith("default-src 'self'; object-src 'none'")
    assert not {address for address in _linked(answer.text) if urlsplit(address).netloc}
    assert "<script>" not in answer.text
    assert " style=" not in answer.text
    assert not re.search(r"\son[a-z]+=", answer.text)


def test_the_first_load_weighs_at_most_100_kilobytes(service: Gateway) -> None:
    page = service.client.get("/")
    parts = [service.client.get(address) for address in _linked(page.text) if address.startswith("/ui/static/")]
    assert len(parts) == 3
    assert all(part.headers["cache-control"].endswith("immutable") for part in parts)
    assert len(page.content) + sum(len(part.content) for part in parts) <= FIRST_LOAD_BYTES


def test_every_part_of_the_script_is_sent(service: Gateway) -> None:
    folder = Path(script.__file__).parent / "script_parts"
    parts = {file.stem: file.read_text(encoding="utf-8") for file in folder.iterdir()}
    sent = service.client.get(f"/ui/static/{script.script_name(Language.ENGLISH)}")
    assert sent.headers["content-type"].startswith("text/javascript")
    assert set(parts) == set(script.PARTS)
    assert all(text in sent.text for text in parts.values())


def test_each_picture_is_small_names_what_it_shows_and_loads_nothing(service: Gateway) -> None:
    seen = 0
    for page in (_address(service, "TEST"), f"/ui/valves/{TAG}"):
        for address in _linked(service.client.get(page).text):
            if not address.startswith("/ui/figures/"):
                continue
            picture = service.client.get(address)
            assert picture.headers["content-type"] == "image/svg+xml", address
            assert len(picture.content) <= PICTURE_BYTES, address
            assert "<title" in picture.text
            assert "<desc" in picture.text
            assert not re.findall(r'href="(?!#)', picture.text)
            seen += 1
    assert seen == 6


@pytest.mark.parametrize(("units", "friction"), [("si", "752.0 ± 2.0 N"), ("psi", "169.06 ± 0.45 lbf")])
def test_figures_are_shown_in_the_units_that_the_browser_keeps(service: Gateway, units: str, friction: str) -> None:
    with httpx.Client(base_url=service.url, cookies={"breakaway-units": units}, timeout=60.0) as client:
        assert friction in client.get(f"/ui/valves/{TAG}").text


@pytest.mark.parametrize("page", [page for page in PAGES if page != "/ui/sign-in"])
def test_no_sentence_keeps_units_that_were_not_chosen(service: Gateway, page: str) -> None:
    with httpx.Client(base_url=service.url, cookies={"breakaway-units": "psi"}, timeout=60.0) as client:
        said = re.sub(r"<[^>]+>", " ", client.get(_address(service, page)).text)
        assert re.findall(r"\d\s+(?:k?Pa|bar|m|mm|µm|um|N|N/mm|kg)\b(?![/·*])", said) == []


def test_a_bad_end_is_told_in_the_chosen_units_on_its_page_and_in_its_report(service: Gateway) -> None:
    run = store_test(service, 46.0, 0.0, state=RunState.FAILED)
    error = say(
        "stuck",
        "{tag}: the pressure changed by {changed:.4g Pa} and the stem stood at {at:.1e m}: look at packing and seat",
        tag=TAG,
        changed=8.049e4,
        at=2.0e-6,
    )
    service.part(Store).runs.save(replace(run, error=error, acknowledged_at=run.created_at, acknowledgement="eased"))
    for address in (f"/ui/tests/{run.id}", f"/tests/{run.id}/report?format=html"):
        with httpx.Client(base_url=service.url, cookies={"breakaway-units": "psi"}, timeout=60.0) as client:
            said = re.sub(r"<style.*?</style>|<[^>]+>", " ", client.get(address).text, flags=re.DOTALL)
        assert "The pressure changed by 11.67 psi and the stem stood at 0.00008 in: look at packing" in said
        assert re.findall(r"\d\s+(?:k?Pa|bar|m|mm|µm|um|N|N/mm|kg)\b(?![/·*])", said) == []


def test_a_result_leads_to_its_report(service: Gateway) -> None:
    page = service.client.get(_address(service, "TEST")).text
    (address,) = {one for one in _linked(page) if one.endswith("/report")}
    report = service.client.get(address, headers={"Accept": "text/html"})
    assert report.status_code == 200
    assert f"Valve {TAG}" in report.text


@pytest.mark.parametrize("page", ["/ui/valves/XV-9", "/ui/valves/XV-9/start", "/ui/tests/20200101T000000Z-00000000"])
def test_what_is_not_there_is_a_page_that_says_so(service: Gateway, page: str) -> None:
    answer = service.client.get(page)
    assert answer.status_code == 404
    assert "is unknown" in answer.text


def test_the_model_with_the_cause_stands_beside_the_methods(service: Gateway) -> None:
    text = service.client.get(_address(service, "TEST")).text
    assert "with the cause in the model" in text
    assert "52.5 N/mm" in text


@pytest.mark.parametrize("page", ["/", "/ui/night", f"/ui/valves/{TAG}"])
def test_the_next_check_is_told_by_the_plants_clock(service: Gateway, page: str) -> None:
    assert "-01-01 01:15 CET" in service.client.get(page).text


def test_sign_in_leads_to_pages_of_this_service_alone(service: Gateway) -> None:
    for wanted in ("//elsewhere.example/", "https://elsewhere.example/", "/\\elsewhere.example"):
        assert 'data-next="/"' in service.client.get("/ui/sign-in", params={"next": wanted}).text


def test_a_tag_or_a_reason_never_becomes_markup(service: Gateway) -> None:
    answer = service.client.get("/", params={"find": "<script>alert(1)</script>"})
    assert "<script>alert" not in answer.text
    assert "&lt;script&gt;alert" in answer.text


def test_an_analysis_of_another_version_is_shown_as_far_as_it_goes(service: Gateway) -> None:
    old = {"schema": "breakaway/analysis/0", "recording": {"samples": 7}, "estimates": [], "health": {"reasons": []}}
    run = store_test(service, 40.0, 0.0)
    service.part(Store).runs.save(replace(run, analysis=old))
    assert "Causes were not looked for" in service.client.get(f"/ui/tests/{run.id}").text
    assert service.client.get(f"/ui/figures/tests/{run.id}/signature.svg").status_code == 404
    assert service.client.get(f"/ui/valves/{TAG}").status_code == 200


def test_a_test_that_nothing_explains_leads_to_the_next_one(service: Gateway) -> None:
    run = store_test(service, 41.0, 612.0)
    assert run.analysis is not None
    found = {**run.analysis["discrepancy"], "verdict": "unexplained", "causes": [], "gain": None}
    service.part(Store).runs.save(replace(run, analysis={**run.analysis, "discrepancy": found}))
    page = service.client.get(f"/ui/tests/{run.id}").text
    assert "Repeat with the sequence diagnostic" in page
    assert f'href="/ui/valves/{TAG}/start?sequence=diagnostic"' in page


def test_figures_with_their_limits_stand_above_the_misfit_of_a_test_that_nothing_is_wrong_with(
    service: Gateway,
) -> None:
    run = store_test(service, 44.0, 640.0)
    analysis = run.analysis or {}
    found = {**analysis["discrepancy"], "verdict": "none", "causes": [], "gain": None}
    (change,) = analysis["health"]["changes"]
    kept = {**change, "change": 28.0, "limit": 153.0}
    made = {
        **analysis,
        "discrepancy": found,
        "health": {"ne107": "N", "reasons": ["nothing is wrong"], "changes": [kept]},
    }
    service.part(Store).runs.save(replace(run, analysis=made))
    page = service.client.get(f"/ui/tests/{run.id}").text
    order = [
        "Normal",
        "Nothing is wrong.",
        "No fault found",
        "up 4.6 %, 25 % is allowed",
        "signature.svg",
        "may differ by 153 N",
        "time.svg",
    ]
    assert not [words for words in order if words not in page]
    places = [page.index(words) for words in order]
    assert places == sorted(places)
    assert "coordinate.svg" not in page


def test_a_named_cause_is_told_once_with_its_pictures_behind_it(service: Gateway) -> None:
    run = store_test(service, 45.0, 640.0)
    analysis = run.analysis or {}
    (cause,) = analysis["discrepancy"]["causes"]
    health = {"ne107": "M", "reasons": [f"{cause['sentence']} {cause['action']}", "Friction is up."], "changes": []}
    service.part(Store).runs.save(replace(run, analysis={**analysis, "health": health}))
    page = service.client.get(f"/ui/tests/{run.id}").text
    assert page.count(cause["sentence"]) == 1
    places = [page.index(words) for words in ("Friction is up.", cause["sentence"], "signature.svg", "coordinate.svg")]
    assert places == sorted(places)


def test_the_notes_of_an_analysis_stand_beside_its_diagnosis(service: Gateway) -> None:
    run = store_test(service, 42.0, 612.0)
    note = "The moving mass is 2 times the nameplate's 1.36 kg."
    service.part(Store).runs.save(replace(run, analysis={**(run.analysis or {}), "notes": [note]}))
    assert "The moving mass is 2 times" in service.client.get(f"/ui/tests/{run.id}").text
    assert "The moving mass is 2 times" in service.client.get(f"/tests/{run.id}/report?format=html").text


def test_a_reason_that_several_figures_share_is_told_once(service: Gateway) -> None:
    run = store_test(service, 43.0, 612.0)
    reason, analysis = "the branches share too little travel", run.analysis or {}
    not_given = dict.fromkeys(("friction_mean_n", "friction_max_n", "spring_rate_n_per_m"))
    signature = {**analysis["signature"], **not_given, "notes": dict.fromkeys(not_given, reason), "curve": None}
    service.part(Store).runs.save(replace(run, analysis={**analysis, "signature": signature}))
    page = service.client.get(f"/ui/tests/{run.id}").text
    assert page.count(reason) == 1
    assert "<strong>Friction, mean; Friction, highest; Spring rate:</strong>" in page
    assert "This recording shows no signature" in page
    report = service.client.get(f"/tests/{run.id}/report?format=html").text
    assert report.count(reason) == 1


def test_every_instant_is_told_with_its_zone(service: Gateway) -> None:
    for page in ("/", f"/ui/valves/{TAG}", _address(service, "TEST")):
        text = service.client.get(page).text
        assert not re.findall(r"\d{4}-\d\d-\d\d \d\d:\d\d(?! [A-Z+-])", text), page


def test_a_phone_gets_the_trend_below_each_other_and_figures_open_by_themselves(service: Gateway) -> None:
    found = re.search(r'srcset="([^"]+trend\.svg[^"]+)"', service.client.get(f"/ui/valves/{TAG}").text)
    assert found is not None
    shapes = []
    for address in (unescape(found[1]), unescape(found[1]).replace("&narrow=1", "")):
        box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', service.client.get(address).text)
        assert box is not None
        shapes.append(float(box[1]) / float(box[2]))
    assert shapes[0] < 0.6
    assert shapes[1] > 1.0
    opened = re.findall(r'<a class="open" href="([^"]+)"', service.client.get(_address(service, "TEST")).text)
    assert {re.sub(r".*/(\w+)\.svg.*", r"\1", one) for one in opened} >= {"time", "methods"}
    assert all(service.client.get(unescape(one)).headers["content-type"].startswith("image/svg") for one in opened)
