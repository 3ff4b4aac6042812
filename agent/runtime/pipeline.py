"""The deterministic pipeline of one rig, which live and replay share: blocks of samples in, records out.

    SampleBlock -> acquisition (DA) -> quality (DM) -> estimation (SD) -> level alarms (HA, AG) -> records

It reads no clock and does no input or output; labels and counts are handed in.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from agent.blocks.acquisition.interface import Acquisition, Label, Through
from agent.blocks.acquisition.source_clocks import SourceClocks
from agent.blocks.channel_watch import ChannelWatch
from agent.blocks.constants_watch import ConstantsWatch
from agent.blocks.estimation import ESTIMATION, FAILURE, Estimation
from agent.blocks.friction import dry_friction
from agent.blocks.level_alarms import LevelAlarms
from agent.blocks.quality import Quality, QualitySettings
from agent.blocks.rig_model import hop_plan, longest_bridge, rig_model
from agent.blocks.sensor_alarms import SensorAlarms
from agent.config import RigConfig, learnt_key
from agent.runtime.acquisition_plan import make_acquisition
from agent.runtime.methods import make_estimation
from agent.types import (
    Aligned,
    EstimateBatch,
    FloatArray,
    Health,
    HealthEvent,
    IntArray,
    Learnt,
    LearntRecord,
    Record,
    Samples,
)
from drivers.port import Counts, SampleBlock


@dataclass(slots=True)
class Conservation:
    """Where the samples of one source went, counted in three places and added up nowhere but here.

    Attributes:
        driver: what the driver met.
        dropped: lost between driver and pipeline, by reason.
    """

    driver: Counts
    dropped: Counter[str]


Piece = tuple[IntArray, IntArray, FloatArray]
"""Numbers and times (n,) of samples, and their readings (n, c)."""


class Taken(NamedTuple):
    """Samples that wait to be computed; anew and realigning as `Aligned` has them."""

    anew: bool
    realigning: bool
    piece: Piece


class Pipeline:
    """One rig from samples to records.

    Args:
        config: the rig's configuration.
        resolution: (channels,) smallest step of the wire for each channel, in the reading's unit; inputs first.
        sources: names of its sources with their channel -> field maps; one called "recording" for a replay.

    Attributes:
        watch: shown the samples that reach the estimation, where somebody asks.
    """

    def __init__(
        self, config: RigConfig, resolution: Mapping[str, float], sources: Mapping[str, Mapping[str, str]]
    ) -> None:
        self.config = config
        self._key = learnt_key(config)
        channels = [*config.inputs, *config.outputs]
        rig = config.rig
        self._steps = np.array([resolution.get(c.name, 0.0) * abs(c.scale) * c.si_factor for c in channels])
        steps = self._steps[len(config.inputs) :]
        # first, since it says in words what the others would stumble over
        self.begin_numerics()
        self.acquisition: Acquisition = make_acquisition(config, sources, steps)
        self.clocks = SourceClocks()
        self.newest_ns = 0
        self._taken: list[Taken] = []
        self._said: list[Record] = []
        self.watch: Callable[[Samples], None] | None = None
        self.alarms = LevelAlarms(rig.name, config.alarm, rig.sample_rate_hz)
        self.sensor_alarms = SensorAlarms(rig.name)

    def begin_numerics(self) -> None:
        """Make what judges and estimates, new: it knows of no sample."""
        config, inputs = self.config, len(self.config.inputs)
        channels = [*config.inputs, *config.outputs]
        names, quantities = tuple(c.name for c in channels), tuple(c.quantity for c in channels)
        longest, window = longest_bridge(rig_model(config).model, config.rig.sample_rate_hz), hop_plan(config).window
        self.estimation: Estimation = make_estimation(config, self._steps[inputs:])
        commanded = config.estimator.hold == "zero"
        self.quality = Quality(QualitySettings(names, inputs, self._steps, window, longest, quantities, commanded))
        self.friction = dry_friction(config, self._steps[inputs:])
        outputs = frozenset(c.name for c in channels[inputs:])
        counted = (*config.outputs, *config.inputs)
        self.channels = ChannelWatch(config.rig.name, tuple((c.name, c.quantity) for c in counted))
        self.constants = ConstantsWatch(config.rig.name, 1.0 / config.rig.sample_rate_hz, outputs)

    def adopt(self, learnt: Learnt | None) -> None:
        """Begin with what an earlier run learnt of the rig, before the first sample."""
        if learnt is not None:
            self.estimation.estimator.adopt(learnt.content)

    def step(self, source: str, block: SampleBlock, modulus: int | None, label: Label | None) -> list[Record]:
        """Take a block of one source and return what it leads to, in order of time; for label see `take`."""
        self.take(source, block, modulus, label)
        return self.compute()

    def take(self, source: str, block: SampleBlock, modulus: int | None, label: Label | None) -> None:
        """Number, convert and label a block of one source; `compute` makes of it and of others what it leads to.

        label: time stamps of sample indices; None takes the block's own stamps (a recording's), or index / rate.
        """
        self._keep(self.acquisition.step(source, block, modulus, label))
        self._said += self._source_events()
        if label is not None and len(block):
            self.clocks.observe(self.acquisition.sources[source], block.arrival_ns)

    def compute(self) -> list[Record]:
        """Return what all blocks taken since the last call lead to, in order of time.

        The rows are the same however many blocks that were. Their cost is mostly by the call: many are cheaper at once.
        """
        taken, said = self._taken, self._said
        self._taken, self._said = [], []
        records: list[Record] = []
        for anew, realigning, pieces in _alike(taken):
            index, t_ns, v = (np.concatenate(part) for part in zip(*pieces, strict=True))
            if realigning:
                records += self._estimated(self.quality.unpaired(index, t_ns, v))
            else:
                records += self._estimated(self.quality.step(index, t_ns, v, anew=anew))
        return records + said

    def hurry(self) -> None:
        """Begin no fit, search or measurement any more: what waits for one waits for ever. From any thread."""
        self.estimation.estimator.hurry()
        self.acquisition.hurry()

    def finish(self) -> list[Record]:
        """Return what the samples lead to that wait for others that will not come."""
        self._keep(self.acquisition.finish())
        self._said += self._source_events()
        return self.compute() + self._estimated(self.quality.finish())

    def _keep(self, pieces: Sequence[Aligned]) -> None:
        for aligned in pieces:
            t_ns = self._stamps(aligned)
            self.newest_ns = int(t_ns[-1])
            piece = aligned.index, t_ns, np.hstack([aligned.u, aligned.y])
            self._taken.append(Taken(aligned.anew, aligned.realigning, piece))

    def _source_events(self) -> list[Record]:
        rig, t_ns = self.config.rig.name, self.newest_ns
        events = self.acquisition.take_events()
        return [HealthEvent(rig, event.source, t_ns, event.cause, event.message) for event in events]

    def _estimated(self, pieces: Sequence[Samples]) -> list[Record]:
        records: list[Record] = []
        self.acquisition.arrived(pieces)
        for samples in pieces:
            complete = replace(samples, u=self.friction.step(samples)) if samples.usable else samples
            if self.watch is not None:
                self.watch(complete)
            batch = self.estimation.step(complete)
            if batch is not None:
                records.append(batch)
                records.extend(self._failures(batch))
                records.extend(self._learnt(batch))
                records.extend(self._found(batch))
                records.extend(self.alarms.step(batch))
                records.extend(self.sensor_alarms.confirm(batch))
        records.extend(self.sensor_alarms.step(self.quality.take_events()))
        return records

    def _failures(self, batch: EstimateBatch) -> list[Record]:
        """Return an event for each numerical failure of the method."""
        rig, newest = self.config.rig.name, int(batch.t_ns[-1])
        words = "the estimation failed and starts anew: {}".format
        failures = self.estimation.failures()
        return [HealthEvent(rig, ESTIMATION, newest, FAILURE, words(what)) for _, what in failures]

    def _learnt(self, batch: EstimateBatch) -> list[Record]:
        """Return what windows taught of the rig: verdicts on its constants, and what the next start begins with."""
        estimator = self.estimation.estimator
        learnt = estimator.take_beliefs()
        if not learnt:
            return []
        times = dict(zip(batch.index.tolist(), batch.t_ns.tolist(), strict=True))
        newest = int(batch.t_ns[-1])
        verdicts, events, alarms = self.constants.step(learnt, {s: times.get(s, newest) for s, _ in learnt})
        content = estimator.knowledge()
        kept: list[Record] = []
        if content is not None:
            kept.append(LearntRecord(self.config.rig.name, newest, Learnt(self._key, content)))
        return [*verdicts, *events, *self.sensor_alarms.step(alarms), *kept]

    def _found(self, batch: EstimateBatch) -> list[Record]:
        """Return what the method finds wrong with channels."""
        findings = self.estimation.estimator.take_findings()
        times = dict(zip(batch.index.tolist(), batch.t_ns.tolist(), strict=True))
        newest = int(batch.t_ns[-1])
        events, alarms = self.channels.step(findings, {f.sample: times.get(f.sample, newest) for f in findings})
        return [*events, *self.sensor_alarms.step(alarms)]

    def _stamps(self, aligned: Aligned) -> IntArray:
        """A recording's own time stamps, or index / rate where it has none."""
        if aligned.stamps is not None:
            return aligned.stamps
        period = np.longdouble(1e9) / np.longdouble(self.config.rig.sample_rate_hz)
        return np.asarray(np.rint(aligned.index * period).astype(np.int64))

    def health(self, conservation: Mapping[str, Conservation], t_ns: int, lag_s: float | None) -> list[Health]:
        """Return the ledger of every source: driver, acquisition and estimation each give their own count.

        Samples that were taken and not computed yet are in no count but the driver's.
        """
        return [self._health_of(name, state, t_ns, lag_s) for name, state in conservation.items()]

    def _health_of(self, name: str, conservation: Conservation, t_ns: int, lag_s: float | None) -> Health:
        state, driver = self.acquisition.sources[name], conservation.driver
        used, _ = self.ends(name)
        return Health(
            rig=self.config.rig.name, source=name, t_ns=t_ns, received=driver.received + driver.dropped.total(),
            used=used, rejected=dict(self.rejected(name, driver)),
            dropped=dict(driver.dropped + conservation.dropped), gaps=state.gaps, lag_s=lag_s,
            faults=dict(driver.faults), clock=self.clocks.report(name, *self._skew(name)),
        )  # fmt: skip

    def rejected(self, name: str, driver: Counts) -> Counter[str]:
        """Return a source's samples that were refused by its driver, or after it, by reason."""
        return driver.rejected + self.acquisition.sources[name].refusals() + self.ends(name)[1]

    def ends(self, name: str) -> tuple[int, Counter[str]]:
        """How many of a source's samples were used or still wait, and those refused after it, by reason."""
        return self.acquisition.ends(name, self.through())

    def through(self) -> Through:
        """Count the rows that acquisition handed on since the numerics began."""
        # inputs that only the motion gave away as spikes
        spikes = self.estimation.estimator.spikes
        rejected = self.quality.rejected + Counter({"spike": spikes})
        return Through(self.estimation.used - spikes, self.quality.waiting, rejected)

    def _skew(self, name: str) -> tuple[float | None, float | None]:
        return self.acquisition.skews().get(name, (None, None))


def _alike(taken: Sequence[Taken]) -> Iterator[tuple[bool, bool, list[Piece]]]:
    """Yield what can be computed at once: whether it is anew and realigning, and its pieces."""
    start = 0
    for stop in range(1, len(taken) + 1):
        if stop == len(taken) or taken[stop].anew or taken[stop].realigning != taken[start].realigning:
            yield taken[start].anew, taken[start].realigning, [one.piece for one in taken[start:stop]]
            start = stop


def resolutions(maps: Sequence[Mapping[str, str]], steps: Sequence[Sequence[float]]) -> dict[str, float]:
    """Return the wire's smallest step of each channel, from the sources' maps and the drivers' answers."""
    return {
        channel: float(step)
        for mapping, answer in zip(maps, steps, strict=True)
        for channel, step in zip(mapping, answer, strict=True)
    }
