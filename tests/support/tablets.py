"""A tablet: Debian's Chromium, driven by its own chromedriver, and what a hand does with it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
from selenium import webdriver
from selenium.common.exceptions import JavascriptException, StaleElementReferenceException
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

BROWSER: Final = Path("/usr/bin/chromium")
DRIVER: Final = Path("/usr/bin/chromedriver")
LANDSCAPE: Final = (1280, 800)
PORTRAIT: Final = (800, 1280)
PHONE: Final = (320, 640)  # CSS pixels, as WCAG 2.1, 1.4.10 asks


class Tablet:
    """One browser window of a tablet's size."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver
        self.turn(LANDSCAPE)

    def turn(self, size: tuple[int, int]) -> None:
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def darken(self, *, is_dark: bool) -> None:
        """Ask pages for their dark colours, or for their light ones."""
        feature = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})

    def print_as(self, media: str) -> None:
        """Show pages as they are printed (``print``), or as they are on a screen (an empty text)."""
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})

    def open(self, address: str) -> None:
        self.driver.get(address)

    def see(self, css: str) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, css)

    def text(self, css: str) -> str:
        return str(self.run("return document.querySelector(arguments[0])?.innerText ?? ''", css))

    def press(self, css: str) -> None:
        self.until(lambda: self._pressed(css), f"{css} is pressed")

    def _pressed(self, css: str) -> bool:
        """Whether it was pressed: it can be, and the page was not drawn anew under the finger."""
        try:
            if not self.see(css).is_enabled():
                return False
            self.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", css)  # as a hand does
            self.see(css).click()
        except (StaleElementReferenceException, JavascriptException):
            return False
        return True

    def write(self, css: str, words: str) -> None:
        self.see(css).clear()
        self.see(css).send_keys(words)

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def until(self, done: Callable[[], Any], what: str, timeout_s: float = 30.0) -> Any:
        """Wait until ``done`` returns something true."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            found = done()
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"{what}: not within {timeout_s:g} s; the page says: {self.text('body')[:600]}")

    def until_reads(self, css: str, words: str, timeout_s: float = 30.0) -> None:
        self.until(lambda: words.lower() in self.text(css).lower(), f"{css} reads {words!r}", timeout_s)

    def lose_the_network(self) -> None:
        self._network(offline=True)

    def find_the_network(self) -> None:
        self._network(offline=False)

    def _network(self, *, offline: bool) -> None:
        conditions = {"offline": offline, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
        self.driver.execute_cdp_cmd("Network.enable", {})
        self.driver.execute_cdp_cmd("Network.emulateNetworkConditions", conditions)

    def requests(self) -> list[dict[str, Any]]:
        """Return what the network did since the last call: Chromium's own events."""
        entries = self.driver.get_log("performance")  # type: ignore[no-untyped-call]
        messages = [json.loads(entry["message"])["message"] for entry in entries]
        return [message for message in messages if message["method"].startswith("Network.")]


@contextmanager
def tablet() -> Iterator[Tablet]:
    """Start a browser; skip where this machine has none."""
    if not (BROWSER.exists() and DRIVER.exists()):
        pytest.skip(f"{BROWSER} or {DRIVER} is missing: apt-get install chromium chromium-driver to run these tests")
    options = Options()
    options.binary_location = str(BROWSER)
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"):
        options.add_argument(argument)
    # a page is there with its words: pictures may come half a minute later from a busy machine
    options.page_load_strategy = "eager"
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        yield Tablet(driver)
    finally:
        driver.quit()
