"""Configuration texts that the tests mutate, and the call that gives their faults."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from agent.config import RigConfig, parse, plugins
from agent.errors import ConfigError

FILE = Path("/rigs/press-7.toml")

# The example of CONTRACT section 3, its driver played by tests.unit.config.config_driver.
PRESS = """
[rig]
name = "press-7"
site = "hall 2"
labels = { line = "A" }
sample_rate_hz = 1000.0
clock = "counter"

[model]
kind = "mass-spring-damper"
mass   = [{ name = "m1", value = 5.0 }, { name = "m2", value = 3.0 }]
spring = [{ name = "k1", between = ["ground", "m1"], nominal = 25.0 }, { name = "k2", between = ["m1", "m2"], nominal = 100.0 }]
damper = [{ name = "B1", between = ["ground", "m1"], nominal = 5.0 }, { name = "B2", between = ["m1", "m2"], nominal = 5.0 }]
friction = []

[[channel]]
name = "force"
quantity = "force"
at = "m2"
unit = "N"
scale = 1.0

[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
noise_sd = 1e-6
bias = false

[[channel]]
name = "x2"
quantity = "displacement"
at = "m2"
unit = "m"

[estimator]
method = "window-ml"
window_s = 0.25
hop_s = 0.05
hold = "first"
estimate = ["k1", "k2", "B1", "B2"]
observer = { gain = "auto" }
resolve = 0.33

[[alarm]]
parameter = "k1"
limit = 15.0
side = "both"
confidence = 0.95
deadband = 1.5
on_delay_s = 0.2
off_delay_s = 2.0
priority = "high"

[[source]]
driver = "can"
interface = "socketcan"
channel = "can0"
dbc = "press7.dbc"
map = { force = "RIG_SAMPLE.Force", x1 = "RIG_SAMPLE.X1", x2 = "RIG_SAMPLE.X2" }
counter = "RIG_SAMPLE.Counter"

[store]
path = "press-7.db"
every_s = 1.0
keep = { full = "7d", minute = "90d", hour = "forever" }
max_mb = 1024
"""  # noqa: E501 - the lines of the contract

MINIMAL = """
[rig]
name = "bench"
sample_rate_hz = 200
[model]
mass = [{ name = "m", value = 2 }]
spring = [{ name = "k", between = ["ground", "m"], nominal = 800 }]
damper = [{ name = "b", between = ["m", "ground"], nominal = 3 }]
[[channel]]
name = "x"
quantity = "displacement"
at = "m"
unit = "mm"
"""

MOTOR = """
[rig]
name = "motor"
sample_rate_hz = 500
[model]
kind = "linear"
A = [[-2.0, -50.0], [5.0, -0.1]]
B = [[100.0], [0.0]]
C = [[1.0, 0.0], [0.0, 1.0]]
parameter = [{ name = "R", nominal = 2.0, unit = "ohm", dA = [[-1.0, 0.0], [0.0, 0.0]] }]
[[channel]]
name = "voltage"
quantity = "input"
unit = "V"
[[channel]]
name = "current"
quantity = "output"
unit = "A"
[[channel]]
name = "speed"
quantity = "output"
unit = "rad/s"
"""


def with_fake_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make "can" the driver of config_driver, "gone" one whose library is missing, "odd" no driver."""
    values = {
        "can": "tests.unit.config.config_driver:FakeDriver",
        "gone": "tests.unit.no_such_module:Driver",
        "odd": "tests.unit.config.config_driver:FakeSettings",
    }
    entries = {name: EntryPoint(name, value, plugins.GROUP) for name, value in values.items()}
    monkeypatch.setattr(plugins, "driver_entries", lambda: entries)


def read(text: str) -> RigConfig:
    return parse(text.encode(), FILE)


def changed(text: str, *changes: tuple[str, str]) -> str:
    """Replace each first text by the second; the first must be there."""
    for old, new in changes:
        assert old in text, f"the base text has no {old!r}"
        text = text.replace(old, new, 1)
    return text


def faults(text: str) -> dict[str, str]:
    """Return the faults of a text by key path, as printed; none where it is right."""
    try:
        read(text)
    except ConfigError as error:
        found: dict[str, str] = {}
        for fault in error.faults:
            found[fault.path] = "\n".join(filter(None, [found.get(fault.path), str(fault)]))
        return found
    return {}
