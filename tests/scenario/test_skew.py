"""Force on CAN, displacement on Modbus, one later than the other: measured, compensated, shown, replayed
alike."""

from pathlib import Path

import numpy as np
import pytest

from agent.runtime.replay import replay
from agent.types import EstimateBatch, FloatArray, Verdict
from tests.figures import figure
from tests.scenario.live import agent, hops, rows, wait_until
from tests.scenario.two_sources import NOISE_M, configure, noisy, play, readings
from tests.sim.rigs import simulator

SKEW_S = 0.0037


@pytest.mark.parametrize("skew_s", [SKEW_S, 0.0, 0.0605])
def test_skew_of_two_sources_is_measured_within_a_fifth_of_a_millisecond(
    skew_s: float, tmp_path: Path
) -> None:
    path = configure(tmp_path)
    outcome = play(path, readings(path, 2.0, skew_s, seed=5, noise_m=1e-6))
    skew, sd = outcome.skew()
    assert abs(skew - skew_s) < 2e-4
    assert sd < 1e-4
    (event,) = [e for e in outcome.events if e.cause == "skew"]
    assert event.source == "modbus"
    assert ("compensated" if skew_s else "nothing to compensate") in event.message


def test_skew_of_noisy_sensors_is_measured_and_estimates_are_unbiased(tmp_path: Path) -> None:
    path = noisy(tmp_path)
    outcome = play(path, readings(path, 24.0, SKEW_S, seed=0, noise_m=NOISE_M))
    skew, sd = outcome.skew()
    errors = outcome.errors(every=20)
    figure(f"skew of 3.7 ms, 0.1 mm noise: {1e3 * skew:.3f} ± {1e3 * sd:.3f} ms; bias, sd: {_words(errors)}")
    assert abs(skew - SKEW_S) < 2e-4
    assert len(errors) >= 18
    assert np.abs(errors.mean(axis=0)).max() < 1.0
    assert np.sqrt(np.mean(errors**2)) < 1.3


def test_skew_left_alone_is_taken_for_the_delay_of_the_inputs(tmp_path: Path) -> None:
    """The same readings with the skew said to be nothing: a constant of the rig takes it, estimates stay
    unbiased."""
    path = noisy(tmp_path, skew_s="0.0")
    outcome = play(path, readings(path, 24.0, SKEW_S, seed=0, noise_m=NOISE_M))
    errors = outcome.errors(every=20)
    figure(f"skew of 3.7 ms left alone: bias, sd: {_words(errors)}")
    assert np.abs(errors.mean(axis=0)).max() < 1.0
    verdicts = [
        record for record in outcome.records if isinstance(record, Verdict) and record.hypothesis == "delay"
    ]
    assert verdicts[-1].probability > 0.95


def _words(errors: FloatArray) -> str:
    named = zip(("k1", "k2", "B1", "B2"), errors.mean(axis=0), strict=True)
    return ", ".join(f"{name} {bias:+.2f}" for name, bias in named)


def test_skew_that_is_given_is_compensated_and_not_measured(tmp_path: Path) -> None:
    path = noisy(tmp_path, skew_s=str(SKEW_S))
    outcome = play(path, readings(path, 12.0, SKEW_S, seed=1, noise_m=NOISE_M))
    assert outcome.events == []
    assert np.abs(outcome.errors(every=20).mean(axis=0)).max() < 1.0


def test_skew_of_a_rig_that_stands_still_is_unknown_and_said_so(tmp_path: Path) -> None:
    path = configure(tmp_path)
    rng = np.random.default_rng(0)
    values = np.column_stack([np.zeros(1500), 1e-6 * rng.standard_normal((1500, 2))])
    outcome = play(path, values)
    assert outcome.pipeline.ledger.skew("modbus") == (None, None)
    assert ["does not show" in e.message for e in outcome.events if e.cause == "skew"] == [True]


def test_skew_rows_do_not_depend_on_which_source_comes_first(tmp_path: Path) -> None:
    path = configure(tmp_path)
    values = readings(path, 2.0, SKEW_S, seed=2, noise_m=1e-6)
    one, other = (play(path, values, order).records for order in (("can", "modbus"), ("modbus", "can")))
    ours, theirs = ([r for r in records if isinstance(r, EstimateBatch)] for records in (one, other))
    for name in ("index", "t_ns", "value", "sd", "status"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(b, name) for b in ours]),
            np.concatenate([getattr(b, name) for b in theirs]),
        )


