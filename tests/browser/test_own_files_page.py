"""A file of ones own, given to the page: its result in words, and what is asked for."""

from __future__ import annotations

from pathlib import Path

from selenium.webdriver.common.by import By

from tests.support.gateway import Gateway
from tests.support.tablets import Tablet
from tests.support.wired_plant import TAG

CSV = "Zeit [ms];Druck [bar];Hub [%]\n0;0,1;0\n100;0,2;25,5\n"


def test_a_file_is_sent_and_its_result_stands_below(service: Gateway, browser: Tablet, tmp_path: Path) -> None:
    (tmp_path / "hub.csv").write_text(CSV, encoding="latin-1")
    browser.open(f"{service.url}/ui/recordings")
    browser.see("input[name=recording]").send_keys(str(tmp_path / "hub.csv"))
    browser.press("#analyse button")
    browser.until(lambda: "part nameplate is missing" in browser.text("#analyse-words"), "the nameplate is asked for")
    browser.see("select[name=valve] option:nth-of-type(2)").click()
    assert browser.run("return document.querySelector('select[name=valve]').value") == TAG
    browser.write("input[name=map]", "position_m=Hub [%]")
    browser.press("#analyse button")
    browser.until(lambda: "Friction" in browser.text("#analysed-words"), "the result is shown")
    assert "Dead band" in browser.text("#analysed-words")
    assert browser.text("#analyse-words") == ""
    assert browser.driver.find_elements(By.CSS_SELECTOR, "#trouble:not([hidden])") == []
