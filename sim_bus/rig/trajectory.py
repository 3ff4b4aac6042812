"""The rig being played: chunks of true motion and sensor readings, made once, in order, whoever asks.

Chunks lie on a fixed grid, so that what is played depends on configuration, scenario and seed alone, never on
when a device was read.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_bus.arrays import FloatArray
from sim_bus.errors import SimUsageError
from sim_bus.rig.covariates.course import Covariates
from sim_bus.rig.excitation import ForceStream
from sim_bus.rig.plant import Hold, Moving, PlantError, propagate, step
from sim_bus.rig.rigfile import Channel, RigFile, System
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.schedule import Timeline
from sim_bus.rig.sensors import SensorChain, noise_for
from sim_bus.rig.wear import WearPath
from sim_bus.tuning import CHUNK, KEPT, PREPARED


@dataclass(frozen=True, slots=True)
class Chunk:
    """Consecutive samples `first` .. `first` + n − 1.

    Attributes:
        forces: (n, nodes) N.
        states: (n, states) in the order of `Graph.state_names`, SI.
        parameters: (n, parameters) in the order of `Timeline.names`: what governs the interval that begins
            here.
        true: (n, channels) what ideal sensors would read, SI.
        readings: (n, channels) what the sensors read, in the channels' units.
        covariates: (n, covariates) what is read of them, in their units.
    """

    first: int
    forces: FloatArray
    states: FloatArray
    parameters: FloatArray
    true: FloatArray
    readings: FloatArray
    covariates: FloatArray

    def __len__(self) -> int:
        return len(self.covariates)


class Signals:
    """What ideal sensors read during a run of intervals with the same parameters.

    Args:
        motion: the equations in force.
        channels: the sensors, each with the place at which it reads.
        sample_s, hold: of the force.
        parts: for each channel the place within the interval at which it reads, 0 .. 1.
    """

    def __init__(
        self,
        motion: Moving,
        channels: tuple[tuple[Channel, str], ...],
        sample_s: float,
        hold: Hold,
        parts: tuple[float, ...],
    ) -> None:
        self.step = step(motion, sample_s, hold)
        self._hold = hold
        self._channels = channels
        self._columns = [motion.node(at) if c.is_input else None for c, at in channels]
        self._rows = [None if c.is_input else motion.output(c.quantity, at) for c, at in channels]
        self._parts = parts
        self._part_steps = {part: step(motion, sample_s, hold, part) for part in set(parts) if part}

    def read(self, states: FloatArray, before: FloatArray, after: FloatArray, *, late: bool) -> FloatArray:
        """Return (n, channels) SI at the samples, or, `late`, at each channel's place between them.

        Args:
            states: (n, states) at the samples.
            before: (n, nodes) forces at the samples.
            after: (n, nodes) forces at the samples that follow.
            late: read within the interval instead of at its beginning.
        """
        out = np.empty((len(states), len(self._channels)))
        for column, (place, rows) in enumerate(zip(self._columns, self._rows, strict=True)):
            x, u = self._between(self._parts[column] if late else 0.0, states, before, after)
            out[:, column] = u[:, place] if rows is None else x @ rows[0] + u @ rows[1]
        return out

    def _between(
        self, part: float, states: FloatArray, before: FloatArray, after: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        if not part:
            return states, before
        moved = self._part_steps[part]
        forces = before if self._hold == "zero" else before + part * (after - before)
        return states @ moved.A.T + before @ moved.B0.T + after @ moved.B1.T, forces


class Rig:
    """Mechanics and sensors of one rig, sample after sample.

    Args:
        rig: the configuration.
        scenario: what is played.

    Attributes:
        carried: by channel, the values (before the channel's scale) that its field on the wire can carry.
        covariates: what covariates are.

    Raises:
        SimUsageError: the scenario does not fit the rig, or the graph has no motion.
    """

    def __init__(self, rig: RigFile, scenario: Scenario) -> None:
        scenario.fits(rig)
        self.channels = rig.channel
        self.graph: System = rig.system
        self._places = tuple((channel, rig.place(channel)) for channel in rig.channel)
        self._rate, self.hold = rig.rig.sample_rate_hz, rig.hold
        self.covariates = Covariates(rig.covariate, scenario.covariate, scenario.folder)
        paths = [
            WearPath(wear, self._rate, (scenario.seed, 6, number), rig.nominal, self.covariates)
            for number, wear in enumerate(scenario.wear)
        ]
        self.timeline = Timeline(rig.nominal, scenario.changes, self._rate, paths)
        forces = scenario.forces_on(rig)
        self._forces = ForceStream(forces, self.graph.nodes, self._rate, scenario.seed, scenario.folder)
        self._scenario = scenario
        self.sensors = self.more_sensors(self._rate)
        lags = [chain.delay_s * self._rate for chain in self.sensors]
        self._whole = [math.ceil(lag - 1e-9) for lag in lags]
        self._parts = tuple(max(0.0, whole - lag) for whole, lag in zip(self._whole, lags, strict=True))
        self._prepared: dict[tuple[float, ...], Signals] = {}
        self._state = self._initial(scenario)
        self._ahead = self._forces.take(1)
        self._index = 0
        self._past = self._before_start()
        self.carried: dict[str, tuple[float, float]] = {}
        self._covariate_noise = self.more_noise()

    def more_sensors(self, rate_hz: float) -> list[SensorChain]:
        """Return the sensors anew, as they are before the first sample, read so many times a second."""
        return [self._sensor(number, channel, rate_hz) for number, channel in enumerate(self.channels)]

    def more_noise(self) -> np.random.Generator:
        """Return the noise of what is read of covariates anew."""
        return np.random.default_rng([self._scenario.seed, 8])

    def _sensor(self, number: int, channel: Channel, rate_hz: float) -> SensorChain:
        scenario = self._scenario
        own = [sensor for sensor in scenario.sensors_on(self.channels) if sensor.channel == channel.name]
        rng = np.random.default_rng([scenario.seed, 3, number])
        return SensorChain(channel, own, noise_for(channel, scenario.noise), rate_hz, rng)

    def _initial(self, scenario: Scenario) -> FloatArray:
        initial = scenario.initial
        values = {f"q.{n}": x for n, x in initial.displacement.items()}
        values |= {f"v.{n}": x for n, x in initial.velocity.items()} | initial.state
        return np.array([values.get(name, initial.all) for name in self.graph.state_names])

    def _before_start(self) -> list[FloatArray]:
        """Return for each channel what a late sensor reads before the first sample has come through."""
        try:
            rest = self._signals(0).read(self._state[None], self._ahead, self._ahead, late=False)[0]
        except PlantError as error:
            raise SimUsageError(f"model: {error}") from error
        return [np.full(whole, value) for whole, value in zip(self._whole, rest, strict=True)]

    def _signals(self, index: int) -> Signals:
        values = self.timeline.values(index)
        key = tuple(values.values())
        if key not in self._prepared:
            if len(self._prepared) >= PREPARED:
                self._prepared.clear()
            motion = self.graph.equations(values)
            self._prepared[key] = Signals(motion, self._places, 1.0 / self._rate, self.hold, self._parts)
        return self._prepared[key]

    def advance(self, count: int) -> Chunk:
        """Return the next `count` samples."""
        first, self._index = self._index, self._index + count
        forces = np.vstack([self._ahead, self._forces.take(count)])
        self._ahead = forces[-1:]
        states, parameters, true, sensed = (
            np.empty((count, width))
            for width in (len(self._state), len(self.timeline.names), len(self.channels), len(self.channels))
        )
        for start, end, values in self.timeline.segments(first, first + count):
            here, after = slice(start - first, end - first), slice(start - first + 1, end - first + 1)
            signals = self._signals(start)
            run = propagate(signals.step, self._state, forces[start - first : end - first + 1])
            self._state = run[-1]
            states[here] = run[:-1]
            parameters[here] = list(values.values())
            true[here] = signals.read(run[:-1], forces[here], forces[after], late=False)
            sensed[here] = true[here]
            if any(self._parts):
                sensed[here] = signals.read(run[:-1], forces[here], forces[after], late=True)
        beside = self.covariates.read(np.arange(first, first + count) / self._rate, self._covariate_noise)
        return Chunk(first, forces[:-1], states, parameters, true, self._read(first, sensed), beside)

    def _read(self, first: int, sensed: FloatArray) -> FloatArray:
        index = np.arange(first, first + len(sensed))
        columns = []
        for column, chain in enumerate(self.sensors):
            line = np.concatenate([self._past[column], sensed[:, column]])
            self._past[column] = line[len(sensed) :]
            columns.append(chain.read(index, line[: len(sensed)]))
        return np.column_stack(columns)


class Trajectory:
    """Chunks by number, made in order on demand, the newest kept; safe to be shared by the devices' threads.

    Args:
        rig: what is played.
        watch: called with each chunk when it is made.
    """

    def __init__(self, rig: Rig, watch: Callable[[Chunk], None] | None = None) -> None:
        self.rig = rig
        self._watch = watch
        self._lock = threading.Lock()
        self._chunks: deque[Chunk] = deque(maxlen=KEPT)
        self._made = 0

    def chunk(self, number: int) -> Chunk:
        """Return samples number · CHUNK to (number + 1) · CHUNK − 1; LookupError if no longer kept."""
        with self._lock:
            while self._made <= number:
                self._make()
            behind = self._made - number
            if behind > len(self._chunks):
                raise LookupError(
                    f"samples from {number * CHUNK} on are gone; the newest {KEPT * CHUNK} are kept"
                )
            return self._chunks[-behind]

    def _make(self) -> None:
        chunk = self.rig.advance(CHUNK)
        self._chunks.append(chunk)
        self._made += 1
        if self._watch is not None:
            self._watch(chunk)
