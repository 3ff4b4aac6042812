"""One rig while the agent runs: what arrives for it, its pipeline, labels, summary, its sources' alarms."""

import logging
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from agent.alarms.life_cycle import CAUSES
from agent.blocks.advisory.alarm_states import AlarmStates, ReAlarms
from agent.blocks.advisory.blind_alarms import BLIND_KINDS
from agent.blocks.covariates.readings import instants, readings
from agent.blocks.source_events import Signs, SourceEvents
from agent.clock import SampleLabels, monotonic_ns, wall_ns
from agent.config import RigConfig
from agent.recording.events import EventKeeper
from agent.recording.states import frozen
from agent.records import Baseline, ClockRecord, CovariateMean, HealthEvent, Record
from agent.runtime.containment import IsolatedPipeline
from agent.runtime.forecasts.schedule import ALARM, DUE, Schedule
from agent.runtime.forecasts.thread import ForecastThread
from agent.runtime.ledger import Conservation
from agent.runtime.pending import Lateness, Waiting
from agent.runtime.pipeline import Pipeline
from agent.runtime.results import RunSummary
from agent.runtime.sources import Arrival, Connection, Use, part, wire_steps
from agent.runtime.tuning import FIRST_FORECAST_S
from agent.storage.tables.alarms import AlarmRow, alarm_of, detected, kind_of
from agent.types import COMPUTING, WORKER, AlarmTransition, IntArray, Learnt
from drivers.reconnect import LinkEvent

log = logging.getLogger(__name__)


