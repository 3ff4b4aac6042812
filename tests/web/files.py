"""A database with two rigs that the page and the terminal are held against, and its configuration."""

import time
from pathlib import Path

import numpy as np

from agent.records import ForecastRecord, ForecastScore
from agent.storage.write.store import Store
from agent.types import Reason, Status
from tests.storage.rows import HOP, batch, ledger, run_info, step, verdict

DAY = 86_400 * 10**9
EVIL = '<img src=x onerror=alert(1)>"\x1b[31m'
"""What a message must never be more than: text."""
CONFIG = """
[rig]
name = "press-7"
sample_rate_hz = 1000.0
[model]
kind = "mass-spring-damper"
mass = [{ name = "m1", value = 5.0 }, { name = "m2", value = 3.0 }]
spring = [
    { name = "k1", between = ["ground", "m1"], nominal = 25.0 },
    { name = "k2", between = ["m1", "m2"], nominal = 26.0 },
]
damper = [
    { name = "B1", between = ["ground", "m1"], nominal = 27.0 },
    { name = "B2", between = ["m1", "m2"], nominal = 28.0 },
]
[[channel]]
name = "force"
quantity = "force"
at = "m2"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
[[channel]]
name = "x2"
quantity = "displacement"
at = "m2"
unit = "m"
[[alarm]]
parameter = "k1"
limit = 15.0
[[alarm]]
parameter = "k2"
limit_percent = 10.0
[store]
path = "rig.db"
"""


def make(folder: Path, hops: int = 100) -> Path:
    """Write rig.db and rig.toml: press-8 is normal, press-7 has an alarm, a text with orders and markup, a
    doubt."""
    path = folder / "rig.db"
    (folder / "rig.toml").write_text(CONFIG)
    newest = time.time_ns()
    start = newest - hops * HOP
    with Store.open(path) as store:
        one = store.begin_run(run_info(started_ns=start))
        status = np.full((hops, 4), Status.VALID, np.uint8)
        reason = np.zeros((hops, 4), np.uint8)
        status[-1, 3], reason[-1, 3] = Status.UNEXCITED, Reason.STANDSTILL
        alarm = step("NORM", "UNACK", newest - 10**9, message=f"k1 fell by 16 N/m {EVIL}")
        rows = batch(hops, start=start, status=status, reason=reason)
        store.write(
            one, [rows, alarm, ledger(newest - 10**10), ledger(newest, received=3000), verdict(newest)]
        )
        store.write(one, forecasts(newest))
        store.write(one, scores(newest))
        two = store.begin_run(run_info("press-8", started_ns=start))
        store.write(two, [batch(hops, start=start, rig="press-8", parameters=("k1", "c9"))])
    return path


def forecasts(newest: int) -> list[ForecastRecord]:
    """Return three forecasts of k1: of two the time has come."""
    return [
        ForecastRecord(
            "press-7", "k1", t_ns, 24.0, 10.0, "ok", t_ns + 3 * DAY, t_ns + 5 * DAY, t_ns + 8 * DAY, 0.75,
            6 * 86_400.0, '{"constant": 1.0}', "[259200.0, 432000.0, 691200.0]", "due",
        )
        for t_ns in (newest - 40 * DAY, newest - 20 * DAY, newest)
    ]  # fmt: skip


def scores(newest: int) -> list[ForecastScore]:
    """Return that the first forecast held and the second did not."""
    return [
        ForecastScore("press-7", "k1", number, t_ns, t_ns + 9 * DAY, t_ns + 4 * DAY, 12_345.5, held)
        for number, t_ns, held in ((1, newest - 40 * DAY, True), (2, newest - 20 * DAY, False))
    ]


def restless(folder: Path) -> Path:
    """Write restless.db: k1 left its limit, came back, and left it again; nobody looked at either."""
    path = folder / "restless.db"
    newest = time.time_ns()
    with Store.open(path) as store:
        run = store.begin_run(run_info(started_ns=newest - 20 * HOP))
        steps = (("NORM", "UNACK", 9), ("UNACK", "RTNUN", 5), ("NORM", "UNACK", 1))
        rows = [step(old, new, newest - hops * HOP, message="k1 fell") for old, new, hops in steps]
        store.write(run, [batch(20, start=newest - 20 * HOP), *rows])
    return path


def plant(path: Path, parameter: str = "k2") -> None:
    """Raise one more alarm, as the agent does while others read."""
    with Store.open(path) as store:
        run = store.begin_run(run_info(started_ns=time.time_ns()))
        store.write(
            run, [step("NORM", "UNACK", time.time_ns(), parameter=parameter, message=f"{parameter} planted")]
        )
