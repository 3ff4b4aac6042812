"""Covariates beside the samples of a rig: rows, alarms and events count from the reference that they move."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.blocks.covariates.compensation import Compensation
from agent.blocks.covariates.means import CovariateMeans
from agent.blocks.level_alarms import LevelAlarms
from agent.config import Alarm, load
from agent.config.sections.covariates import Covariate
from agent.records import Baseline, CovariateMean, Health, Record
from agent.reference.covariates.dependence import Dependence, written
from agent.runtime.pipeline import Pipeline
from agent.runtime.replay import replay
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.sources import Arrival, Use
from agent.storage.maintenance import store_baselines
from agent.storage.write.store import Store
from agent.types import EstimateBatch
from drivers.port import Counts, SampleBlock
from tests.scenario.live import rows
from tests.scenario.test_bad_input import configuration
from tests.statistical.sensor_faults import healthy
from tests.storage.rows import START, batch, run_info, select

HALL = Covariate(name="hall", unit="degC")
DEPENDENCE = Dependence(
    "hall",
    "degC",
    -0.1,
    0.001,
    -0.102,
    -0.098,
    "none",
    0.0,
    0.0,
    0.0,
    20.0,
    10.0,
    30.0,
    5.0,
    600.0,
    used=True,
)
TABLES = '[[channel]]\nname = "hall"\nrole = "covariate"\nunit = "degC"\n[estimator]\n'
MINUTE = 60 * 10**9
SOURCE = """
[[source]]
name = "{}"
driver = "serial"
port = "{}"
baudrate = 9600
format = "text"
columns = {}
map = {}
"""


def baseline(**changes: Any) -> Baseline:
    figures = (25.0, 0.01, 0.04, 0.01, None, 3600.0, 100.0, written([DEPENDENCE]), 0, 1, 100)
    return replace(Baseline("rig", "k1", "N/m", "", *figures, baseline_id=3), **changes)


def counted(minutes: int, each: int = 20) -> EstimateBatch:
    """Rows each 3 s that count from the baseline of k1."""
    n = minutes * each
    made = batch(n, parameters=("k1",), hop_ns=MINUTE // each, start=START // MINUTE * MINUTE)
    value, sd = np.full((n, 1), 25.0), np.full((n, 1), 0.05)
    ends = {"lower": value - 0.1, "upper": value + 0.1, "sd_repeat": sd}
    return replace(
        made, value=value, sd=sd, reference=np.array([25.0]), baseline_id=(3,), reference_sd=(0.01,), **ends
    )


def hall(temperatures: dict[int, float]) -> CovariateMeans:
    """A hall whose mean of each minute, counted from the first row, is given."""
    means = CovariateMeans("rig", [HALL])
    for minute, value in temperatures.items():
        means.take(np.array([START // MINUTE * MINUTE + minute * MINUTE]), {"hall": np.array([value])})
    return means


def test_rows_are_cut_where_the_reference_moves_and_pieces_change_nothing() -> None:
    means = hall({minute: 20.0 + minute for minute in range(-5, 10)})
    whole = Compensation("rig", means.known)
    whole.count_from([baseline()])
    parts, events = whole.step(counted(8))
    assert events == []
    assert [len(part) for part in parts] == [20] * 8
    assert [part.reference[0] for part in parts] == pytest.approx([25.0 - 0.1 * (m - 2) for m in range(8)])
    assert all(part.baseline_id == (3,) for part in parts)
    pieces = Compensation("rig", means.known)
    pieces.count_from([baseline()])
    rows_of = counted(8)
    again = [p for k in range(0, 160, 7) for p in pieces.step(rows_of.part(slice(k, k + 7)))[0]]
    each = {int(t): part.reference[0] for part in again for t in part.t_ns}
    assert each == {int(t): part.reference[0] for part in parts for t in part.t_ns}


def test_missing_covariate_widens_the_reference_and_event_and_alarm_say_so() -> None:
    means = hall(dict.fromkeys(range(-5, 2), 20.0))
    compensation = Compensation("rig", means.known)
    compensation.count_from([baseline()])
    parts, events = compensation.step(counted(20))
    (event,) = events
    assert (event.source, event.cause) == ("baseline", "covariate")
    assert "hall is missing" in event.message
    assert event.t_ns >= parts[0].t_ns[0] + 11 * MINUTE
    assert parts[0].reference_sd is not None
    assert parts[-1].reference_sd is not None
    assert parts[0].reference_sd[0] < 0.02
    assert parts[-1].reference_sd[0] > 0.4
    alarms = LevelAlarms("rig", [Alarm(parameter="k1", limit=0.5, on_delay_s=1.0)], 1000.0)
    lost = parts[-1].part(slice(None))
    assert alarms.step(replace(lost, value=lost.value - 0.9)) == []  # would be raised if the hall were known
    (raised,) = alarms.step(replace(lost, value=lost.value - 3.0, index=lost.index + 10**6))
    assert "the reference is less well known: hall is missing" in raised.message


def recording(
    folder: Path, temperature: float | None, starts: tuple[float, ...] = (0.0, 70.0, 150.0)
) -> Path:
    """Bursts of motion of 1.2 s, and a thermometer that is read twice in each."""
    force, x1, x2 = healthy(np.random.default_rng(4), 1200 * len(starts), 1e-6).T
    t = np.concatenate([start + 1e-3 * np.arange(1200) for start in starts])
    arrays = {"t": t, "force": force, "x1": x1, "x2": x2}
    if temperature is not None:
        arrays["hall"] = np.full(len(t), np.nan)
        arrays["hall"][::600] = temperature
    np.savez(folder / "fine.npz", **arrays)
    return folder / "fine.npz"


def test_replay_counts_rows_from_the_moved_reference_and_stores_the_covariate(tmp_path: Path) -> None:
    changes = {"[estimator]": TABLES, 'clock = "counter"': 'clock = "device"'}
    config, db = configuration(tmp_path, 0.5, **changes), tmp_path / "rig.db"
    store_baselines(db, [baseline(baseline_id=None)])
    document = replay(config=config, recordings=[recording(tmp_path, 15.0)], db=db)
    assert document["estimates"]["k1"]["n_valid"] > 10
    found = rows(db, "SELECT min(t_ns), reference FROM v_estimates WHERE parameter = 'k1' GROUP BY reference")
    assert {round(reference, 3): t_ns // MINUTE for t_ns, reference in found} == {25.0: 0, 25.5: 2}
    assert rows(db, "SELECT count(*), min(value), max(value), sum(n) FROM v_covariates") == [
        (3, 15.0, 15.0, 6)
    ]
    assert rows(db, "SELECT cause FROM v_events WHERE source = 'baseline'") == [
        ("covariate",),
        ("recovered",),
    ]
    # the next run begins with what this one saw, and a recording without the thermometer's column plays all
    # the same
    again = replay(config=config, recordings=[recording(tmp_path, None, (300.0,))], db=db)
    assert again["samples"]["used"] == 1200


def test_covariate_in_another_unit_is_refused_in_words(tmp_path: Path) -> None:
    config = load(configuration(tmp_path, 0.5, **{"[estimator]": TABLES.replace("degC", "K")}))
    pipeline = Pipeline(config, {}, {"recording": {c.name: c.name for c in config.channel}})
    (words,) = pipeline.count_from((baseline(),))
    assert words == "the baseline of k1 counts hall in degC, which is in K here"
    assert pipeline.stages.estimation.labels.baseline_id is None


def test_source_of_covariates_only_makes_no_row_wait_and_its_readings_balance(tmp_path: Path) -> None:
    text = configuration(tmp_path, 0.5, **{"[estimator]": TABLES}).read_text()
    signals = SOURCE.format(
        "rig", "a", '["n", "f", "a", "b"]', '{ force = "f", x1 = "a", x2 = "b" }\ncounter = "n"'
    )
    path = tmp_path / "live.toml"
    path.write_text(text + signals + SOURCE.format("hall", "b", '["T"]', '{ hall = "T" }'))
    published: list[Record] = []
    rig = RigRuntime(load(path), published.extend)
    assert rig.sources == ("rig", "hall")
    thermometer = Use("rig", "hall", (), {"hall": 0})
    now = 10**15
    for minute in range(5):
        block = SampleBlock(
            np.array([[20.0 + minute]]), now + minute * MINUTE, None, None, wall_offset_ns=START
        )
        rig.take(thermometer, Arrival(block, Counts(received=minute + 1), None))
        rig.compute()
    rig.pipeline.newest_ns = START + now + 5 * MINUTE
    force, x1, x2 = healthy(np.random.default_rng(4), 1000, 1e-6).T
    values = np.column_stack([force, x1, x2])
    block = SampleBlock(values, now + 5 * MINUTE, np.arange(1000), None, wall_offset_ns=START)
    rig.take(Use("rig", "rig", (0, 1, 2)), Arrival(block, Counts(received=1000), None))
    rig.compute()
    means = [record for record in published if isinstance(record, CovariateMean)]
    assert [mean.value for mean in means] == [20.0, 21.0, 22.0, 23.0]
    assert any(isinstance(record, EstimateBatch) for record in published)
    rig.finish()
    assert [record.value for record in published if isinstance(record, CovariateMean)][-1] == 24.0
    assert not any(isinstance(record, Health) for record in published)


def test_minutes_of_covariates_become_hours_when_they_are_old(tmp_path: Path) -> None:
    from agent.storage.read.covariates import means
    from agent.storage.tables.covariates import thin

    with Store.open(tmp_path / "rig.db") as store:
        run = store.begin_run(run_info())
        start = START // (60 * MINUTE) * (60 * MINUTE)
        minutes = [(start + minute * MINUTE, float(minute)) for minute in range(180)]
        store.write(
            run, [CovariateMean("press-7", "hall", "degC", t_ns, value, 2) for t_ns, value in minutes]
        )
        with store.transaction() as connection:
            thin(connection, store.numbers.take, 3600.0, float("inf"))
    kept = select(tmp_path / "rig.db", "SELECT span_s, count(*), sum(n) FROM v_covariates GROUP BY span_s")
    assert kept == [(60, 120, 240), (3600, 1, 120)]
    found = means(tmp_path / "rig.db", "press-7")["hall"]
    assert len(found.number) == 180
    assert found.value[0] == pytest.approx(29.5)


def test_hour_in_which_the_reference_moved_is_one_row(tmp_path: Path) -> None:
    rows_of = counted(120, each=2)
    means = hall({minute: 20.0 + minute / 20 for minute in range(-5, 125)})
    compensation = Compensation("rig", means.known)
    compensation.count_from([baseline()])
    parts, _ = compensation.step(replace(rows_of, rig="press-7"))
    with Store.open(tmp_path / "rig.db") as store:
        store.write(store.begin_run(run_info()), parts)
        store.maintain(finish=True)
    tiers = "SELECT span_s, count(*), count(DISTINCT t_ns) FROM v_tiers GROUP BY span_s"
    assert select(tmp_path / "rig.db", tiers) == [(60, 120, 120), (3600, 2, 2)]
