"""`deltak check --probe` shows what covariates read; one that is silent spoils nothing."""

import threading
from pathlib import Path

import numpy as np
import pytest

from agent.commissioning import probe
from agent.commissioning.progress import silent
from agent.commissioning.readings import Gathering
from agent.config import load
from agent.runtime.sources import Arrival, Use, connect
from drivers.port import Counts, SampleBlock
from drivers.reconnect import LinkEvent
from tests.unit.config.test_covariates import HALL, THERMOMETER, put

SIGNALS = np.random.default_rng(2).normal(size=(400, 3))
DEGREES = np.array([[20.0], [np.nan], [23.0]])


class Heard:
    """A connection that hands on once what it read, or that it was lost."""

    def __init__(self, use: Use, values: np.ndarray, events: list[LinkEvent]) -> None:
        self.uses, self.counts, self._events = [use], Counts(received=len(values)), events
        block = SampleBlock(values, 10**9, counter=np.arange(len(values)))
        self._arrivals = [Arrival(block, self.counts, 2**16)] if len(values) else []

    def start(self) -> None:
        """Have nothing to open."""

    def stop(self) -> None:
        """Have nothing to close."""

    def take(self) -> tuple[list[Arrival], list[LinkEvent]]:
        """Return all at the first call."""
        taken = self._arrivals, self._events
        self._arrivals, self._events = [], []
        return taken


def probed(folder: Path, monkeypatch: pytest.MonkeyPatch, degrees: np.ndarray) -> Gathering:
    config = load(put(folder, HALL + "offset = 0.5\n", THERMOMETER))
    signals, thermometer = (one.uses[0] for one in connect([config], threading.Event()))
    lost = [] if len(degrees) else [LinkEvent("lost", "no such device", 0.0)]
    heard = [Heard(signals, SIGNALS, []), Heard(thermometer, degrees, lost)]
    monkeypatch.setattr(probe, "connect", lambda *_: heard)
    return probe.listen(config, silent, 0.0)


def test_probe_shows_a_covariate_in_its_own_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = probed(tmp_path, monkeypatch, DEGREES).recorded("the probe")
    assert recorded is not None
    *signals, hall = recorded.facts["channels"]
    assert [row["name"] for row in signals] == ["force", "x1", "x2"]
    assert (hall["name"], hall["unit"], hall["source"]) == ("hall", "degC", "thermometer")
    assert (hall["min"], hall["max"], hall["missing"]) == (20.5, 23.5, 1)
    assert [source["name"] for source in recorded.facts["sources"]] == ["modbus"]


def test_probe_of_a_silent_thermometer_shows_that_and_all_channels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = probed(tmp_path, monkeypatch, np.zeros((0, 1))).recorded("the probe")
    assert recorded is not None
    *signals, hall = recorded.facts["channels"]
    assert len(signals) == 3
    assert hall["min"] is None
