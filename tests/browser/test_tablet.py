from __future__ import annotations

import re
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

import pytest
from sqlalchemy import update

from service.access.access import Access
from service.access.principal import Role
from service.model.run import RunState
from service.runs.service import Runs
from service.store.schema_access import SESSIONS
from service.store.store import Store
from service.words.languages import Language
from tests.browser.conftest import store_test
from tests.support.gateway import Gateway
from tests.support.made_analysis import ACTION, MISSING
from tests.support.tablets import LANDSCAPE, PHONE, PORTRAIT, Tablet
from tests.support.wired_plant import SAFE_PA, TAG

LEAST_TARGET_PX = 118  # 20 mm on a tablet of 10.1 inches and 1280x800, whose pixel is 0.17 mm
AGE = re.compile(r"(\d+)\ss ago")
LIVE_BYTES_PER_S = 5_000
COUNT_CHANGES = """
window.changes = {position: 0, percent: 0};
for (const id of Object.keys(window.changes)) {
  new MutationObserver(() => { window.changes[id] += 1; }).observe(document.getElementById(id), { childList: true });
}
"""
QUICK = {"sequence": "triangle", "overrides": {"period_s": 4.0, "cycles": 2}}


def start_by_hand(one: Tablet, service: Gateway) -> str:
    """Start a test as a technician does, from the list of valves; the id of the test."""
    one.open(service.url)
    one.press(".tag a")
    one.press("#to-start")
    one.press("[value=steps]")
    one.press("#arm")
    one.press("#go")
    one.until(lambda: "/ui/tests/" in one.driver.current_url, "the running test is shown")
    return str(one.driver.current_url.rpartition("/")[2])


def start_by_rest(service: Gateway) -> str:
    answer = service.client.post("/tests/run", json={"valve": TAG, **QUICK})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


@pytest.fixture(autouse=True)
def _leaves_a_valve_that_may_be_tested(service: Gateway) -> Iterator[None]:
    yield
    last = service.client.get("/tests", params={"valve": TAG, "limit": 1}).json()["tests"][0]
    end(service, last["id"])
    service.client.post(f"/tests/{last['id']}/acknowledge", json={"note": "the test is over"})


def end(service: Gateway, test_id: str) -> None:
    service.client.post(f"/tests/{test_id}/stop")
    service.client.get(f"/tests/{test_id}/events")  # it ends when the test has


def test_a_technician_starts_watches_and_stops_a_test(service: Gateway, browser: Tablet) -> None:
    test_id = start_by_hand(browser, service)
    browser.until(lambda: browser.text("#position") not in ("", "–"), "a position is shown")
    browser.until_reads("#phase", "Moving")
    before_pa = service.asked_pa()
    browser.until(lambda: abs(service.asked_pa() - before_pa) > 1000.0, "the valve is driven")
    browser.press("#stop")
    browser.until_reads("#state", "Stopped")
    shown = "return document.querySelector('[src*=\"trace.svg\"]')?.naturalWidth ?? 0"
    browser.until(lambda: browser.run(shown), "what was measured until then is drawn", 60.0)
    assert service.asked_pa() == pytest.approx(SAFE_PA, abs=100.0)
    assert service.client.get(f"/tests/{test_id}").json()["state"] == "stopped"


def test_the_second_step_stays_locked_without_the_first_and_after_a_change(service: Gateway, browser: Tablet) -> None:
    browser.open(f"{service.url}/ui/valves/{TAG}/start")
    browser.until(lambda: browser.see("#arm").is_enabled(), "the first step is open")
    assert not browser.see("#go").is_enabled()
    browser.press("#arm")
    browser.until(lambda: browser.see("#go").is_enabled(), "the second step is open")
    browser.press("[name=label][value=as_left]")
    assert not browser.see("#go").is_enabled()
    assert "steps" in browser.text("#summary")


