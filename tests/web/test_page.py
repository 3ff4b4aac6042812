"""The page in a real browser: its numbers are those of SQL, alarms come at once, and it needs no mouse."""

import json
import re
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from agent.storage.read import queries
from agent.storage.write.command_socket import CommandServer
from agent.storage.write.store import Store
from tests.storage.rows import HOP, PARAMETERS, batch, run_info
from tests.web import files
from tests.web.server import PASSWORD, Client, password_file, serving

pytestmark = pytest.mark.realtime
PATIENCE_S = 15.0
PAINTED = """
const canvas = document.querySelector("#chart canvas"), style = getComputedStyle(document.documentElement);
const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
return arguments[0].filter((name) => {
  const text = style.getPropertyValue(`--${name}`).trim();
  const wanted = [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16));
  const isThere = (i) => data[i + 3] > 200 && wanted.every((part, j) => Math.abs(part - data[i + j]) < 8);
  for (let i = 0; i < data.length; i += 4) if (isThere(i)) return true;
});
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    files.make(folder)
    return folder


@pytest.fixture(scope="module")
def agent(folder: Path) -> Iterator[list[Mapping[str, Any]]]:
    asked: list[Mapping[str, Any]] = []

    def act(line: Mapping[str, Any]) -> Mapping[str, Any]:
        asked.append(line)
        return {"alarms": []}

    made = CommandServer(folder / "rig.db", {"alarm": act})
    made.start()
    yield asked
    made.stop()


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[Client]:
    with serving("--config", folder / "rig.toml", "--password-file", password_file(folder)) as client:
        yield client


@pytest.fixture(scope="module")
def browser(server: Client, driver: webdriver.Chrome) -> webdriver.Chrome:
    driver.get(f"http://localhost:{server.port}/")
    return driver


def until(found: Callable[[], Any]) -> Any:
    """Wait until something is there and return it."""
    end = time.monotonic() + PATIENCE_S
    while not (there := found()):
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)
    return there


def texts(browser: webdriver.Chrome, css: str) -> list[str]:
    script = "return [...document.querySelectorAll(arguments[0])].map((e) => e.textContent)"
    return list(browser.execute_script(script, css))


def test_numbers_on_the_page_are_those_of_sql(browser: webdriver.Chrome, folder: Path) -> None:
    until(lambda: texts(browser, "#parameter-list data"))
    script = """return [...document.querySelectorAll("#parameter-list li")].map((li) => [li.dataset.key,
        Number(li.querySelector("data").value), Number(li.querySelector("data").dataset.sd),
            li.textContent])"""
    shown = browser.execute_script(script)
    connection = sqlite3.connect(folder / "rig.db")
    said = connection.execute(
        "SELECT parameter, value, sd, status FROM v_latest WHERE rig = 'press-7'"
    ).fetchall()
    connection.close()
    assert [row[:3] for row in shown] == [[name, value, sd] for name, value, sd, _ in said]
    for (_, value, _, text), (*_, status) in zip(shown, said, strict=True):
        assert f"{value:.2f}"[:-1] in text
        assert status in text


def test_text_of_the_database_is_text(browser: webdriver.Chrome) -> None:
    (alarm, *_) = until(lambda: texts(browser, "#alarm-list li"))
    assert "<img src=x onerror=alert(1)>" in alarm
    assert browser.find_elements(By.CSS_SELECTOR, "#alarm-list img") == []


def test_rigs_stand_worst_first_and_the_model_is_drawn(browser: webdriver.Chrome, folder: Path) -> None:
    assert [text.split()[0] for text in until(lambda: texts(browser, "#rig-list li"))] == [
        "press-7",
        "press-8",
    ]
    picture = until(lambda: browser.find_elements(By.CSS_SELECTOR, "#model svg"))[0]
    assert "k1 alarm, k2 normal, B1 normal, B2 cannot tell" in str(picture.get_attribute("aria-label"))
    assert texts(browser, "#model text") == ["k1", "k2", "B1", "B2", "m1", "m2"]
    (words,) = until(lambda: texts(browser, "#chart-words"))
    connection = sqlite3.connect(folder / "rig.db")
    ((newest,),) = connection.execute("SELECT value FROM v_latest WHERE rig = 'press-7' AND parameter = 'k1'")
    connection.close()
    assert words.startswith(f"100 rows; newest {newest:.6g} N/m")


def test_page_says_what_could_be_known_now_and_what_was_forecast(browser: webdriver.Chrome) -> None:
    assert until(lambda: texts(browser, "#known")) == ["resolved now: k1, k2, B1; not B2: nothing moves"]
    k1, *_, b2 = texts(browser, "#parameter-list .known")
    assert re.fullmatch(r"known to ± [0-9.]+ N/m, [0-9.]+ % of its limit", k1)
    assert b2.startswith("not known: nothing moves")
    (forecast,) = until(lambda: texts(browser, "#forecast-list li"))
    said = "k1: reached in 5 days (80 %: 3 days … 8 days); chance within 6 days 75 %, limit 10; made"
    assert forecast.startswith(said)
    assert "of 2 made here, 1 held within the 80 % band" in forecast


def test_chart_shows_reference_limits_and_the_fan_with_forecasts_of_the_past(
    browser: webdriver.Chrome,
) -> None:
    def legend() -> list[str]:
        return texts(browser, ".u-legend .u-label")

    assert [name for name in ("nominal", "limit", "P50") if name in legend()] == ["nominal", "limit"]
    browser.execute_script('document.querySelector("#chart").focus()')
    webdriver.ActionChains(browser).send_keys(Keys.HOME).perform()
    until(lambda: legend()[-5:] == ["limit", "limit", "P10", "P50", "P90"])
    assert browser.execute_script(PAINTED, ["fan", "good", "bad"]) == ["fan", "bad"]  # no baseline is learnt


def test_planted_alarm_appears_within_two_seconds(browser: webdriver.Chrome, folder: Path) -> None:
    until(lambda: texts(browser, "#connection") == ["live"])
    before = len(texts(browser, "#alarm-list li"))
    files.plant(folder / "rig.db")
    committed = time.monotonic()
    until(lambda: len(texts(browser, "#alarm-list li")) > before)
    assert time.monotonic() - committed < 2.0


def test_alarm_is_acknowledged_and_shelved_by_keyboard_alone(
    browser: webdriver.Chrome, agent: list[Mapping[str, Any]], folder: Path
) -> None:
    def press(*keys: str) -> None:
        webdriver.ActionChains(browser).send_keys(*keys).perform()

    def focused() -> str:
        return str(
            browser.execute_script("return document.activeElement.dataset.key ?? document.activeElement.id")
        )

    files.plant(folder / "rig.db", "k2")  # so that there is one to move to, whichever tests ran before
    until(lambda: len(texts(browser, "#alarm-list li")) > 1)
    browser.execute_script("document.activeElement.blur()")
    for _ in range(10):
        if focused().startswith("rig/"):
            break
        press(Keys.TAB)
    first = focused()
    press(Keys.ARROW_DOWN)
    assert focused() != first
    press(Keys.ARROW_UP, "a")
    until(lambda: focused() == "sign-name")
    before = len(texts(browser, "#alarm-list li"))
    files.plant(folder / "rig.db", "B1")  # the list is drawn anew while somebody types
    until(lambda: len(texts(browser, "#alarm-list li")) > before)
    press("anna", Keys.TAB, PASSWORD, Keys.ENTER)
    until(lambda: agent)
    line = agent[-1]
    assert (line["cause"], line["by"], f"rig/{line['ids'][0]}") == ("acknowledge", "anna", first)
    until(lambda: focused() == first)  # where one was is where one stays
    before = len(texts(browser, "#alarm-list li"))
    files.plant(folder / "rig.db", "B2")
    until(lambda: len(texts(browser, "#alarm-list li")) > before)
    assert focused() == first
    press("s")
    until(lambda: agent[-1]["cause"] == "shelve")
    assert (agent[-1]["by"], agent[-1]["ids"], agent[-1]["length_ns"]) == (
        "anna",
        line["ids"],
        8 * 3600 * 10**9,
    )


def test_narrow_page_in_both_schemes_has_no_horizontal_scroll_and_axe_finds_nothing(
    browser: webdriver.Chrome,
) -> None:
    axe = (resources.files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    browser.execute_cdp_cmd("Runtime.evaluate", {"expression": axe})
    for scheme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        narrow = {"width": 360, "height": 740, "deviceScaleFactor": 1, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", narrow)
        width, seen = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert (width, seen) == (360, 360)
        found = browser.execute_async_script("axe.run().then(arguments[0])")
        assert len(found["passes"]) > 20
        assert [(rule["id"], rule["nodes"][0]["html"]) for rule in found["violations"]] == []


def test_browser_asked_no_other_origin_and_found_no_fault(browser: webdriver.Chrome, server: Client) -> None:
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    assert len(sent) > 10
    assert {url for url in sent if not url.startswith(f"http://localhost:{server.port}/")} == set()
    assert browser.get_log("browser") == []


@pytest.mark.soak
def test_two_hundred_rows_are_shown_with_the_numbers_of_sql_as_they_are_committed(
    browser: webdriver.Chrome, folder: Path
) -> None:
    until(lambda: texts(browser, "#connection") == ["live"])
    rng = np.random.default_rng(3)
    with Store.open(folder / "rig.db") as store:
        run = store.begin_run(run_info(started_ns=time.time_ns()))
        for number in range(50):
            value = rng.normal(25.0, 10.0 ** rng.integers(-3, 4), (1, 4))
            sd = np.abs(rng.normal(0.0, 10.0 ** rng.integers(-6, 1), (1, 4)))
            now = time.time_ns() - number * HOP  # the row's own number adds as much
            rows = batch(
                1, first=number, start=now, value=value, sd=sd, lower=value - 2 * sd, upper=value + 2 * sd
            )
            store.write(run, [rows])
            wanted = [[name, *pair] for name, *pair in zip(PARAMETERS, value[0], sd[0], strict=True)]
            until(lambda wanted=wanted: shown(browser) == wanted)
            stored = queries.latest(folder / "rig.db", "press-7")
            assert [[row["parameter"], row["value"], row["sd"]] for row in stored] == wanted


def shown(browser: webdriver.Chrome) -> list[list[Any]]:
    """Return name, value and standard deviation of each parameter, as the page has them."""
    script = """return [...document.querySelectorAll("#parameter-list li")].map((li) =>
        [li.dataset.key, Number(li.querySelector("data").value),
         Number(li.querySelector("data").dataset.sd)])"""
    return list(browser.execute_script(script))
