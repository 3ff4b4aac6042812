"""The chart of a rig-year in a real browser: every stretch, from a minute to all of it, is drawn within a
second."""

from pathlib import Path

import pytest
from selenium import webdriver

from tests.bench.test_store import year
from tests.figures import figure
from tests.web.server import serving
from tests.web.test_page import texts, until

pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(600)]
SPANS = ("1 min", "1 h", "1 d", "1 week", "30 d", "1 year", "all")
SHOW = """
const [words, done] = arguments;
const button = [...document.querySelectorAll("#chart-bar button")].find((one) => one.textContent === words);
const begun = performance.now();
const drawn = () => requestAnimationFrame(() => done(performance.now() - begun));
new MutationObserver((_, watch) => { watch.disconnect(); drawn(); }).observe(
  document.querySelector("#chart-words"), { childList: true },
);
button.click();
"""


def test_every_stretch_of_a_rig_year_is_drawn_within_a_second(
    tmp_path: Path, driver: webdriver.Chrome
) -> None:
    year(tmp_path / "rig.db")
    with serving("--db", tmp_path / "rig.db") as client:
        driver.get(f"http://localhost:{client.port}/")
        until(lambda: "rows; newest" in texts(driver, "#chart-words")[0])
        took = {words: float(driver.execute_async_script(SHOW, words)) for words in SPANS}
    size = (tmp_path / "rig.db").stat().st_size / 1e6
    shown = ", ".join(f"{words} {ms:.0f}" for words, ms in took.items())
    figure(f"zoom in a rig-year ({size:.0f} MB), ms until it is drawn: {shown}")
    assert max(took.values()) < 1000.0