def test_two_tablets_watch_one_test_and_lose_nothing_while_one_has_no_network(
    service: Gateway, browser: Tablet, second_browser: Tablet
) -> None:
    test_id = start_by_rest(service)
    browser.open(f"{service.url}/ui/tests/{test_id}")
    second_browser.open(service.url)
    second_browser.press(f'a[href="/ui/tests/{test_id}"]')
    second_browser.until(lambda: second_browser.text("#position") not in ("", "–"), "both see it")
    second_browser.lose_the_network()
    second_browser.until_reads("#lost", "The test goes on without this tablet")
    frozen = second_browser.see("#live").get_attribute("data-points")
    second_browser.find_the_network()
    second_browser.until(lambda: not second_browser.see("#lost").is_displayed(), "the line is back")
    assert second_browser.see("#stop").is_displayed()
    last = _points_at_the_end(browser, second_browser)
    assert last[0] == last[1] > int(frozen or 0)
    for one in (browser, second_browser):
        one.until_reads("#state", "Completed", 30.0)
        assert ACTION in one.text("#main")
        assert MISSING in one.text("#main")
        assert "maximum likelihood" in one.text(".methods")


def _points_at_the_end(first: Tablet, second: Tablet) -> list[int]:
    """Return how many points both have drawn when both have seen the same end of the motion."""
    keep = (
        "window.seen = 0; setInterval(() => { window.seen = Number(document.getElementById('live')?.dataset.points "
        "|| window.seen); sessionStorage.setItem('seen', window.seen); }, 20);"
    )
    for one in (first, second):
        one.run(keep)
    for one in (first, second):
        one.until(lambda one=one: one.driver.find_elements("id", "state"), "the result follows", 30.0)  # type: ignore[misc]
    return [int(one.run("return sessionStorage.getItem('seen')")) for one in (first, second)]


def test_a_second_start_of_the_same_valve_is_refused_in_words(
    service: Gateway, browser: Tablet, second_browser: Tablet
) -> None:
    for one in (browser, second_browser):
        one.open(f"{service.url}/ui/valves/{TAG}/start")
    second_browser.press("#arm")
    second_browser.until(lambda: second_browser.see("#go").is_enabled(), "the second tablet is armed")
    test_id = start_by_rest(service)
    second_browser.press("#go")
    second_browser.until(lambda: TAG in second_browser.text("#trouble"), "the refusal is told")
    assert "/start" in second_browser.driver.current_url
    end(service, test_id)


def test_without_a_network_nothing_that_moves_can_be_pressed_and_the_age_is_told(
    service: Gateway, browser: Tablet
) -> None:
    browser.open(f"{service.url}/ui/valves/{TAG}/start")
    browser.press("#arm")
    browser.until(lambda: browser.see("#go").is_enabled(), "armed")
    browser.lose_the_network()
    try:
        browser.until_reads("#lost", "No connection to the gateway")
        assert not any(browser.see(css).is_enabled() for css in ("#arm", "#go"))
        browser.until(lambda: int(AGE.findall(browser.text("#lost"))[0]) >= 2, "the age grows")
        browser.run("window.scrollTo(0, 0)")
        browser.see(".head .button").click()
        assert "stays as it is" in browser.text("#trouble")
        assert browser.driver.current_url.endswith("/start")
    finally:
        browser.find_the_network()
    browser.until(lambda: browser.see("#arm").is_enabled(), "the first step is open again")
    assert not browser.see("#go").is_enabled()


def test_a_stop_without_a_network_is_sent_as_soon_as_there_is_one(service: Gateway, browser: Tablet) -> None:
    test_id = start_by_rest(service)
    browser.open(f"{service.url}/ui/tests/{test_id}")
    browser.until(lambda: browser.text("#position") not in ("", "–"), "it moves")
    browser.lose_the_network()
    browser.press("#stop")
    browser.until_reads("#stop-words", "STOP IS NOT SENT")
    browser.find_the_network()
    browser.until_reads("#state", "Stopped")
    assert service.asked_pa() == pytest.approx(SAFE_PA, abs=100.0)


