"""What was learnt is kept over edits that leave its part of the configuration untouched."""

import pytest

from agent.config import learnt_key
from tests.unit.config.config_texts import MOTOR, PRESS, changed, read

KEY = learnt_key(read(PRESS))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("limit = 15.0", "limit = 12.0"),
        ('priority = "high"', 'priority = "low"'),
        ("max_mb = 1024", "max_mb = 100"),
        ('channel = "can0"', 'channel = "can1"'),
        ('site = "hall 2"', 'site = "hall 3"'),
        ("resolve = 0.33", "resolve = 0.2"),
        ("[estimator]", "# mended\n[estimator]"),
        ("value = 5.0 }", "value = 5.0, sd_percent = 2.0 }"),
        ("noise_sd = 1e-6", "noise_sd = 1e-6\ngain_sd_percent = 1"),
    ],
)
def test_key_stays_where_nothing_was_changed_that_knowledge_rests_on(old: str, new: str) -> None:
    assert learnt_key(read(changed(PRESS, (old, new)))) == KEY


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("sample_rate_hz = 1000.0", "sample_rate_hz = 500.0"),
        ("value = 5.0 }", "value = 5.1 }"),
        ("value = 5.0 }", "value = 5.0, sd_percent = 0 }"),
        ("nominal = 25.0", "nominal = 26.0"),
        ("noise_sd = 1e-6", "noise_sd = 2e-6"),
        ("noise_sd = 1e-6", "noise_sd = 1e-6\ngain_sd_percent = 0.2"),
        ("scale = 1.0", "scale = 1.1"),
        ("scale = 1.0", "delay_sd_s = 0.001"),
        ("window_s = 0.25", "window_s = 0.5"),
        ("window_s = 0.25", "window_s = [0.25, 0.5]"),
        ("window_s = 0.25", 'window_s = "auto"'),
        ("hop_s = 0.05", "hop_s = 0.1"),
        ('hold = "first"', 'hold = "zero"'),
        ('"B1", "B2"]\nobserver', '"B1", "B2", "m1"]\nobserver'),
        ('name = "x2"', 'name = "y2"'),
    ],
)
def test_key_changes_with_the_model_the_channels_and_how_it_is_estimated(old: str, new: str) -> None:
    found = learnt_key(read(changed(PRESS, (old, new), *([("x2 = ", "y2 = ")] if "y2" in new else []))))
    assert found != KEY
    assert len(found) == len(KEY) == 64


def test_key_of_a_linear_model_changes_with_its_matrices() -> None:
    assert learnt_key(read(MOTOR)) != learnt_key(read(changed(MOTOR, ("-50.0", "-51.0"))))
