"""Pictures of the page for the documents, of a rig whose spring wears: `python -m tests.web.pictures`."""

import io
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver

from agent.records import ForecastRecord
from agent.storage.write.store import Store
from agent.types import Reason, Status
from tests import peers
from tests.storage.rows import batch, ledger, run_info, step, verdict
from tests.web import files
from tests.web.server import serving

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS
HOURS = 60 * 24
PICTURES = {"page.png": (1280, "light"), "page-phone.png": (360, "dark")}


def wear(folder: Path) -> None:
    """Write two months in which k1 falls towards its limit."""
    (folder / "rig.toml").write_text(files.CONFIG.replace("limit = 15.0", "limit = 14.0"), encoding="utf-8")
    newest = time.time_ns()
    start = newest - HOURS * HOUR_NS
    rng = np.random.default_rng(1)
    value = 25.0 + np.arange(4) + 0.2 * rng.standard_normal((HOURS, 4))
    value[:, 0] -= np.linspace(0.0, 10.0, HOURS)
    value[-48:, 1] += 2.8
    sd = np.full((HOURS, 4), 0.2)
    alarm = step(
        "NORM", "UNACK", newest, parameter="k2", message="k2 is 2.7 N/m above nominal 26 (limit 2.6)",
        delta=2.7,
        limit_value=2.6,
    )  # fmt: skip
    status, reason = np.full((HOURS, 4), Status.VALID, np.uint8), np.zeros((HOURS, 4), np.uint8)
    status[-1, 3], reason[-1, 3] = Status.UNEXCITED, Reason.STANDSTILL
    rows = batch(
        HOURS, start=start, hop_ns=HOUR_NS, value=value, sd=sd, lower=value - 2 * sd, upper=value + 2 * sd,
        status=status, reason=reason,
    )  # fmt: skip
    with Store.open(folder / "rig.db") as store:
        run = store.begin_run(run_info(started_ns=start))
        store.write(
            run, [rows, alarm, ledger(newest - 10**10), ledger(newest, received=11_000), verdict(newest)]
        )
        store.write(run, forecasts(start))


def forecasts(start: int) -> list[ForecastRecord]:
    """Return what the agent forecast of k1 every 5 days: 14 N/m under its reference is reached on day 84."""
    rng = np.random.default_rng(2)
    made = []
    for day in range(20, 61, 5):
        t_ns, left = start + day * DAY_NS, (84 - day) * rng.uniform(0.9, 1.15)
        ends = (t_ns + round(share * left * DAY_NS) for share in (0.8, 1.0, 1.3))
        now = 25.0 - day / 6.0
        made.append(
            ForecastRecord(
                "press-7", "k1", t_ns, now, 11.0, "ok", *ends, 0.9, 60 * 86_400.0, "{}", "[]", "due"
            )
        )
    return made


def take(folder: Path, target: Path) -> None:
    """Draw the page as wide as each picture, as high as it is."""
    options = webdriver.ChromeOptions()
    options.binary_location = peers.program("chromium", "chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(argument)
    service = webdriver.ChromeService(peers.program("chromedriver", "chromium-driver"))
    with serving("--config", folder / "rig.toml") as client, webdriver.Chrome(options, service) as driver:
        driver.get(f"http://localhost:{client.port}/")
        time.sleep(2)
        driver.execute_script("""document.querySelector('#parameter-list [data-key="k1"] button').click();
            [...document.querySelectorAll("#chart-bar button")]
                .find((b) => b.textContent === "all").click()""")
        time.sleep(2)
        for name, (width, scheme) in PICTURES.items():
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
            size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 400}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            time.sleep(1)
            size["height"] = driver.execute_script("return document.documentElement.scrollHeight")
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            time.sleep(1)
            picture = Image.open(io.BytesIO(driver.get_screenshot_as_png()))
            picture.convert("RGB").quantize(160).save(target / name, optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        wear(Path(made))
        take(Path(made), peers.ROOT / "docs")