@pytest.mark.parametrize("size", [LANDSCAPE, PORTRAIT])
def test_both_steps_of_a_start_are_seen_without_scrolling(
    service: Gateway, browser: Tablet, size: tuple[int, int]
) -> None:
    browser.turn(size)
    browser.open(f"{service.url}/ui/valves/{TAG}/start")
    browser.until(lambda: browser.see("#arm").is_enabled(), "the first step is open")
    place = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
    first, second, what = (browser.run(place, css) for css in ("#arm", "#go", "#summary"))
    for box in (first, second, what):
        assert 0 <= box["top"] < box["bottom"] <= size[1]
    assert second["left"] - first["right"] > LEAST_TARGET_PX / 2  # no finger lies on both
    browser.turn(LANDSCAPE)


@pytest.mark.parametrize("size", [LANDSCAPE, PORTRAIT])
def test_stop_never_scrolls_away_and_is_large(service: Gateway, browser: Tablet, size: tuple[int, int]) -> None:
    browser.turn(size)
    test_id = start_by_rest(service)
    for path in (f"/ui/tests/{test_id}", f"/ui/valves/{TAG}"):
        browser.open(service.url + path)
        for place in (0, 100_000):
            browser.run("window.scrollTo(0, arguments[0])", place)
            box = browser.run("return document.getElementById('stop').getBoundingClientRect().toJSON()")
            assert 0 <= box["top"] < box["bottom"] <= size[1]
            assert min(box["width"], box["height"]) >= LEAST_TARGET_PX
            on_top = "const b = document.getElementById('stop').getBoundingClientRect();"
            on_top += (
                "return document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2).closest('#stop') !== null"
            )
            assert browser.run(on_top)
    end(service, test_id)
    browser.turn(LANDSCAPE)


def test_the_live_view_draws_ten_positions_a_second_writes_four_and_takes_little_of_the_network(
    service: Gateway, browser: Tablet
) -> None:
    test_id = start_by_rest(service)
    browser.open(f"{service.url}/ui/tests/{test_id}")
    browser.until_reads("#phase", "Moving")
    browser.run(COUNT_CHANGES)
    browser.requests()
    first, began = int(browser.see("#live").get_attribute("data-points") or 0), time.monotonic()
    time.sleep(3.0)
    points, took_s = int(browser.see("#live").get_attribute("data-points") or 0) - first, time.monotonic() - began
    received = sum(
        message["params"].get("encodedDataLength", 0)
        for message in browser.requests()
        if message["method"] in ("Network.dataReceived", "Network.loadingFinished")
    )
    changes = browser.run("return window.changes")
    end(service, test_id)
    assert points / took_s >= 8.0
    for name in ("position", "percent"):  # each change lays the page out again: a slow tablet would drop frames
        assert 1.0 <= changes[name] / took_s <= 4.5, changes
    assert received / took_s <= LIVE_BYTES_PER_S


