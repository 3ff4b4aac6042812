"""The steps of a recording's readings are seen in it, and looking for them loses no row."""

from pathlib import Path

import numpy as np

from drivers.port import SourceRequest
from drivers.recording import RecordingDriver, RecordingSettings


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


def test_recording_of_few_levels_that_are_held_is_switched_and_a_quantised_reading_is_not(tmp_path: Path) -> None:
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
