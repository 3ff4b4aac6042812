"""The steps of a recording's readings are seen in it, and looking for them loses no row."""

from pathlib import Path

import numpy as np
import pytest

from drivers.files.driver import RecordingDriver, RecordingSettings
from drivers.files.resolution import grid_step
from drivers.port import SourceRequest


def test_recording_resolution_is_the_step_of_quantised_columns_and_zero_of_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    n = 500
    counts = np.cumsum(rng.integers(-3, 4, n)).astype(float)
    micrometres = np.round(rng.normal(0.0, 1e-4, n) / 2e-6) * 2e-6
    free = rng.standard_normal(n)
    path = tmp_path / "r.npz"
    np.savez(path, t=np.arange(n) / 100.0, counts=counts, x=micrometres, free=free, still=np.ones(n))
    request = SourceRequest("r", RecordingSettings(path=path), ("counts", "x", "free", "still"))
    driver = RecordingDriver(request)
    driver.open()
    steps = driver.resolution()
    assert np.allclose(steps, [1.0, 2e-6, 0.0, 0.0], rtol=1e-6)
    block = driver.read(1.0)
    assert np.array_equal(block.values[:, 0], counts)
    assert driver.resolution() == (0.0,) * 4  # nothing is left to look at
    driver.close()


def test_recording_of_few_levels_that_are_held_is_switched_and_a_quantised_reading_is_not(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(2)
    n = 1000
    columns = {
        "held": np.repeat(rng.choice([6.0, 12.0], n // 50), 50),
        "coarse": np.round(rng.normal(0.0, 1.0, n)),
        "free": rng.standard_normal(n),
    }
    path = tmp_path / "r.npz"
    np.savez(path, t=np.arange(n) / 100.0, **columns)
    driver = RecordingDriver(SourceRequest("r", RecordingSettings(path=path), tuple(columns)))
    driver.open()
    assert driver.resolution() == (6.0, 1.0, 0.0)
    assert driver.switched() == (True, False, False)
    driver.close()


def test_grid_step_of_readings_that_never_differ_from_the_next_by_one_step_is_found() -> None:
    counts = np.random.default_rng(3).integers(-15_000, 15_000, 1000)
    counts[1::2] += 60_000  # neighbours in time are tens of thousands of steps apart
    step = 50.0 / 2**15
    assert grid_step(counts * step) == pytest.approx(step, rel=1e-12)


@pytest.mark.parametrize(("sd", "decimals"), [(5.0, 6), (5.0, 3), (1e-3, 9), (2e4, 2)])
def test_grid_step_of_decimals_in_a_text_is_that_of_the_last_one(sd: float, decimals: int) -> None:
    readings = np.random.default_rng(4).normal(0.0, sd, 4000)
    text = np.array([float(f"{reading:.{decimals}f}") for reading in readings])
    assert grid_step(text) == pytest.approx(10.0**-decimals, rel=1e-9)


def test_grid_step_of_counts_that_were_tared_is_that_of_the_counts() -> None:
    counts = np.random.default_rng(5).integers(-3000, 3000, 2000) * 1.5e-6
    assert grid_step(counts - counts[:100].mean()) == pytest.approx(1.5e-6, rel=1e-9)


@pytest.mark.parametrize(
    "values", [[], [np.nan, np.nan], [2.0, 2.0, 2.0], [-1.0, 1.0, 1.0, -1.0], [-3.0, -1.0, 1.0, 3.0]]
)
def test_grid_step_of_few_levels_beside_zero_or_of_none_is_nothing(values: list[float]) -> None:
    assert grid_step(np.array(values)) == 0.0


def test_grid_step_of_readings_without_one_is_nothing() -> None:
    rng = np.random.default_rng(6)
    for count in (10, 100, 10_000):
        assert grid_step(rng.standard_normal(count)) == 0.0
        assert grid_step(3.0 + rng.standard_normal(count)) == 0.0