def test_a_person_signs_in_and_out_and_a_lost_session_stops_no_test(guarded_service: Gateway, browser: Tablet) -> None:
    service = guarded_service
    service.part(Access).add_user("anna", Role.OPERATOR, "a long enough password", by="test")
    browser.open(service.url)
    browser.write("[name=name]", "anna")
    browser.write("[name=password]", "not this one at all")
    browser.press("[type=submit]")
    browser.until_reads("#sign-in-words", "wrong")
    browser.driver.add_cookie({"name": "breakaway-language", "value": Language.GERMAN.value})
    browser.open(service.url)
    browser.write("[name=name]", "anna")
    browser.write("[name=password]", "not this one either")
    browser.press("[type=submit]")
    browser.until_reads("#sign-in-words", "Passwort")
    browser.driver.delete_all_cookies()
    browser.open(service.url)
    browser.write("[name=name]", "anna")
    browser.write("[name=password]", "a long enough password")
    browser.press("[type=submit]")
    browser.until(lambda: "anna" in browser.text("header"), "the list is shown")
    test_id = start_by_hand(browser, service)
    browser.until_reads("#phase", "Moving")
    browser.driver.delete_all_cookies()
    browser.press("#stop")
    browser.until_reads("#trouble", "You are signed out")
    browser.until_reads("#stop-words", "STOP IS NOT SENT: you are signed out. Sign in above, then press Stop again.")
    browser.press("#trouble a")
    browser.write("[name=name]", "anna")
    browser.write("[name=password]", "a long enough password")
    browser.press("[type=submit]")
    browser.until(lambda: browser.driver.current_url.endswith(f"{service.url}/ui/tests/{test_id}"), "back at the test")
    run = service.call(lambda: service.part(Runs).as_it_stands(service.part(Store).runs.get(test_id)))
    assert run.state in (RunState.RUNNING, RunState.ANALYZING, RunState.COMPLETED)
    assert run.requested_by == "anna"
    if run.state is RunState.RUNNING:
        browser.press("#stop")
    browser.until(lambda: browser.driver.find_elements("id", "state"), "the result", 20.0)
    browser.press("#sign-out")
    browser.until(lambda: "/ui/sign-in" in browser.driver.current_url, "signed out")


@pytest.mark.parametrize("where", ["tests", "valves"])
def test_an_idle_tablet_locks_its_pages_and_keeps_its_stop(
    guarded_service: Gateway, browser: Tablet, where: str
) -> None:
    service, name = guarded_service, f"idle-{where}"
    service.part(Access).add_user(name, Role.OPERATOR, "a long enough password", by="test")
    browser.driver.delete_all_cookies()
    browser.open(service.url)
    browser.write("[name=name]", name)
    browser.write("[name=password]", "a long enough password")
    browser.press("[type=submit]")
    browser.until(lambda: name in browser.text("header"), "the list is shown")
    test_id = start_by_hand(browser, service)
    browser.until_reads("#phase", "Moving")
    if where == "valves":
        browser.open(f"{service.url}/ui/valves/{TAG}")
    with service.part(Store).engine.begin() as connection:
        connection.execute(update(SESSIONS).values(last_seen_at=datetime.now(UTC) - timedelta(minutes=16)))
    browser.run("document.dispatchEvent(new Event('visibilitychange'))")  # as when somebody wakes the tablet
    browser.until_reads("#trouble", "this page is locked. The test goes on, and STOP still works. Sign in")
    assert not browser.see("main").is_displayed()
    browser.press("#stop")
    browser.until_reads("#stop-words", "Stopped. Signal 20 kPa, read back.")
    assert service.part(Store).runs.get(test_id).error == f"stopped by {name}"


def test_a_valve_that_needs_a_permit_is_started_with_its_number(permit_service: Gateway, browser: Tablet) -> None:
    browser.open(f"{permit_service.url}/ui/valves/{TAG}/start")
    browser.until_reads("#permissives", "Enter the work permit's number")
    assert not browser.see("#arm").is_enabled()
    assert browser.text("#armed-words") == "Both steps are locked. See what is missing"
    browser.write("#permit", "W-17")
    browser.press("#arm")
    browser.until_reads("#armed-words", "Step 2 is open")
    browser.press("#go")
    browser.until(lambda: "/ui/tests/" in browser.driver.current_url, "the running test is shown")
    test_id = browser.driver.current_url.rpartition("/")[2]
    end(permit_service, test_id)
    shown = permit_service.client.get(f"/tests/{test_id}").json()["permissives"]["permissives"]
    assert {one["name"]: one["met"] for one in shown}["permit"] is True


