"""What method = "seed" asks for and refuses, each at its key path with what to do instead."""

import pytest

from tests.unit.config.config_texts import PRESS, changed, faults, read, with_fake_driver

POLES = ('observer = { gain = "auto" }', 'observer = { gain = "poles", poles = [-90, -80, -70, -60] }')
SEED = ('method = "window-ml"', 'method = "seed"')


@pytest.fixture(autouse=True)
def _fake_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    with_fake_driver(monkeypatch)


def test_seed_with_poles_is_read() -> None:
    assert read(changed(PRESS, SEED, POLES)).estimator.passes == 10


def test_seed_default_gain_is_refused_with_the_number_of_poles() -> None:
    found = faults(changed(PRESS, SEED))
    assert list(found) == ["estimator.observer"]
    assert "needs an observer given by its poles" in found["estimator.observer"]
    assert "give 4 poles two to six times as fast" in found["estimator.observer"]


@pytest.mark.parametrize(
    ("change", "path"),
    [
        (("bias = false", "bias = true"), "channel[1].bias"),
        (('"B1", "B2"]\nobserver', '"B1", "x1.bias"]\nobserver'), "estimator.estimate[3]"),
        (('"B1", "B2"]\nobserver', '"x1.gain", "x2.gain"]\nobserver'), "estimator.estimate"),
    ],
)
def test_seed_what_it_would_ignore_is_refused(change: tuple[str, str], path: str) -> None:
    found = faults(changed(PRESS, SEED, POLES, change))
    assert list(found) == [path]
    assert 'method = "seed"' in found[path]
    assert 'method = "window-ml" does it' in found[path]


def test_seed_takes_several_windows_the_gain_of_a_sensor_and_rules_that_end_its_descents() -> None:
    stop = ("resolve = 0.33", "resolve = 0.33\nrank = 1\nstop = { step = 1e-8, iterations = 17 }")
    windows = ("window_s = 0.25", "window_s = [0.25, 0.5]")
    estimator = read(changed(PRESS, SEED, POLES, stop, windows, ("bias = false", "gain = true"))).estimator
    assert (estimator.stop.step, estimator.stop.cost, estimator.stop.iterations, estimator.rank) == (
        1e-8,
        0.0,
        17,
        1,
    )


def test_rules_of_descent_are_refused_where_nothing_descends() -> None:
    found = faults(changed(PRESS, ("resolve = 0.33", "resolve = 0.33\nrank = 1\nstop = { step = 1e-8 }")))
    assert list(found) == ["estimator.stop", "estimator.rank"]
    assert 'goes with method = "seed"' in found["estimator.stop"]
