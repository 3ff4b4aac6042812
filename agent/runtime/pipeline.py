"""The deterministic pipeline of one rig, which live and replay share: blocks of samples in, records out.

    SampleBlock -> acquisition (DA) -> quality (DM) -> estimation (SD) -> alarms (HA, AG) -> records

Each stage's step takes what the one before it returned. No clock is read and nothing is input or output;
labels and counts are handed in.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from agent.blocks.acquisition.interface import Acquired, Acquisition, Label, Through
from agent.blocks.acquisition.source_clocks import SourceClocks
from agent.blocks.advisory.blind_alarms import BlindAlarms
from agent.blocks.advisory.outlook import Outlook
from agent.blocks.advisory.prognosis_alarms import PrognosisAlarms
from agent.blocks.advisory.rest import RestAlarms
from agent.blocks.covariates.compensation import Compensation
from agent.blocks.covariates.means import CovariateMeans
from agent.blocks.estimation import ESTIMATION, FAILURE, Estimated
from agent.blocks.graph import graph_of
from agent.blocks.level_alarms import LevelAlarms
from agent.blocks.references import counted_from
from agent.blocks.rig_model import hop_plan
from agent.blocks.sensor_alarms import SensorAlarms
from agent.blocks.sensor_labels import Labelled
from agent.config import RigConfig, learnt_key
from agent.records import Baseline, ConditionsRecord, CovariateMean, HealthEvent, LearntRecord, Record
from agent.runtime.assembly.acquisition_plan import make_acquisition
from agent.runtime.assembly.stages import make_stages
from agent.runtime.ledger import Ledger
from agent.runtime.tuning import LEARNT_S
from agent.types import Aligned, FloatArray, IntArray, Learnt, Samples
from drivers.port import SampleBlock

Piece = tuple[IntArray, IntArray, FloatArray]
"""Numbers and times (n,) of samples, and their readings (n, c)."""


class Taken(NamedTuple):
    """Samples that wait to be computed; anew and realigning as `Aligned` has them."""

    anew: bool
    realigning: bool
    piece: Piece


class Prepared(NamedTuple):
    """Samples between the quality block and the estimation, and what was found of the sources meanwhile."""

    parts: list[Labelled]
    events: list[Record]
    newest_ns: int

    @property
    def waiting(self) -> int:
        """How many whole samples the estimation will take of them."""
        return sum(
            int(samples.complete.sum()) for part in self.parts for samples in part.values if samples.usable
        )


class Pipeline:
    """One rig from samples to records.

    Args:
        config: the rig's configuration.
        resolution: (channels,) smallest step of the wire for each channel, in the reading's unit; inputs
            first.
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
        self._steps = np.array([resolution.get(c.name, 0.0) * abs(c.scale) * c.si_factor for c in channels])
        # first, since it says in words what the others would stumble over
        self.stages = make_stages(config, self._steps)
        self.acquisition: Acquisition = make_acquisition(config, sources, self._steps[len(config.inputs) :])
        self.alarms = LevelAlarms(config.rig.name, config.limits, config.rig.sample_rate_hz)
        self.prognosis_alarms = PrognosisAlarms(config.rig.name, config.alarm)
        self.sensor_alarms = SensorAlarms(config.rig.name)
        window_s = hop_plan(config).window / config.rig.sample_rate_hz
        self.blind_alarms = BlindAlarms(config.rig.name, config.alarm, config.rig.sample_rate_hz, window_s)
        self.rest_alarms = RestAlarms(config.rig.name, config.alarm, config.rig.sample_rate_hz)
        self.clocks = SourceClocks()
        self.ledger = Ledger(config.rig.name, self.acquisition, self.through, self.clocks)
        self.newest_ns = 0
        self.covariates = CovariateMeans(config.rig.name, config.covariate)
        self.compensation = Compensation(config.rig.name, self.covariates.known)
        self._nominal = self.stages.estimation.labels
        self._baselines: tuple[Baseline, ...] = ()
        self.watch: Callable[[Samples], None] | None = None
        self._taken: list[Taken] = []
        self._source_events: list[Record] = []
        self._conditions_due: dict[int, int] = {}
        self._learnt_ns = self._kept_ns = -(1 << 62)  # of the samples learnt from last, and of those stored
        self._is_kept = True

    def adopt(self, learnt: Learnt | None, covariates: Sequence[CovariateMean] = ()) -> None:
        """Begin with what earlier runs learnt of the rig and saw of covariates, before the first sample."""
        if learnt is not None:
            self.stages.estimation.estimator.adopt(learnt.content)
        self.covariates.adopt(covariates)

    def count_from(self, baselines: tuple[Baseline, ...]) -> list[str]:
        """Count changes from baselines, from the next row on; return why some are not used, in words."""
        if baselines == self._baselines:
            return []
        self._baselines = baselines
        return self._refer()

    def _refer(self) -> list[str]:
        units = {one.name: one.unit for one in self.config.covariate}
        found, refused = counted_from(self._nominal, self._baselines, graph_of(self.config), units)
        self.stages.estimation.labels = found
        used = [one for one in self._baselines if one.baseline_id in set(found.baseline_id or ())]
        self.compensation.count_from(used)
        return refused

    def step(self, source: str, block: SampleBlock, modulus: int | None, label: Label | None) -> list[Record]:
        """Take a block of one source and return what it leads to, in order of time; for label see `take`."""
        self.take(source, block, modulus, label)
        return self.compute()

    def take(self, source: str, block: SampleBlock, modulus: int | None, label: Label | None) -> None:
        """Number, convert and label a block of one source; `compute` makes of it and others what it leads to.

        label: time stamps of sample indices; None takes the block's own stamps (a recording's), or index /
        rate.
        """
        self._keep(self.acquisition.step(source, block, modulus, label))
        if label is not None and len(block):
            self.clocks.observe(self.acquisition.sources[source], block.arrival_ns)

    def take_covariates(self, t_ns: IntArray, readings: Mapping[str, FloatArray]) -> None:
        """Take covariate readings (n,) at instants t_ns (n,); they make no row, and none waits for them."""
        self.covariates.take(t_ns, readings)

    def compute(self) -> list[Record]:
        """Return what all blocks taken since the last call lead to, in order of time.

        The rows are the same however many blocks that were. Their cost is mostly by the call: many are
        cheaper at once.
        """
        events = self._take_events()
        records = [record for part in self._prepared() for record in self._estimated(part)]
        return records + self._beside(events, self.newest_ns)

    def prepare(self) -> Prepared:
        """Do what of `compute` needs no estimate: another thread may, while `estimate` runs."""
        return Prepared(list(self._prepared()), self._take_events(), self.newest_ns)

    def estimate(self, prepared: Prepared) -> list[Record]:
        """Do the rest of `compute`."""
        records = [record for part in prepared.parts for record in self._estimated(part)]
        return records + self._beside(prepared.events, prepared.newest_ns)

    def _prepared(self) -> Iterator[Labelled]:
        """Yield what the quality block makes of the blocks taken, as much at once as goes together."""
        taken, self._taken = self._taken, []
        quality = self.stages.quality
        for anew, realigning, pieces in _alike(taken):
            index, t_ns, v = (np.concatenate(part) for part in zip(*pieces, strict=True))
            if realigning:
                labelled = quality.unpaired(index, t_ns, v)
            else:
                labelled = quality.step(index, t_ns, v, anew=anew)
            self.acquisition.arrived(labelled.values)
            yield labelled

    def _take_events(self) -> list[Record]:
        events, self._source_events = self._source_events, []
        return events

    def _beside(self, events: list[Record], newest_ns: int) -> list[Record]:
        """Return what is found beside the estimates up to a time: of the sources and of the covariates."""
        return events + list[Record](self.covariates.step(newest_ns))

    def foreseen(self, outlooks: Sequence[Outlook]) -> list[Record]:
        """Return alarms that outlooks on parameters lead to; made beside the samples, not of them."""
        return [change for outlook in outlooks for change in self.prognosis_alarms.step(outlook)]

    def finish(self) -> list[Record]:
        """Return what the samples lead to that wait for others that will not come."""
        self._keep(self.acquisition.finish())
        records = self.compute()
        last = self.stages.quality.finish()
        self.acquisition.arrived(last.values)
        records += self._estimated(last)
        return records + self._knowledge() + list[Record](self.covariates.finish())

    def hurry(self) -> None:
        """Begin no fit, search or measurement any more: what waits for one waits forever. From any thread."""
        self.stages.estimation.estimator.hurry()
        self.acquisition.hurry()

    def begin_anew(self, reason: str) -> None:
        """Make the stages anew; what was used or refused stays counted, the rest is refused for a reason."""
        self._taken.clear()
        self.acquisition.lose(reason, self.through())
        self.stages = make_stages(self.config, self._steps)
        self._refer()
        self.sensor_alarms.start_anew()

    def through(self) -> Through:
        """Count the rows that acquisition handed on since the stages began."""
        return self.stages.through()

    def _keep(self, acquired: Acquired) -> None:
        """Let samples wait for `compute`, and what was found of the sources beside them."""
        for aligned in acquired.values:
            t_ns = self._stamps(aligned)
            self.newest_ns = int(t_ns[-1])
            piece = aligned.index, t_ns, np.hstack([aligned.u, aligned.y])
            self._taken.append(Taken(aligned.anew, aligned.realigning, piece))
        rig, t_ns_now = self.config.rig.name, self.newest_ns
        self._source_events += [
            HealthEvent(rig, e.source, t_ns_now, e.cause, e.message) for e in acquired.events
        ]

    def _estimated(self, labelled: Labelled) -> list[Record]:
        """Return the estimates of samples, and the alarms that they and their channels raise."""
        stages = self.stages
        records = list[Record]()
        for samples in labelled.values:
            complete = replace(samples, u=stages.friction.step(samples)) if samples.usable else samples
            if self.watch is not None:
                self.watch(complete)
            records += self._assessed(stages.estimation.step(complete))
        return records + self.sensor_alarms.step(labelled.events)

    def _assessed(self, estimated: Estimated) -> list[Record]:
        """Return a batch of estimates, what was found beside them, and the alarms of all that."""
        parts, said = ([], []) if estimated.batch is None else self.compensation.step(estimated.batch)
        records: list[Record] = [*parts, *said]
        records += self._failures(estimated)
        records += self._conditions(estimated)
        records += self._learnt(estimated)
        records += self._found(estimated)
        for part in parts:
            records += self.rest_alarms.step(part)
            records += self.alarms.step(part)
            records += self.sensor_alarms.confirm(part)
            records += self.blind_alarms.step(part, explained=self.sensor_alarms.any_stand)
        return records

    def _failures(self, estimated: Estimated) -> list[Record]:
        """Return an event for each numerical failure of the method."""
        rig, words = self.config.rig.name, "the estimation failed and starts anew: {}".format
        return [
            HealthEvent(rig, ESTIMATION, estimated.newest_ns, FAILURE, words(w))
            for _, w in estimated.failures
        ]

    def _conditions(self, estimated: Estimated) -> list[Record]:
        """Return what the paper's conditions say of windows, each length as often as estimates are kept."""
        times = estimated.times(sample for sample, _ in estimated.conditions)
        labels = self.stages.estimation.labels
        kept: list[Record] = []
        for sample, found in estimated.conditions:
            if times[sample] >= self._conditions_due.get(found.window, 0):
                self._conditions_due[found.window] = times[sample] + round(self.config.store.every_s * 1e9)
                window_s = found.window / labels.rate_hz
                kept.append(ConditionsRecord(labels.rig, times[sample], window_s, labels.parameters, found))
        return kept

    def _learnt(self, estimated: Estimated) -> list[Record]:
        """Return what windows taught of the rig: verdicts on its constants, and what the next start uses."""
        if not estimated.beliefs:
            return []
        times = estimated.times(sample for sample, _ in estimated.beliefs)
        said = self.stages.constants.step(estimated.beliefs, times)
        self._learnt_ns = estimated.newest_ns
        self._is_kept = False
        # a clock that is set may go back
        is_due = abs(self._learnt_ns - self._kept_ns) >= LEARNT_S * 1e9
        kept = self._knowledge() if is_due else []
        return [*said.values, *self.sensor_alarms.step(said.events), *kept]

    def _knowledge(self) -> list[Record]:
        """Return what is known of the rig, for the next start, where that has changed and is enough."""
        if self._is_kept:
            return []
        content = self.stages.estimation.estimator.knowledge()
        if content is None:
            return []
        self._kept_ns = self._learnt_ns
        self._is_kept = True
        return [LearntRecord(self.config.rig.name, self._learnt_ns, Learnt(self._key, content))]

    def _found(self, estimated: Estimated) -> list[Record]:
        """Return what the method finds wrong with channels."""
        times = estimated.times(finding.sample for finding in estimated.findings)
        said = self.stages.channels.step(estimated.findings, times)
        return [*said.values, *self.sensor_alarms.step(said.events)]

    def _stamps(self, aligned: Aligned) -> IntArray:
        """A recording's own time stamps, or index / rate where it has none."""
        if aligned.stamps is not None:
            return aligned.stamps
        period = np.longdouble(1e9) / np.longdouble(self.config.rig.sample_rate_hz)
        return np.asarray(np.rint(aligned.index * period).astype(np.int64))


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