def test_a_test_that_is_to_end_early_says_so_before_and_a_refusal_has_the_words_of_the_api(
    service: Gateway, browser: Tablet
) -> None:
    browser.open(f"{service.url}/ui/valves/{TAG}/start")
    browser.press("[value=steps]")
    for said, words in (("77", "at most 50 %"), ("2,5", "")):
        browser.write("[data-symbol=F_s]", said)
        browser.until_reads("#summary", f"or until it knows breakaway F_s to ± {said} %")
        browser.press("#arm")
        browser.until_reads("#armed-words", "Step 2 is open")
        browser.press("#go")
        if words:
            wanted = {"valve": TAG, "sequence": "steps", "until": {"F_s": "77 %"}}
            detail = service.client.post("/tests/run", json=wanted).json()["detail"]
            assert words in detail
            browser.until_reads("#trouble", detail)
    browser.until(lambda: "/ui/tests/" in browser.driver.current_url, "the running test is shown")
    test_id = browser.driver.current_url.rpartition("/")[2]
    assert service.client.get(f"/tests/{test_id}").json()["until"] == {"F_s": "2.5 %"}
    end(service, test_id)


def test_a_refusal_is_read_in_the_units_of_the_page_and_stays_in_si_for_machines(service: Gateway) -> None:
    wanted = {"valve": TAG, "sequence": "triangle", "overrides": {"high_pa": 990_000.0}}
    machine = service.client.post("/tests/run", json=wanted).json()
    assert "990000 Pa" in machine["detail"]
    assert "shown" not in machine
    shown = service.client.post("/tests/run", json=wanted, headers={"Breakaway-Units": "bar"}).json()
    assert shown["detail"] == machine["detail"]
    assert "9.900 bar" in shown["shown"]
    assert "Pa" not in shown["shown"]


@pytest.mark.parametrize("size", [LANDSCAPE, PORTRAIT])
def test_what_is_missing_is_seen_before_anybody_scrolls(
    permit_service: Gateway, browser: Tablet, size: tuple[int, int]
) -> None:
    browser.turn(size)
    browser.open(f"{permit_service.url}/ui/valves/{TAG}/start")
    browser.until_reads("#permissives", "Enter the work permit's number")
    ends = browser.run(
        "return ['#permissives .missing', '#permit', '.panel.steps'].map((css) => {"
        " const box = document.querySelector(css).getBoundingClientRect(); return [box.top, box.bottom]; })"
    )
    (top, bottom), (field_top, _), (steps_top, _) = ends
    assert field_top >= 0.0
    assert 0.0 <= top < bottom <= steps_top, "it lies below the fold or under the steps"
    assert browser.run("return scrollY") == 0
    browser.turn(LANDSCAPE)


def test_a_bad_end_stands_as_an_alarm_until_somebody_has_looked(service: Gateway, browser: Tablet) -> None:
    run = store_test(service, 0.0, 0.0, state=RunState.FAILED)
    browser.open(service.url)
    assert "Safe state not confirmed" in browser.text("#valves")
    browser.press(".tag a")
    assert not browser.driver.find_elements("id", "to-start")
    browser.write("[name=note]", "the wire was loose")
    browser.press("#acknowledge button")
    browser.until(lambda: browser.driver.find_elements("id", "to-start"), "a test may start again")
    browser.open(f"{service.url}/ui/tests/{run.id}")
    assert "the wire was loose" in browser.text("#main")


