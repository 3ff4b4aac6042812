"""Recordings that nobody would wish for: a clear status or advice, never an exception, infinity or NaN."""

import sqlite3
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agent.errors import ConfigError, ModelError, RecordingError
from agent.runtime.replay import replay
from agent.types import FloatArray
from tests.statistical.machine import ALARM, NAMES, NOMINAL, TEXT
from tests.statistical.operation import NOISE_M
from tests.statistical.sensor_faults import healthy

SAMPLES = 4000
Spoil = Callable[[FloatArray], None]


def force_zero(v: FloatArray) -> None:
    v[:, 0] = 0.0


def force_zero_and_at_rest(v: FloatArray) -> None:
    v[:] = NOISE_M * np.random.default_rng(0).standard_normal(v.shape)
    v[:, 0] = 0.0


def one_constant(v: FloatArray) -> None:
    v[:, 1] = 0.012


def both_constant(v: FloatArray) -> None:
    v[:, 1:] = 0.012


def all_constant(v: FloatArray) -> None:
    v[:] = 1.0


def huge(v: FloatArray) -> None:
    v[1500:2100, 1] = 1e30
    v[3000:3300, 0] = -1e30


def square(v: FloatArray) -> None:
    v[:, 1:] = np.where(np.arange(len(v))[:, None] % 2, 1e-2, -1e-2)


def noise(v: FloatArray) -> None:
    v[:] = np.random.default_rng(1).standard_normal(v.shape)


def infinite(v: FloatArray) -> None:
    v[1200, 1] = np.inf
    v[2500:2800, 2] = -np.inf


def mostly_missing(v: FloatArray) -> None:
    v[np.random.default_rng(2).random(v.shape) < 0.4] = np.nan


def swapped(v: FloatArray) -> None:
    v[:, 1:] = v[:, :0:-1].copy()


def tiny(v: FloatArray) -> None:
    v *= 1e-150


EXPECTED: dict[Spoil, set[str]] = {
    force_zero: {"unexcited", "invalid"},
    force_zero_and_at_rest: {"unexcited"},
    one_constant: {"invalid stuck"},
    both_constant: {"unexcited standstill"},
    all_constant: {"unexcited", "invalid"},
    huge: {"invalid"},
    square: {"invalid", "unexcited"},
    noise: {"invalid"},
    infinite: {"invalid no data"},
    mostly_missing: {"invalid gap", "warming"},
    swapped: {"invalid", "unexcited"},
    tiny: {"unexcited"},
}
"""What some rows must say."""


def configuration(folder: Path, window_s: float = 1.0, **changes: str) -> Path:
    alarms = "".join(ALARM.format(name=name, limit="limit_percent = 10.0") for name in NAMES)
    text = TEXT.format(noise=f"noise_sd = {NOISE_M!r}", window_s=window_s, alarms=alarms)
    for old, new in changes.items():
        text = text.replace(old, new)
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def recording(folder: Path, spoil: Spoil | None, noise_m: float = NOISE_M) -> Path:
    v = healthy(np.random.default_rng(11), SAMPLES, noise_m)
    if spoil is not None:
        spoil(v)
    path = folder / "rig.npz"
    np.savez(path, t=1e-3 * np.arange(SAMPLES), force=v[:, 0], x1=v[:, 1], x2=v[:, 2])
    return path


def states(db: Path) -> Counter[str]:
    """How often each status and reason stands in the database; every number in it is one."""
    with sqlite3.connect(db) as base:
        for table in [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'view'")]:
            for row in base.execute(f"SELECT * FROM {table}"):
                assert all(np.isfinite(cell) for cell in row if isinstance(cell, float)), (table, row)
        found = base.execute("SELECT status, reason, value, sd FROM v_estimates").fetchall()
    assert all(
        value is not None and sd is not None and sd >= 0
        for status, _, value, sd in found
        if status == "valid"
    )
    return Counter(f"{status} {reason}" if reason else status for status, reason, _, _ in found)


@pytest.mark.parametrize("spoil", EXPECTED)
def test_replay_of_a_spoilt_recording_says_clearly_what_its_estimates_are_worth(
    spoil: Spoil, tmp_path: Path
) -> None:
    db = tmp_path / "rig.db"
    document = replay(config=configuration(tmp_path), recordings=[recording(tmp_path, spoil)], db=db)
    found = states(db)
    assert any(state.startswith(wanted) for wanted in EXPECTED[spoil] for state in found), found
    ledger = document["samples"]
    assert ledger["received"] == ledger["used"] + sum(ledger["rejected"].values()) + sum(
        ledger["dropped"].values()
    )
    assert not [alarm for alarm in document["alarms"] if alarm["kind"] == "level"], document["alarms"]


@pytest.mark.parametrize("noise_m", [1e-6, NOISE_M])
@pytest.mark.parametrize(
    ("changed", "said"), [(("5.0", "6.0"), ("m1", -16.7)), (("3.0", "2.4"), ("m2", 25.0))]
)
def test_replay_with_a_mass_wrong_by_20_percent_names_it_and_is_right_all_the_same(
    changed: tuple[str, str], said: tuple[str, float], noise_m: float, tmp_path: Path
) -> None:
    (old, new), (mass, percent) = changed, said
    config = configuration(tmp_path, **{f"value = {old}": f"value = {new}", repr(NOISE_M): repr(noise_m)})
    recorded = recording(tmp_path, None, noise_m)
    document = replay(config=config, recordings=[recorded], db=tmp_path / "rig.db")
    found = states(tmp_path / "rig.db")
    assert set(found) == {"valid", "warming"}
    assert not document["alarms"]
    (advice,) = document["advice"]
    assert advice.startswith(f"{mass} is ")
    assert float(advice.split()[2]) == pytest.approx(abs(percent), abs=0.2)
    assert advice.endswith("correct model.mass")
    with sqlite3.connect(tmp_path / "rig.db") as base:
        assert base.execute("SELECT cause FROM v_events WHERE source = 'model'").fetchall() == [("mass",)]
        newest = "SELECT hypothesis, size, sd FROM v_verdicts WHERE probability > 0.95 ORDER BY t_ns DESC"
        hypothesis, size, sd = base.execute(newest).fetchone()
        rows = base.execute("SELECT parameter, value, sd FROM v_estimates WHERE status = 'valid'").fetchall()
    assert hypothesis == mass
    assert abs(size - percent) < 3 * sd + 0.1
    truth = dict(zip(NAMES, NOMINAL.tolist(), strict=True))
    for name, value, sd in rows:
        assert abs(value - truth[name]) < 3 * sd, (name, value, sd)
        assert abs(value - truth[name]) < 0.05 * truth[name], (name, value, sd)


def test_replay_of_a_window_shorter_than_the_unknowns_says_how_long_it_must_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"4 parameters and 4 states need at least 6: 0\.006 s"):
        replay(
            config=configuration(tmp_path, window_s=0.004), recordings=[recording(tmp_path, None)], db=None
        )


def test_replay_of_a_folder_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is a folder, no recording; give the files in it"):
        replay(config=configuration(tmp_path), recordings=[Path()], db=None)


def test_replay_of_two_parameters_that_cannot_be_told_apart_names_them(tmp_path: Path) -> None:
    double = 'spring = [\n    { name = "k0", between = ["ground", "m1"], nominal = 20.0 },'
    config = configuration(tmp_path, **{"spring = [": double})
    with pytest.raises(ModelError) as caught:
        replay(config=config, recordings=[recording(tmp_path, None)], db=None)
    assert "k0" in str(caught.value)
    assert "k1" in str(caught.value)
