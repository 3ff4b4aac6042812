"""Baselines learnt from a store: progress in words, one part alone, and refusal of what is of another
machine."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.storage.write.store import Store
from agent.types import EstimateBatch, Status
from tests.storage.rows import batch, run_info, select

MINUTE = 60_000_000_000
GRAPH = "spring k1 ground-m1; spring k2 m1-m2"
TRUTH = np.array([25.0, 100.0])


def rows(minutes: int, seed: int = 0, first: int = 0, **changes: Any) -> EstimateBatch:
    """A row a minute of two springs whose values wander by 0.1 and 0.4 within hours; sd of a row 0.05 and
    0.2."""
    rng = np.random.default_rng(seed)
    steps = rng.standard_normal((minutes, 2)) * np.sqrt(1.0 - 0.99**2)
    slow = np.zeros((minutes, 2))
    for k in range(minutes):
        slow[k] = (0.99 * slow[k - 1] if k else 0.0) + steps[k]
    value = TRUTH + [0.1, 0.4] * slow + [0.05, 0.2] * rng.standard_normal((minutes, 2))
    sd = np.broadcast_to([0.05, 0.2], value.shape)
    names = ("k1", "k2")
    made = batch(minutes, first=first, hop_ns=MINUTE, parameters=names, value=value, sd=sd, reference=TRUTH)
    return replace(made, sd_repeat=sd, lower=value - 2 * sd, upper=value + 2 * sd, **changes)


def stored(path: Path, *batches: EstimateBatch, graph: str | None = GRAPH) -> Path:
    with Store.open(path) as store:
        run = store.begin_run(replace(run_info(), graph=graph))
        store.write(run, list(batches))
    return path


@pytest.fixture
def db(tmp_path: Path) -> Path:
    return stored(tmp_path / "rig.db", rows(3 * 1440))


def deltak(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = guarded(app, [str(word) for word in argv])
    return (code, *capsys.readouterr())


def learnt(capsys: pytest.CaptureFixture[str], *argv: object) -> dict[str, Any]:
    code, out, err = deltak(capsys, "baseline", "learn", *argv, "--json")
    assert code == 0, err
    document: dict[str, Any] = json.loads(out)
    return document


def test_learn_finds_the_reference_and_the_spread_between_hours(
    db: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = learnt(capsys, db)["parameters"]
    assert abs(found["k1"]["reference"] - 25.0) < 3 * found["k1"]["sd"]
    assert found["k1"]["spread_sd"] == pytest.approx(0.09, rel=0.5)
    assert found["k2"]["spread_sd"] == pytest.approx(0.36, rel=0.5)
    assert found["k1"]["n_effective"] < 72
    shown = select(
        db, "SELECT parameter, baseline_id, graph FROM v_baselines WHERE newest ORDER BY parameter"
    )
    assert shown == [("k1", 1, GRAPH), ("k2", 2, GRAPH)]
    code, out, _ = deltak(capsys, "baseline", "show", db)
    assert code == 0
    assert "k1" in out
    assert "k2" in out


def test_relearning_a_part_after_a_repair_touches_that_part_alone(
    db: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = learnt(capsys, db)["parameters"]
    mended = replace(rows(1500, seed=1, first=3 * 1440), reference=TRUTH)
    stored(db, replace(mended, value=mended.value + 5.0))
    after = learnt(capsys, db, "--parameter", "k1", "--since", "25h")["parameters"]
    assert list(after) == ["k1"]
    assert after["k1"]["reference"] == pytest.approx(30.0, abs=0.3)
    code, out, _ = deltak(capsys, "baseline", "show", db, "--json")
    assert code == 0
    standing = {row["parameter"]: row for row in json.loads(out)["baselines"]}
    assert standing["k1"]["reference"] == after["k1"]["reference"]
    assert standing["k2"]["reference"] == before["k2"]["reference"]
    assert len(json.loads(deltak(capsys, "baseline", "list", db, "--json")[1])["baselines"]) == 3


def test_learn_warns_of_a_stretch_that_is_nothing_but_a_drift(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine = rows(2 * 1440)
    drift = np.column_stack([np.linspace(0.0, 5.0, len(fine)), np.zeros(len(fine))])
    db = stored(tmp_path / "rig.db", replace(fine, value=fine.value + drift))
    (words,) = learnt(capsys, db)["warnings"]
    assert words.startswith("k1 moved so slowly")
    assert "it drifts" in words


def test_learn_says_how_much_is_still_wanted_and_stores_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    db = stored(tmp_path / "rig.db", rows(180))
    code, _, err = deltak(capsys, "baseline", "learn", db)
    assert code == 2
    assert "k1: not yet: 3 of 24 hours with valid rows (12 %)" in err
    assert select(db, "SELECT * FROM v_baselines") == []
    assert deltak(capsys, "baseline", "learn", db, "--hours", 2)[0] == 0


def test_rows_that_are_not_valid_teach_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fine = rows(2000)
    status = fine.status.copy()
    status[:, 0] = Status.INVALID
    db = stored(tmp_path / "rig.db", replace(fine, status=status))
    assert list(learnt(capsys, db)["parameters"]) == ["k2"]
    code, _, err = deltak(capsys, "baseline", "learn", db, "--parameter", "k1")
    assert code == 2
    assert "0 of 24 hours" in err


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("--parameter", "k9"), 'no parameter "k9"; parameters are k1, k2'),
        (("--rig", "press-8"), 'no rig "press-8"'),
        (("--hours", "0"), "0 is no time"),
        (("--since", "yesterday"), '"yesterday" is no time'),
    ],
)
def test_learn_refuses_what_makes_no_sense(
    db: Path, capsys: pytest.CaptureFixture[str], argv: tuple[str, ...], words: str
) -> None:
    code, _, err = deltak(capsys, "baseline", "learn", db, *argv)
    assert code == 2
    assert words in err
    assert select(db, "SELECT * FROM v_baselines") == []


def test_rows_of_two_graphs_are_not_learnt_together(db: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stored(db, rows(1500, first=3 * 1440), graph="spring k1 ground-m1; spring k2 ground-m2")
    code, _, err = deltak(capsys, "baseline", "learn", db)
    assert code == 2
    assert "are of 2 graphs" in err
    assert learnt(capsys, db, "--since", "24h")["graph"].endswith("ground-m2")


def test_export_is_imported_by_a_rig_of_the_same_graph_only(
    db: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learnt(capsys, db)
    file = tmp_path / "healthy.json"
    assert deltak(capsys, "baseline", "export", db, "--to", file)[0] == 0
    twin = stored(tmp_path / "twin.db", rows(5, seed=9))
    assert deltak(capsys, "baseline", "import", twin, file)[0] == 0
    columns = "SELECT parameter, reference, sd, spread_sd, correlation_s, n FROM v_baselines ORDER BY 1"
    assert select(twin, columns) == select(db, columns)
    one = rows(5)
    others = {
        "another graph (spring k1 ground-m1; spring k2 m1-m2)": stored(
            tmp_path / "a.db", one, graph="spring k1 m1-m2"
        ),
        "k1 is in N/m there, in N/mm here": stored(tmp_path / "b.db", replace(one, units=("N/mm", "N/mm"))),
        "has no parameter k1": stored(tmp_path / "c.db", replace(one, parameters=("k7", "k8"))),
    }
    for words, other in others.items():
        code, _, err = deltak(capsys, "baseline", "import", other, file)
        assert code == 2
        assert words in err
        assert select(other, "SELECT * FROM v_baselines") == []


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"form": "deltak baselines", "baselines": [{"rig": "a"}]}']
)
def test_what_is_no_export_is_refused(
    db: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    file = tmp_path / "strange.json"
    file.write_text(text, encoding="utf-8")
    code, _, err = deltak(capsys, "baseline", "import", db, file)
    assert code == 2
    assert str(file) in err
    assert select(db, "SELECT * FROM v_baselines") == []


def test_show_and_export_say_that_there_is_none(db: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("show", "export"):
        code, _, err = deltak(capsys, "baseline", command, db)
        assert code == 2
        assert "no baseline; learn one: deltak baseline learn" in err
    assert deltak(capsys, "baseline", "show", db.with_name("none.db"))[0] == 3