def test_a_stem_that_has_not_closed_is_seen_without_scrolling_and_a_page_that_is_open_comes_to_know_it(
    judged_service: Gateway, browser: Tablet
) -> None:
    service, verdict = judged_service, "return document.getElementById('stands')?.dataset.verdict ?? ''"
    service.client.post("/tests/run", json={"valve": TAG, "overrides": {"cycles": 1, "period_s": 4.0}})
    test_id = service.client.get("/tests").json()["tests"][0]["id"]
    browser.open(f"{service.url}/ui/tests/{test_id}")
    browser.until(lambda: browser.run(verdict) == "moving", "the motion is over and the stem is said to move")
    browser.until(
        lambda: "moving to 0 mm (closed): it is looked at 25 s after" in browser.text("#stands"), "it is said"
    )
    browser.open(f"{service.url}/ui/valves/{TAG}")
    browser.until(lambda: "may still move" in browser.text("#condition"), "the valve's page says so too")
    assert not browser.driver.find_elements("id", "stop"), "its signal is safe: there is nothing to stop"
    browser.until(lambda: browser.driver.find_elements("id", "acknowledge"), "the open page comes to know it")
    for page in (f"/ui/valves/{TAG}", f"/ui/tests/{test_id}", "/"):
        browser.open(service.url + page)
        assert "OPEN: it has not closed." in browser.text("#main")
        assert "not at its safe position" in browser.text("#main").lower()
        assert not browser.driver.find_elements("css selector", ".mark-N"), "no tick stands beside it"
        place = "[...document.querySelectorAll('#main p')].find((one) => one.textContent.includes('has not closed'))"
        assert browser.run(f"return {place}.getBoundingClientRect().bottom") < LANDSCAPE[1]
    browser.open(f"{service.url}/ui/valves/{TAG}")
    browser.write("[name=note]", "plug freed by hand")
    browser.press("#acknowledge button")
    browser.until(lambda: browser.driver.find_elements("id", "to-start"), "a test may start again")
    assert "Somebody looked at it since: “plug freed by hand”" in browser.text("#stands")


@pytest.mark.long
def test_a_result_is_analysed_again_by_a_button_and_its_pictures_are_drawn_anew(
    service: Gateway, browser: Tablet
) -> None:
    test_id = start_by_rest(service)
    service.client.get(f"/tests/{test_id}/events")
    browser.open(f"{service.url}/ui/tests/{test_id}")
    picture = "return document.querySelector('img.figure').src"  # an open page may load itself anew
    first = browser.run(picture)
    assert "made again" not in browser.text("#h-data ~ dl")
    browser.press("#analyze")
    browser.until(lambda: "made again on" in browser.text("#h-data ~ dl"), "the new result is shown")
    assert re.search(r"made again on \S+ \S+ \S+ by breakaway", browser.text("#h-data ~ dl"))
    assert browser.run(picture) != first


def test_an_engineer_accepts_the_model_that_a_diagnosis_found(service: Gateway, browser: Tablet) -> None:
    run = store_test(service, 0.0, 700.0)
    browser.open(f"{service.url}/ui/tests/{run.id}")
    browser.press("#accept button")
    browser.until_reads("#accept-words", "Accepted")
    assert service.client.get(f"/valves/{TAG}/model").json()["test"] == run.id


CONTRASTS = """
const parse = (text) => { const n = text.match(/[\\d.]+/g).map(Number); return n.length < 4 ? [...n, 1] : n; };
const light = (c) => { const v = c / 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; };
const luminance = ([r, g, b]) => 0.2126 * light(r) + 0.7152 * light(g) + 0.0722 * light(b);
const found = [];
for (const one of document.querySelectorAll('body *')) {
  const words = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  const box = one.getBoundingClientRect();
  if (!words || !box.width || one.closest('svg, canvas, [hidden], .unseen, .skip, :disabled')) continue;
  let ground = one;
  while (ground && parse(getComputedStyle(ground).backgroundColor)[3] === 0) ground = ground.parentElement;
  const front = luminance(parse(getComputedStyle(one).color));
  const back = ground ? luminance(parse(getComputedStyle(ground).backgroundColor)) : 1;
  const ratio = (Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05);
  if (ratio < 4.5) found.push([one.tagName, one.innerText.slice(0, 40), ratio]);
}
return found;"""
UNNAMED = """
return [...document.querySelectorAll('a, button, input:not([type=hidden]), select, img, canvas, table')].filter((one) =>
  !(one.labels?.length || one.innerText?.trim() || one.getAttribute('aria-label') || one.getAttribute('alt')))
  .map((one) => one.outerHTML.slice(0, 120));"""
