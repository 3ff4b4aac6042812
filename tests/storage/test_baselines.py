"""What a healthy machine was like is stored a parameter at a time, taken up by runs, and saved from damaged
files."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.errors import StoreError
from agent.records import Baseline
from agent.storage import maintenance
from agent.storage.recovery.salvage import recover
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import START, batch, run_info, select

GRAPH = "spring k1 ground-m1"
SHOWN = (
    "SELECT baseline_id, parameter, reference, sd, spread_sd, days_sd, n, newest FROM v_baselines ORDER BY 1"
)


def baseline(parameter: str = "k1", reference: float = 25.0, **changes: Any) -> Baseline:
    figures = (reference, 0.01, 0.1, 0.3, None, 7200.0, 12.0)
    one = Baseline(
        "press-7", parameter, "N/m", GRAPH, *figures, "[]", START, START + 86_400_000_000_000, 1234
    )
    return replace(one, **changes)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def test_relearning_a_parameter_leaves_the_others_as_they_are(path: Path) -> None:
    assert maintenance.store_baselines(path, [baseline("k1"), baseline("k2", 100.0, days_sd=0.2)]) == [1, 2]
    assert maintenance.store_baselines(path, [baseline("k1", 24.0)]) == [3]
    assert select(path, SHOWN) == [
        (1, "k1", 25.0, 0.01, 0.1, None, 1234, 0),
        (2, "k2", 100.0, 0.01, 0.1, 0.2, 1234, 1),
        (3, "k1", 24.0, 0.01, 0.1, None, 1234, 1),
    ]
    with Store.open(path) as store:
        assert [(one.baseline_id, one.reference) for one in store.baselines("press-7")] == [
            (3, 24.0),
            (2, 100.0),
        ]
        assert store.baselines("other") == ()
    times = "SELECT learnt_from, learnt_until, graph FROM v_baselines WHERE baseline_id = 3"
    assert select(path, times) == [
        ("2026-01-01T00:00:00.000000000Z", "2026-01-02T00:00:00.000000000Z", GRAPH)
    ]


def test_rows_and_runs_say_which_baseline_they_count_from(path: Path) -> None:
    maintenance.store_baselines(path, [baseline("k2", 30.0)])
    rows = batch(2, parameters=("k1", "k2"), reference=np.array([25.0, 30.0]), baseline_id=(None, 1))
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [rows])
    shown = "SELECT parameter, reference, baseline_id FROM v_estimates ORDER BY t_ns, parameter"
    assert select(path, shown) == [("k1", 25.0, None), ("k2", 30.0, 1)] * 2
    assert select(path, "SELECT baseline_id FROM v_runs") == [(1,)]


def test_agent_that_owns_the_file_stores_baselines_and_knows_them_at_once(path: Path) -> None:
    maintenance.store_baselines(path, [baseline("k1")])
    writer = StoreWriter(lambda: Store.open(path), [run_info()], served={})
    writer.start()
    try:
        before = writer.baselines["press-7"]
        assert maintenance.store_baselines(path, [baseline("k1", 24.0), baseline("k2", 99.0)]) == [2, 3]
        assert [one.reference for one in before] == [25.0]
        assert [one.reference for one in writer.baselines["press-7"]] == [24.0, 99.0]
        with pytest.raises(StoreError, match="baseline"):
            maintenance.ask(path, "baseline", baselines=[{"rig": "press-7"}])
        assert len(writer.baselines["press-7"]) == 2
    finally:
        writer.stop()


def test_baselines_outlive_a_damaged_file_and_a_wrong_one_is_passed_over(path: Path) -> None:
    maintenance.store_baselines(path, [baseline("k1"), baseline("k2", 100.0)])
    recover(path, "for this test")
    assert [row[:3] for row in select(path, SHOWN)] == [(1, "k1", 25.0), (2, "k2", 100.0)]
    with Store.open(path) as store:
        store.connection.execute("UPDATE baselines SET reference = 99.0 WHERE parameter = 'k2'")
        assert [one.parameter for one in store.baselines("press-7")] == ["k1"]
    assert maintenance.check(path).problems != []
