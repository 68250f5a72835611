"""What the page of a running test shows of what the test knows so far."""

from __future__ import annotations

import re
from typing import Any

from service.runs.service import Runs
from tests.support.gateway import Gateway
from tests.support.tablets import LANDSCAPE, PHONE, Tablet
from tests.support.wired_plant import TAG

LONG = {"sequence": "triangle", "overrides": {"period_s": 4.0, "cycles": 2}}
WIDTH = re.compile(r"M([\d.]+) [\d.]+H([\d.]+)")


def estimate(time_s: float, breakaways: int, half_n: float | None) -> dict[str, Any]:
    coulomb = {"value": 1423.0, "ci95": [1423.0 - 30.0, 1423.0 + 30.0]}
    static = None if half_n is None else {"value": 1707.0, "ci95": [1707.0 - half_n, 1707.0 + half_n]}
    return {"time_s": time_s, "breakaways": breakaways, "parameters": {"F_c": coulomb, "F_s": static}}


def test_intervals_narrow_on_the_page_and_a_breakaway_twice_the_last_is_a_warning(
    service: Gateway, browser: Tablet
) -> None:
    answer = service.client.post("/tests/run", json={"valve": TAG, "until": {"F_s": "5 %"}, **LONG})
    assert answer.status_code == 202, answer.text
    test_id = answer.json()["id"]

    def tell(kind: str, data: dict[str, Any]) -> None:
        live = service.part(Runs)._live.find(test_id)
        assert live is not None
        service.call(lambda: live.events.append(kind, data))

    try:
        first = service.client.get(f"/ui/tests/{test_id}").text
        assert "The first estimate comes at the first turning point." in first
        assert "Ends once it knows F_s to 5 %." in first
        assert '<p id="notice" class="panel big" role="alert" hidden></p>' in first
        # all at once: the motion takes 8 s, and a busy machine's browser takes as long
        tell("estimate", estimate(2.0, 1, None))
        for time_s, half_n in ((4.0, 300.0), (6.0, 90.0), (8.0, 40.0)):
            tell("estimate", estimate(time_s, int(time_s / 2.0), half_n))
        tell("notice", {"kind": "breakaway", "time_s": 5.0, "force_n": 3600.0, "last_n": 1700.0, "sentence": "..."})
        browser.open(f"{service.url}/ui/tests/{test_id}")
        browser.until_reads("#so-far-strips", "Friction at breakaway (F_s): 1707 N (1667 to 1747), ±2.3")
        browser.until_reads("#so-far-words", "4 breakaways after 8 s")
        strip = browser.driver.find_elements("css selector", "#so-far-strips svg")[1]
        assert "1667 to 1747" in str(strip.get_attribute("aria-label"))
        lines = strip.find_elements("css selector", "path")
        widths = [
            float(end) - float(start) for one in lines for start, end in WIDTH.findall(str(one.get_attribute("d")))
        ]
        assert len(widths) == 3
        assert widths[0] > widths[1] > widths[2] > 0.0
        assert [one.get_attribute("stroke-width") for one in lines] == ["2", "2", "4"]
        browser.until_reads("#notice", "it takes 3600 N, twice its last breakaway of 1700 N")
        assert "alarm" in str(browser.see("#notice").get_attribute("class"))
        forces = {"breakaway": 5, "time_s": 5.0, "force_n": 3600.0, "last_n": 1700.0, "times": 2.1}
        tell("notice", {"kind": "out_of_family", **forces, "sentence": "..."})
        browser.until_reads("#notice", "The test ends early: the stem takes 3600 N, twice its last breakaway of 1700 N")
        assert "alarm" in str(browser.see("#notice").get_attribute("class"))
        browser.turn(PHONE)
        assert browser.run("return document.documentElement.scrollWidth <= window.innerWidth")
    finally:
        browser.turn(LANDSCAPE)
        service.client.post(f"/tests/{test_id}/stop")
        service.client.post(f"/tests/{test_id}/acknowledge", json={"note": "the test is over"})
