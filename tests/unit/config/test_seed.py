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
        (("window_s = 0.25", "window_s = [0.25, 0.5]"), "estimator.window_s"),
        (("window_s = 0.25", 'window_s = "auto"'), "estimator.window_s"),
        (("bias = false", "bias = true"), "channel[1].bias"),
        (("bias = false", "gain = true"), "channel[1].gain"),
        (('"B1", "B2"]\nobserver', '"B1", "x1.gain"]\nobserver'), "estimator.estimate[3]"),
    ],
)
def test_seed_what_it_would_ignore_is_refused(change: tuple[str, str], path: str) -> None:
    found = faults(changed(PRESS, SEED, POLES, change))
    assert list(found) == [path]
    assert 'method = "seed"' in found[path]
    assert 'method = "window-ml" does it' in found[path]