SMALL = """
return [...document.querySelectorAll('[data-moves], .stop, button, .button, select, header nav a')].filter((one) => {
  const box = one.getBoundingClientRect(), least = one.matches('[data-moves], .stop') ? arguments[0] : 44;
  return box.width && Math.min(box.width, box.height) < least; }).map((one) => one.outerHTML.slice(0, 120));"""


@pytest.mark.parametrize(("size", "is_dark"), [(LANDSCAPE, False), (PORTRAIT, True), (PHONE, False), (PHONE, True)])
def test_every_page_can_be_read_named_and_touched(
    service: Gateway, browser: Tablet, size: tuple[int, int], is_dark: bool
) -> None:
    browser.turn(size)
    browser.darken(is_dark=is_dark)
    test_id = service.client.get("/tests", params={"valve": TAG, "limit": 200}).json()["tests"][-1]["id"]
    failed = store_test(service, 0.0, 0.0, state=RunState.FAILED)
    for path in (
        "/",
        "/?find=nothing&state=N",
        "/ui/night",
        "/ui/recordings",
        f"/ui/valves/{TAG}",
        f"/ui/valves/{TAG}/start",
        f"/ui/tests/{test_id}",
        f"/ui/tests/{failed.id}",
        "/ui/sign-in",
    ):
        browser.open(service.url + path)
        for script in (CONTRASTS, UNNAMED, SMALL):
            assert browser.run(script, LEAST_TARGET_PX) == [], path
        levels = browser.run("return [...document.querySelectorAll('h1, h2, h3')].map((one) => Number(one.tagName[1]))")
        assert levels[0] == 1
        assert all(after <= before + 1 for before, after in pairwise(levels))
        assert browser.run("return document.documentElement.scrollWidth") <= size[0], f"{path} scrolls sideways"
    browser.turn(LANDSCAPE)
    browser.darken(is_dark=False)


def test_the_list_follows_what_is_typed_and_keeps_it_in_its_address(service: Gateway, browser: Tablet) -> None:
    browser.open(service.url + "/")
    assert TAG in browser.text("#list")
    browser.write("#find", "nowhere")
    browser.until_reads("#list", "No valve fits")
    assert browser.run("return location.search") == "?find=nowhere"
    assert browser.run("return document.activeElement.id") == "find"
    assert browser.run("return document.getElementById('said').textContent").startswith("0 of 1 valves")
    browser.write("#find", TAG[:4].lower())
    browser.until_reads("#list", TAG)
    browser.press("#since .chips li:first-child a")
    browser.until(lambda: "since=worse" in browser.run("return location.search"), "the chip is in the address")
    assert f"find={TAG[:4].lower()}" in browser.run("return location.search")
    assert browser.run("return document.querySelector('#since [aria-current]').innerText").startswith("0 worse")


def test_a_printed_list_has_its_rows_and_no_buttons(service: Gateway, browser: Tablet) -> None:
    browser.open(service.url + "/")
    browser.print_as("print")
    try:
        seen = "filter((one) => one.getBoundingClientRect().width).length"
        shown = f"return [...document.querySelectorAll(arguments[0])].{seen}"
        assert browser.run(shown, "#valves tbody tr, #valves thead th") == 6
        assert browser.run(shown, "button, select, input, header nav") == 0
    finally:
        browser.print_as("")


def test_no_page_asked_another_host_or_broke_its_own_rules(service: Gateway, browser: Tablet) -> None:
    """Runs last: it reads what the browser noted of all the pages before it."""
    entries: list[dict[str, Any]] = browser.driver.get_log("browser")  # type: ignore[no-untyped-call]
    broken = [
        one["message"]
        for one in entries
        if "Content Security Policy" in one["message"] or one["source"] == "javascript"
    ]
    assert broken == []
    asked = {m["params"]["request"]["url"] for m in browser.requests() if m["method"] == "Network.requestWillBeSent"}
    assert not {url for url in asked if not url.startswith(("http://127.0.0.1:", "data:"))}