@pytest.mark.realtime
def test_skew_over_both_buses_live_is_measured_stored_and_replays_to_the_same_rows(tmp_path: Path) -> None:
    recorded = {f'driver = "{name}"': f'driver = "{name}"\nrecord = true' for name in ("can", "modbus")}
    path = configure(tmp_path, recorded)
    scenario, db = tmp_path / "late.toml", tmp_path / "live.db"
    late = "".join(f'[[sensor]]\nchannel = "{name}"\ndelay_s = {SKEW_S}\n' for name in ("x1", "x2"))
    scenario.write_text(
        f'duration_s = 6.0\n[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-6\n{late}',
        encoding="utf-8",
    )
    with simulator(tmp_path, path.read_text(encoding="utf-8"), "--scenario", str(scenario)) as device:
        with agent(device.config, options=["--db", str(db)]) as running:
            wait_until(lambda: hops(db) >= 115, "115 rows")
            document = running.document()
        assert device.stop() == 0
    skew, sd = rows(
        db, "SELECT skew_s, skew_sd_s FROM v_health WHERE source = 'modbus' ORDER BY t_ns DESC LIMIT 1"
    )[0]
    figure(f"skew of 3.7 ms live, CAN and Modbus: {1e3 * skew:.3f} ± {1e3 * sd:.3f} ms")
    assert abs(skew - SKEW_S) < 2e-4
    (reported,) = rows(db, "SELECT message FROM v_events WHERE cause = 'skew'")
    assert "later than can; compensated" in reported[0]
    assert document["samples"]["received"] == 12_000
    assert document["estimates"]["k2"]["status"] == "valid"
    ours = _rows_of(db)
    assert np.abs(_bias(db)).max() < 1.0
    recordings = [path for path in sorted(db.with_name("live.db.raw").iterdir()) if path.suffix != ".idx"]
    again = replay(config=device.config, recordings=recordings, db=tmp_path / "again.db")
    assert again["samples"]["used"] == document["samples"]["used"]
    _same_rows(_rows_of(tmp_path / "again.db"), ours)


@pytest.mark.soak
def test_skew_of_devices_with_clocks_of_their_own_is_followed_and_the_drift_is_told(tmp_path: Path) -> None:
    """The Modbus device's clock is slow by 200 millionths: in 30 s the two counters part by six samples."""
    path = configure(tmp_path, {"noise_sd = 1e-6": "noise_sd = 1e-5"}, own_clock="true")
    scenario, db = tmp_path / "apart.toml", tmp_path / "live.db"
    late = "".join(f'[[sensor]]\nchannel = "{name}"\ndelay_s = {SKEW_S}\n' for name in ("x1", "x2"))
    device = '[[device]]\nsource = "modbus"\ndrift_ppm = 200.0\n'
    force = '[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-5\n'
    scenario.write_text(f"duration_s = 30.0\n{force}{device}{late}", encoding="utf-8")
    with simulator(tmp_path, path.read_text(encoding="utf-8"), "--scenario", str(scenario)) as played:
        with agent(played.config, options=["--db", str(db)]) as running:
            wait_until(lambda: hops(db) >= 500, "500 rows", limit_s=90.0)
            document = running.document()
        assert played.stop() == 0
    columns = "drift_ppm, drift_sd_ppm, skew_s, skew_sd_s"
    found = {name: row for name, *row in rows(db, f"SELECT source, {columns} FROM v_health ORDER BY t_ns")}
    drift, sd, skew, _ = found["modbus"]
    figure(
        f"clock slow by 200 ppm, live: {drift:+.1f} ± {sd:.1f} ppm; "
        f"skew {1e3 * skew:.2f} ms beside the transport's"
    )
    assert abs(drift + 200.0) < 3 * sd + 10.0
    assert abs(found["can"][0]) < 3 * found["can"][1] + 10.0
    assert abs(skew - SKEW_S) < 2e-3  # with what the two transports differ by
    assert document["samples"]["gaps"] == 0
    assert document["estimates"]["k2"]["n_valid"] > 300


def _rows_of(db: Path) -> list[tuple[object, ...]]:
    columns = "t_ns, parameter, status, reason, value, sd, n_used"
    return rows(db, f"SELECT {columns} FROM v_estimates ORDER BY t_ns, parameter")


def _same_rows(found: list[tuple[object, ...]], ours: list[tuple[object, ...]]) -> None:
    """Hold rows of `_rows_of` against each other as the contract does: other batches may round otherwise."""
    here, there = [np.array([row[4:6] for row in some], dtype=float) for some in (found, ours)]
    assert [row[:4] + row[6:] for row in found] == [row[:4] + row[6:] for row in ours]
    np.testing.assert_array_equal(np.isnan(here), np.isnan(there))
    assert np.nanmax(np.abs(here - there) / there[:, 1:]) < 1e-9


def _bias(db: Path) -> FloatArray:
    truth = {"k1": 25.0, "k2": 100.0, "B1": 5.0, "B2": 5.0}
    valid = "SELECT value, sd FROM v_estimates WHERE parameter = ? AND status = 'valid' ORDER BY t_ns"
    means = []
    for name, true in truth.items():
        value, sd = np.array(rows(db, valid, name)).T
        means.append(float(np.mean((value - true) / sd)))
    return np.array(means)
