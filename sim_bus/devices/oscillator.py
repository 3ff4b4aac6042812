"""Devices with clocks of their own: at another rate, a little too slow or too fast, and never quite in time.

A device of r samples a second whose clock drifts takes its sample k at the rig's time k·(1 + drift) / r; what
is read there lies between two samples of the rig. Displacements of nodes with mass are interpolated by
Hermite's cubic through position and velocity (exact but for terms of the fourth order), other motions by the
cubic through four samples, forces as they are held.
"""

from dataclasses import dataclass

import numpy as np

from sim_bus.arrays import FloatArray, IntArray
from sim_bus.clock import PlayClock
from sim_bus.rig.trajectory import Chunk, Rig, Trajectory
from sim_bus.tuning import CHUNK, MOST_JITTER


@dataclass(frozen=True, slots=True)
class Pace:
    """How a device samples.

    Attributes:
        rigs_hz: samples a second of the rig.
        rate_hz: samples a second of the device, by its own clock.
        slowness: seconds of the rig in a second of the device.
        jitter_s: standard deviation of when within its turn a sample is taken.
    """

    rigs_hz: float
    rate_hz: float
    slowness: float = 1.0
    jitter_s: float = 0.0

    @property
    def stride(self) -> float:
        """From one sample of the device to the next, in samples of the rig."""
        return self.rigs_hz / self.rate_hz * self.slowness


_NOTHING = (np.empty((CHUNK, 0)),) * 4
"""Forces, states, parameters and true signals, which no device has."""


class CovariatesAlone(Trajectory):
    """What a device of covariates alone reads by its own clock; no motion has to be computed for it.

    Args:
        trajectory: the rig's.
        pace: the device's.
        seed: of the noise.
    """

    def __init__(self, trajectory: Trajectory, pace: Pace, seed: int) -> None:
        super().__init__(trajectory.rig)
        self._pace = pace
        self._rng = np.random.default_rng([seed, 9])

    def _make(self) -> None:
        index = np.arange(self._made * CHUNK, (self._made + 1) * CHUNK, dtype=np.float64)
        read = self.rig.covariates.read(index * (self._pace.stride / self._pace.rigs_hz), self._rng)
        self._chunks.append(Chunk(self._made * CHUNK, *_NOTHING, np.empty((CHUNK, 0)), read))
        self._made += 1


class OwnTrajectory(Trajectory):
    """What one device reads of the rig by its own clock, in the same chunks.

    Args:
        trajectory: the rig's.
        pace: the device's.
        seed: of the jitter.

    Its chunks hold readings and nothing else.
    """

    def __init__(self, trajectory: Trajectory, pace: Pace, seed: int) -> None:
        super().__init__(trajectory.rig)
        self._rigs = trajectory
        self._pace = pace
        self._rng = np.random.default_rng([seed, 7])
        self._sensors = trajectory.rig.more_sensors(pace.rate_hz)
        self._covariate_noise = trajectory.rig.more_noise()
        self.readings: list[FloatArray] = []

    def _make(self) -> None:
        chunk = self._resampled(self._made)
        self._chunks.append(chunk)
        self._made += 1
        self.readings.append(chunk.readings)

    def _resampled(self, number: int) -> Chunk:
        index = np.arange(number * CHUNK, (number + 1) * CHUNK)
        pace = self._pace
        jitter = np.clip(
            pace.jitter_s * pace.rate_hz * self._rng.standard_normal(CHUNK), -MOST_JITTER, MOST_JITTER
        )
        moment = np.asarray((index + jitter) * pace.stride, dtype=np.float64)
        columns = [
            chain.read(index, self._at(column, np.maximum(moment - chain.delay_s * pace.rigs_hz, 0.0)))
            for column, chain in enumerate(self._sensors)
        ]
        beside = self.rig.covariates.read(moment / pace.rigs_hz, self._covariate_noise)
        return Chunk(number * CHUNK, *_NOTHING, np.column_stack(columns), beside)

    def _at(self, column: int, moment: FloatArray) -> FloatArray:
        """Return what an ideal sensor reads at moments, counted in the rig's samples."""
        low = max(int(moment.min()) - 1, 0)
        high = int(moment.max()) + 3
        chunks = [self._rigs.chunk(n) for n in range(low // CHUNK, high // CHUNK + 1)]
        start = chunks[0].first
        true = np.concatenate([chunk.true[:, column] for chunk in chunks])
        before = np.floor(moment).astype(np.int64) - start
        part = moment - np.floor(moment)
        rates = self._rates(column, chunks)
        if self._rigs.rig.channels[column].is_input:
            ahead = part if self._rigs.rig.hold == "first" else np.zeros_like(part)
            return np.asarray(true[before] + ahead * (true[before + 1] - true[before]))
        if rates is not None:
            return _hermite(true, rates / self._pace.rigs_hz, before, part)
        return _cubic(true, before, part)

    def _rates(self, column: int, chunks: list[Chunk]) -> FloatArray | None:
        """Return how fast a channel's signal changes at the samples, where the state tells."""
        rig: Rig = self._rigs.rig
        channel = rig.channels[column]
        name = f"v.{channel.at}"
        if channel.quantity != "displacement" or name not in rig.graph.state_names:
            return None
        place = rig.graph.state_names.index(name)
        return np.concatenate([chunk.states[:, place] for chunk in chunks])


def _hermite(y: FloatArray, slope: FloatArray, i: IntArray, s: FloatArray) -> FloatArray:
    """Return the cubic through two samples with their slopes (per sample), s of the way from sample i on."""
    rest = 1.0 - s
    ends = rest**2 * (1.0 + 2.0 * s) * y[i] + s**2 * (3.0 - 2.0 * s) * y[i + 1]
    return np.asarray(ends + s * rest**2 * slope[i] - s**2 * rest * slope[i + 1])


def _cubic(y: FloatArray, i: IntArray, s: FloatArray) -> FloatArray:
    """Return the cubic through the samples i − 1 .. i + 2 (at the beginning 0 .. 3), s beyond sample i."""
    first = np.maximum(i - 1, 0)
    x = s + (i - first)
    out = np.zeros(len(i))
    for k in range(4):
        weight = np.ones(len(i))
        for other in range(4):
            if other != k:
                weight = weight * (x - other) / (k - other)
        out += weight * y[first + k]
    return out


class OwnClock(PlayClock):
    """The clock of a device that shares its rig's start, and not its pace."""

    def __init__(self, rigs: PlayClock, pace: Pace) -> None:
        total = None if rigs.total is None else round(rigs.total * pace.rate_hz / pace.rigs_hz)
        rate = pace.rate_hz / pace.slowness
        super().__init__(rate, total, (), "ready", fast=rigs.fast, now_ns=rigs.now_ns)
        self._rigs = rigs
        self.started = rigs.started

    def meet(self, source: str) -> None:
        self._rigs.meet(source)

    def take(self, source: str, taken: int) -> None:
        self._rigs.take(source, taken)

    def head(self) -> int:
        self.start_ns, self.start_wall_ns = self._rigs.start_ns, self._rigs.start_wall_ns
        return super().head()

    def head_for(self, source: str, room: int) -> int:
        return self._rigs.head_for(source, room) if self.fast else self.head()

    def due_ns(self, index: int) -> int:
        self.start_ns = self._rigs.start_ns
        return super().due_ns(index)
