"""The signature's figure on a test's page: other tests laid over it, cursor, zoom, and the table beside it."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from service.model.run import Run
from service.store.store import Store
from tests.browser.conftest import store_test
from tests.support.gateway import Gateway, MadeAnalyst
from tests.support.made_analysis import FRICTION_N, made_analysis
from tests.support.tablets import LANDSCAPE, Tablet
from tests.support.wired_plant import TAG

PHONE = (320, 640)
BOX = "document.querySelector('#signature-figure svg').getBoundingClientRect()"
WHEEL = f"""
const box = {BOX};
document.querySelector('#signature-figure svg').dispatchEvent(new WheelEvent('wheel', {{deltaY: arguments[0],
  clientX: box.x + box.width / 2, clientY: box.y + box.height / 3, bubbles: true, cancelable: true}}));
"""
PINCH = f"""
const svg = document.querySelector('#signature-figure svg'), box = {BOX}, y = box.y + box.height / 3;
const send = (name, id, x) => svg.dispatchEvent(new PointerEvent(name, {{pointerId: id, pointerType: 'touch',
  clientX: box.x + box.width * x, clientY: y, bubbles: true}}));
send('pointerdown', 1, 0.45); send('pointerdown', 2, 0.55);
for (const far of [0.07, 0.09, 0.12, 0.15]) {{ send('pointermove', 1, 0.5 - far); send('pointermove', 2, 0.5 + far); }}
send('pointerup', 1, 0.35); send('pointerup', 2, 0.65);
"""


@pytest.fixture
def other(service: Gateway) -> Run:
    return store_test(service, 0.6, FRICTION_N + 100.0)  # those of other files may have no loop


@pytest.fixture
def opened(service: Gateway, browser: Tablet, other: Run) -> Iterator[tuple[Tablet, Run]]:
    run = store_test(service, 0.5, FRICTION_N + 200.0)
    browser.open(f"{service.url}/ui/tests/{run.id}")
    browser.until(lambda: browser.run("return document.querySelector('#signature-figure svg .pane')"), "it is drawn")
    yield browser, run
    browser.turn(LANDSCAPE)


def _zoom(one: Tablet) -> float:
    return float(one.run("return document.getElementById('signature').dataset.zoom ?? 1"))


def _curves(one: Tablet) -> set[str]:
    return set(one.run("return [...document.querySelectorAll('#signature-figure .curve')].map(c => c.dataset.of)"))


def test_the_baseline_lies_over_a_test_and_goes_by_its_chip(opened: tuple[Tablet, Run], other: Run) -> None:
    one, _ = opened
    assert _curves(one) == {"A", "B"}
    assert one.text(".layer").startswith("✓ shown") or "baseline" in one.text(".layer")
    one.press(".layer")
    one.until(lambda: _curves(one) == {"A"}, "the baseline is gone")
    assert one.see(".layer").get_attribute("aria-pressed") == "false"
    one.run(
        "const any = document.getElementById('any-test'); any.value = arguments[0];"
        "any.dispatchEvent(new Event('change'));",
        other.id,
    )
    one.until(lambda: _curves(one) == {"A", "B"}, "any other test is laid over it")
    one.until(lambda: other.id in str(one.see("#compared a").get_attribute("href")), "the table is held against it")


def test_the_cursor_tells_the_values_of_every_curve_at_a_travel(opened: tuple[Tablet, Run]) -> None:
    one, _ = opened
    one.run("const s = document.getElementById('cursor'); s.value = 50; s.dispatchEvent(new Event('input'));")
    words = one.text("#cursor-words")
    assert "Travel 50.0 %" in words
    found = dict(re.findall(r"([AB] \w+): ([\d.]+) %", words))
    assert set(found) == {"A opening", "A closing", "B opening", "B closing"}
    assert float(found["A opening"]) > float(found["B opening"]) > float(found["B closing"]) > float(found["A closing"])


def test_wheel_pinch_and_buttons_zoom_and_go_back_to_the_whole(opened: tuple[Tablet, Run]) -> None:
    one, _ = opened
    numbers = (
        "return [...document.querySelectorAll('#signature-figure .pane .ticks text')].map(t => t.textContent).join()"
    )
    whole = one.run(numbers)
    one.run(WHEEL, -100)
    assert _zoom(one) == pytest.approx(1.25)
    assert one.run(numbers) != whole, "the axes follow"
    one.run(WHEEL, 100)
    assert _zoom(one) == 1.0
    assert one.run(numbers) == whole
    one.run(PINCH)
    assert _zoom(one) > 2.0
    for _ in range(6):
        one.press("#zoom-out")
    assert _zoom(one) == 1.0
    one.press("#zoom-in")
    assert _zoom(one) == pytest.approx(1.6)


def test_a_narrow_screen_gets_its_own_figure_and_does_not_scroll_sideways(opened: tuple[Tablet, Run]) -> None:
    one, run = opened
    one.turn(PHONE)
    one.open(one.driver.current_url)
    view = "return document.querySelector('#signature-figure svg')?.getAttribute('viewBox')"
    one.until(lambda: str(one.run(view)).startswith("0 0 280"), f"{run.id} is drawn narrow")
    assert one.run("return document.documentElement.scrollWidth") <= PHONE[0]


def test_tests_without_a_loop_are_not_offered(service: Gateway) -> None:
    """A test of one way alone has figures, and no loop that could be laid over another one."""
    run, drawn = store_test(service, 48.0, FRICTION_N), store_test(service, 48.5, FRICTION_N)
    bare = store_test(service, 49.0, FRICTION_N)
    assert bare.analysis is not None
    bare.analysis["signature"]["curve"] = {"up": {"travel_m": [0.0]}, "down": None}
    service.part(Store).runs.save(bare)
    text = service.client.get(f"/ui/tests/{run.id}").text
    assert f'<option value="{drawn.id}">' in text
    assert bare.id not in text


def test_a_test_of_another_valve_is_not_laid_over(service: Gateway) -> None:
    run = store_test(service, 47.0, FRICTION_N)
    unknown = "20200101T000000Z-00000000"
    assert service.client.get(f"/ui/figures/tests/{run.id}/signature.svg", params={"with": unknown}).status_code == 404
    assert service.client.get(f"/ui/tests/{run.id}/compared", params={"before": unknown}).status_code == 404


def test_friction_dead_band_and_signature_are_shown_as_soon_as_the_motion_has_ended(
    service: Gateway, browser: Tablet, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_end = threading.Event()

    async def slow(*_: Any, **__: Any) -> dict[str, Any]:
        await asyncio.to_thread(may_end.wait, 300.0)
        return made_analysis()

    monkeypatch.setattr(MadeAnalyst, "analyze", slow)
    order = {"valve": TAG, "sequence": "triangle", "overrides": {"period_s": 4.0, "cycles": 2}}
    try:
        for left in (2, 1, 0):  # a machine that is busy samples too little of 8 s now and then
            test_id = service.client.post("/tests/run", json=order).json()["id"]
            browser.open(f"{service.url}/ui/tests/{test_id}")
            assert not browser.text("#early")
            browser.until_reads("#early", "The diagnosis follows", 120.0)
            assert service.client.get(f"/tests/{test_id}").json()["state"] == "analyzing"
            words = browser.text("#early")
            if "Dead band" in words or not left:
                break
            may_end.set()
            service.client.get(f"/tests/{test_id}/events")  # to its end
            may_end.clear()
        assert re.search(r"Friction\s+[\d.]+ (± [\d.]+ )?N", words), words
        assert "Dead band" in words
        loaded = "return document.querySelector('#early img').naturalWidth"
        browser.until(lambda: browser.run(loaded), "the signature is drawn")
    finally:
        may_end.set()
    browser.until(
        lambda: browser.run("return Boolean(document.getElementById('h-diagnosis'))"), "the diagnosis follows"
    )
    assert service.client.get(f"/ui/figures/tests/{test_id}/measured").status_code == 404


def test_a_label_and_a_note_are_said_on_the_page(opened: tuple[Tablet, Run]) -> None:
    one, run = opened
    one.press("#describe-open")
    one.run("document.querySelector('#describe [name=label]').value = 'as_left'")
    one.write("#describe [name=note]", "Packing replaced")
    one.press("#describe button")
    one.until_reads(".note", "Packing replaced")
    assert "as left" in one.text(".head")
    assert run.id in str(one.driver.current_url)