class RigRuntime:
    """One rig while it runs: its pipeline, labels, summary and the alarms of its sources."""

    def __init__(
        self,
        config: RigConfig,
        publish: Callable[[Sequence[Record]], None],
        wall: Callable[[], int] = wall_ns,
        announce: Callable[[AlarmTransition], None] = lambda _: None,
    ) -> None:
        self._announce = announce
        self.config = config
        self._wall = wall
        self._episodes = SourceEvents()
        self.summary = RunSummary(config)
        maps = {source.name: source.map for source in config.source}
        self.pipeline = Pipeline(config, wire_steps(config), maps)
        self.isolated = IsolatedPipeline(self.pipeline)
        self._labels = SampleLabels(config.rig.sample_rate_hz)
        self._steady = SampleLabels(config.rig.sample_rate_hz)
        self._sampled_ns = 0
        self.clock_steps = 0
        """How often the wall clock was stepped while this ran."""
        self._publish = publish
        self.events: EventKeeper | None = None
        self.forecasts: ForecastThread | None = None
        self._due = Schedule(config.forecast.every, FIRST_FORECAST_S)
        self._lost: dict[str, bool] = {}
        self._begun_ns = 0
        self._taken: list[tuple[str, Arrival]] = []
        self.waiting = Waiting()
        self._lateness = Lateness(config.rig.name)
        self.states = AlarmStates()
        self._re_alarms = ReAlarms(config.rig.name, config.alarm)
        self._commanded: deque[AlarmTransition] = deque()

    def restore(
        self,
        standing: Sequence[AlarmRow],
        learnt: Learnt | None = None,
        covariates: Sequence[CovariateMean] = (),
    ) -> None:
        """Go on with the alarms that the run before left standing, and what it knew of rig and covariates."""
        self.pipeline.adopt(learnt, covariates)
        self.states.restore((kind_of(row), row.parameter, alarm_of(row)) for row in standing)
        self.pipeline.alarms.restore(
            {row.parameter: detected(row) for row in standing if row.kind == "level"}
        )
        self.pipeline.prognosis_alarms.restore([replace(row, state=detected(row)) for row in standing])
        self.pipeline.sensor_alarms.restore(
            [row.parameter for row in standing if row.kind == "sensor" and row.cleared_ns is None]
        )
        self.pipeline.blind_alarms.restore(
            (kind, row.parameter, row.priority)
            for row in standing for kind in BLIND_KINDS if row.kind == kind and row.cleared_ns is None
        )  # fmt: skip
        self.pipeline.rest_alarms.restore([row.parameter for row in standing if row.state == "DSUPR"])
        lost = [row.parameter for row in standing if row.kind == "source" and row.cleared_ns is None]
        self.isolated.restore_failure(lost)
        self._lost |= dict.fromkeys(lost, True)
        self._lateness.standing = COMPUTING in lost

    def count_from(self, baselines: tuple[Baseline, ...]) -> None:
        """Count changes from baselines, from the next row on; say which are of another graph and not used."""
        for words in self.pipeline.count_from(baselines):
            message = f"{words}; it is not used: learn it anew"
            log.warning("%s: %s", self.config.rig.name, message)
            self._emit(
                [HealthEvent(self.config.rig.name, "baseline", self._wall(), "baseline unused", message)]
            )

    @property
    def sources(self) -> tuple[str, ...]:
        """The names of its sources."""
        return tuple(source.name for source in (*self.config.source, *self.config.covariate_source))

    def is_lost(self, source: str) -> bool:
        """Tell whether a source delivers nothing at present; from any thread."""
        return self._lost.get(source, False)

    def lag_s(self) -> float | None:
        """Return the age of the newest sample that was taken; None before there is one. From any thread."""
        return (monotonic_ns() - self._sampled_ns) / 1e9 if self._sampled_ns else None

    def clock_offset_s(self) -> float | None:
        """Return how far the newest time stamp is ahead of the wall clock as it is now; from any thread."""
        newest, sampled = self.pipeline.newest_ns, self._sampled_ns
        return (newest - sampled - wall_ns() + monotonic_ns()) / 1e9 if newest and sampled else None

    def hurry(self) -> None:
        """Do nothing but what every row takes from now on; from any thread."""
        self.pipeline.hurry()

    def work(self) -> None:
        """Compute a part of what waits."""
        oldest = self.waiting.oldest_ns
        if oldest is not None:
            now = monotonic_ns()
            self._note_lateness(now - oldest, now)
        for use, what in self.waiting.part():
            if isinstance(what, LinkEvent):
                self.compute()
                self.link(use.source, what)
            else:
                self.take(use, what)
        self.compute()

    def give_up(self) -> None:
        """Drop the samples that wait, and tell the events."""
        for use, event in self.waiting.drop():
            self.link(use.source, event)

    def take(self, use: Use, arrival: Arrival) -> None:
        """Take one block of one of the rig's sources; `compute` makes estimates of it."""
        seen_s = arrival.block.arrival_ns / 1e9
        if self._lost.pop(WORKER, False):
            rig = self.config.rig.name
            words = f"{rig}: samples are computed again"
            self._emit([AlarmTransition.plain(rig, "source", WORKER, self._wall(), words, stands=False)])
        if self._lost.get(use.source):
            self.link(use.source, LinkEvent("recovered", f"{use.source}: delivers samples again", seen_s))
        offset = arrival.block.wall_offset_ns
        offset = wall_ns() - monotonic_ns() if offset is None else offset
        if use.covariates:
            known = replace(arrival.block, wall_offset_ns=offset)
            self.isolated.take_covariates(instants(known, 1.0), readings(known, use.covariates))
        if use.columns:
            self._take_signals(use, arrival, offset)

    def _take_signals(self, use: Use, arrival: Arrival, offset: int) -> None:
        if self.events is not None and not self._taken:
            self.events.begin_round(partial(frozen, self.pipeline))
        block = part(arrival.block, use.columns)
        label = partial(self._label, arrival_ns=block.arrival_ns, offset_ns=offset)
        remembered = label if self.events is None else self.events.labelled(label)
        self.isolated.take(use.source, block, arrival.modulus, remembered)
        if self.events is not None:
            self.events.take(use.source, block, arrival.modulus)
        self._taken.append((use.source, arrival))

    def _label(self, index: IntArray, arrival_ns: int, offset_ns: int) -> IntArray:
        """Return time stamps (n,) of samples, and note when the newest was taken by the monotonic clock."""
        self._sampled_ns = int(self._steady.label(index[-1:], arrival_ns, 0)[-1])
        return self._labels.label(index, arrival_ns, offset_ns)

    def compute(self) -> None:
        """Publish what the blocks taken since the last call lead to."""
        taken, self._taken = self._taken, []
        if taken:
            self._note_steps()
            self._emit(self.isolated.compute())
            for source, arrival in dict(taken).items():  # the newest of each: counts only grow
                self._assess(source, arrival, arrival.block.arrival_ns)

    def finish(self) -> None:
        """Publish what the last samples lead to."""
        self._emit(self.isolated.finish())
        for source, (cause, count) in self._episodes.finish().items():
            self._report(source, cause, count)
        if self.events is not None:
            self.events.finish()

    def commanded(self, step: AlarmTransition) -> None:
        """Note what was done to an alarm; from any thread, taken up with the next records or round."""
        self._commanded.append(step)

    def _take_up(self) -> None:
        while self._commanded:
            step = self._commanded.popleft()
            cause = next((cause for cause in CAUSES if cause == step.cause), None)
            if cause is not None:
                self.states.take_up(step, cause)
            self.summary.take([step])
            self._announce(step)

    def poll(self) -> None:
        """Do what is due even without samples: commands, alarms asking again, the end of an event record."""
        self._take_up()
        again = self._re_alarms.step(self.states.all(), monotonic_ns(), self._wall())
        if again:
            self._emit(again)
        if self.events is not None:
            self.events.poll()
        if self.forecasts is not None:
            self._foresee(self.forecasts)

    def _foresee(self, forecasts: ForecastThread) -> None:
        """Ask for the trends and forecasts that are due, and publish those that were made."""
        if self._due.due(monotonic_ns()):
            for parameter in self.config.parameters:
                forecasts.ask(self.config.rig.name, parameter, DUE)
        for made in forecasts.take(self.config.rig.name):
            self._emit([*made.records, *self.pipeline.foreseen(made.outlooks)])

    def _assess(self, source: str, arrival: Arrival, now_ns: int) -> None:
        """Tell what was counted about a source, once an episode."""
        state = self.pipeline.acquisition.sources[source]
        restarts = state.indexer.restarts
        lost = self.pipeline.ledger.rejected(source, arrival.counts) + arrival.counts.dropped
        if len(self.config.source) > 1:
            del lost["spike"]  # of a channel, which may be another source's
        faults = Counter(arrival.counts.faults)
        restarts += faults.pop("restart", 0)
        due = self._episodes.step(source, Signs(restarts, lost, faults, state.gaps), now_ns)
        if due is not None:
            self._report(source, *due)

    def _report(self, source: str, cause: str, count: int) -> None:
        rig = self.config.rig.name
        words = f"{cause}, counted {count} times" if count > 1 else cause
        log.warning("%s: %s", f"{rig}: {source}", words)
        self._emit([HealthEvent(rig, source, self._wall(), cause, f"{source}: {words}")])

    def _note_lateness(self, waited_ns: int, now_ns: int) -> None:
        reported = self._lateness.step(waited_ns, self._wall(), now_ns)
        for record in reported:
            if isinstance(record, HealthEvent):
                log.warning("%s", record.message)
        self._emit(reported)

    def _note_steps(self) -> None:
        """Publish what time stamps mean from now on, before rows that carry them, and each clock step."""
        rig = self.config.rig.name
        found: list[Record] = [
            ClockRecord(rig, a.label_ns, a.first, a.offset_ns) for a in self._labels.anchors
        ]
        self.clock_steps += len(self._labels.steps)
        for label, step in self._labels.steps:
            words = f"the wall clock was stepped by {step / 1e9:+.3f} s; time stamps start a new anchor"
            log.warning("%s", f"{words}; rows from before are kept as long as if it had not been")
            found.append(HealthEvent(rig, "clock", label, "clock step", words))
        if (
            found
        ):  # event records have nothing to see in them, and would forget what the rows to come refer to
            self._publish(found)
        self._labels.steps.clear()
        self._labels.anchors.clear()
        self._steady.anchors.clear()

    def link(self, source: str, event: LinkEvent) -> None:
        """Raise or clear a source's alarm and note the event."""
        t_ns = self._wall()
        lost = event.away
        back = event.cause == "recovered"
        if back and not self._lost.get(source, False):
            return  # its samples have told already
        self._episodes.reported(source, round(event.at_s * 1e9), away=lost)
        rig = self.config.rig.name
        log.warning("%s: %s", f"{rig}: {source}", event.message.removeprefix(f"{source}: "))
        cause = event.kind or event.cause
        records: list[Record] = [HealthEvent(rig, source, t_ns, cause, event.message)]
        if (lost or back) and lost != self._lost.get(source, False):
            self._lost[source] = lost
            records.append(AlarmTransition.plain(rig, "source", source, t_ns, event.message, stands=lost))
        self._emit(records)

    def ledger(self, connections: Sequence[Connection]) -> None:
        """Publish the conservation ledger of every source, as of the newest sample.

        Before there is one its instant is that of the first ledger, so standstill is one row however long it
        lasts.
        """
        conservation = {
            use.source: Conservation(*self.waiting.counts(use, connection))
            for connection in connections
            for use in connection.uses
            if use.rig == self.config.rig.name
        }
        newest = self.pipeline.newest_ns
        lag = (monotonic_ns() - self._sampled_ns) / 1e9 if newest else None
        if not newest and not self._begun_ns:
            self._begun_ns = self._wall()
        self._emit(self.pipeline.ledger.health(conservation, newest or self._begun_ns, lag))

    def _emit(self, records: Sequence[Record]) -> None:
        self._take_up()
        records = self.states.step(records)
        for record in records:
            if isinstance(record, AlarmTransition):
                self._announce(record)
        if records:
            self.summary.take(records)
            self._publish(records)
        if self.events is not None:
            self.events.see(records)
        if self.forecasts is not None:
            for _, parameter in self._due.at_alarms(records, monotonic_ns()):
                self.forecasts.ask(self.config.rig.name, parameter, ALARM)
