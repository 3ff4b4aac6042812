"""What sensors make of the true signals: bias, gain, drift, noise, spikes, a rail, steps, a stuck value.

Delay is taken where the motion is computed (it is exact there); the wire rounds on its own.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from sim_bus.arrays import FloatArray, IntArray
from sim_bus.rig.ranges import Runs
from sim_bus.rig.rigfile import Channel, Quantity
from sim_bus.tables import Table


class Sensor(Table):
    """One [[sensor]], in the channel's unit; `from_s` .. `until_s` bounds bias, gain, drift, stuck, rail.

    reading = (1 + gain) · true + bias + drift_per_s · (t − from_s) + noise + spikes, then held within ± rail
    and rounded to `step`; with `stuck` the reading of `from_s` stays, give or take `flicker`. `delay_s` is
    added to the channel's own. With `measure` "peak" bias, drift_per_s, rail, spike and flicker are shares of
    the largest reading before `from_s`.
    """

    channel: str
    noise_sd: float | None = Field(default=None, ge=0)
    bias: float = 0.0
    gain: float = 0.0
    drift_per_s: float = 0.0
    rail: float = Field(default=float("inf"), gt=0)
    step: float = Field(default=0.0, ge=0)
    stuck: bool = False
    flicker: float = Field(default=0.0, ge=0)
    measure: Literal["unit", "peak"] = "unit"
    spike: float = 0.0
    spikes_hz: float = Field(default=0.0, ge=0)
    delay_s: float = Field(default=0.0, ge=0)
    from_s: float = Field(default=0.0, ge=0)
    until_s: float = float("inf")


class Oscillator(Table):
    """One [[device]]: the clock by which a source's device samples; every source's without `source`.

    `drift_ppm` above 0: it is slow, its samples come later and later. `jitter_s`: standard deviation of when
    within its turn a sample is taken (at most 0.45 of a sample).
    """

    source: str | None = None
    drift_ppm: float = Field(default=0.0, gt=-1e5, lt=1e5)
    jitter_s: float = Field(default=0.0, ge=0)

    @property
    def slowness(self) -> float:
        """Seconds of the rig in a second of the device."""
        return 1.0 + 1e-6 * self.drift_ppm


class SensorChain:
    """One channel's sensor, drawn in order.

    Args:
        channel: the channel.
        sensors: what the scenario says of it, applied one after another.
        noise_si: the scenario's noise for this quantity, SI; a sensor's own `noise_sd` goes before it.
        sample_rate_hz: samples a second.
        rng: for noise and spikes.
    """

    def __init__(
        self,
        channel: Channel,
        sensors: list[Sensor],
        noise_si: float,
        sample_rate_hz: float,
        rng: np.random.Generator,
    ) -> None:
        self.channel = channel
        self._sensors = sensors
        self._rate = sample_rate_hz
        self._rng = rng
        own = [sensor.noise_sd for sensor in sensors if sensor.noise_sd is not None]
        self.noise_sd = own[-1] if own else noise_si / channel.si_factor
        self._stuck_at: dict[int, float] = {}
        self._peaks: dict[int, float] = {}
        self._affected: dict[str, Runs] = {}

    @property
    def delay_s(self) -> float:
        """By how much the reading is late."""
        return self.channel.delay_s + sum(sensor.delay_s for sensor in self._sensors)

    def read(self, index: IntArray, true_si: FloatArray) -> FloatArray:
        """Return the readings, in the channel's unit, at consecutive samples."""
        readings = true_si / self.channel.si_factor
        if self.noise_sd:
            readings = readings + self.noise_sd * self._rng.standard_normal(len(index))
        for number, sensor in enumerate(self._sensors):
            readings = self._apply(number, sensor, index, readings)
        return readings

    def _apply(self, number: int, sensor: Sensor, index: IntArray, readings: FloatArray) -> FloatArray:
        t = index / self._rate
        live = (t >= sensor.from_s) & (t < sensor.until_s)
        one = self._measure(number, sensor, readings[t < sensor.from_s])
        changed = (1.0 + sensor.gain) * readings + one * (
            sensor.bias + sensor.drift_per_s * (t - sensor.from_s)
        )
        if sensor.spike and sensor.spikes_hz:
            hit = self._rng.random(len(index)) < sensor.spikes_hz / self._rate
            self._note("spike", index[hit & live])
            changed = changed + np.where(
                hit, one * sensor.spike * np.sign(self._rng.random(len(index)) - 0.5), 0.0
            )
        railed = np.clip(changed, -one * sensor.rail, one * sensor.rail)
        self._note("saturated", index[(railed != changed) & live])
        if sensor.step:
            railed = np.rint(railed / sensor.step) * sensor.step
        if sensor.stuck and live.any():
            stands = np.full_like(railed, self._stuck_at.setdefault(number, float(readings[live][0])))
            railed = stands + one * sensor.flicker * (index % 2) if sensor.flicker else stands
            self._note("stuck", index[live])
        return np.where(live, railed, readings)

    def _measure(self, number: int, sensor: Sensor, before: FloatArray) -> float:
        """Return what the sensor's numbers are counted in, the readings before it fails having gone on."""
        if sensor.measure == "unit":
            return 1.0
        peak = max(self._peaks.get(number, 0.0), float(np.abs(before).max(initial=0.0)))
        self._peaks[number] = peak
        return peak

    def affected_before(self, end: int) -> dict[str, list[tuple[int, int]]]:
        """Return, by kind, the runs (first, last) of samples before `end` that a sensor fault touched."""
        touched = {kind: runs.before(end) for kind, runs in self._affected.items()}
        return {kind: runs for kind, runs in touched.items() if runs}

    def _note(self, kind: str, index: IntArray) -> None:
        """Keep which samples were touched."""
        self._affected.setdefault(kind, Runs()).add_each(index)


def noise_for(channel: Channel, noise: Mapping[Quantity, float]) -> float:
    """Return the scenario's noise for the channel's quantity, SI."""
    return noise.get(channel.quantity, 0.0)
