"""The agent where workers compute: it writes what they find, commands, watches and restarts them."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

from agent.clock import monotonic_ns, wall_ns
from agent.config import RigConfig
from agent.runtime.process.databases import RunKind, path_of
from agent.runtime.process.heartbeats import Thread
from agent.runtime.results import RunSummary
from agent.runtime.service import Reread, Service
from agent.runtime.tuning import END_S, PAUSE_NS, RELOAD_S, SILENCE_S
from agent.runtime.workers.databases import WorkersDatabases
from agent.runtime.workers.losses import Losses
from agent.runtime.workers.orders import BASELINES, COMMANDED, FORGET, PREPARE, TAKE_UP, Order
from agent.runtime.workers.piped import BEGIN, LEFT, RECORDS
from agent.runtime.workers.spread import Places, spread
from agent.runtime.workers.worker import Worker, levels
from agent.types import AlarmTransition

log = logging.getLogger(__name__)


class SpreadService(Service):
    """An agent whose rigs run in workers; databases, sockets, targets and metrics are its own.

    Args:
        configs, db, kind, reread: as of Service.
        most: workers at most.
    """

    def __init__(
        self,
        configs: Sequence[RigConfig],
        db: Path | None,
        kind: RunKind,
        most: int,
        reread: Reread | None = None,
    ) -> None:
        super().__init__([], db, kind, reread)
        self._most = most
        self._places: Places = {}
        self._workers: dict[int, Worker] = {}
        self._due_ns: dict[int, int] = {}
        self._pause_ns: dict[int, int] = {}
        self._losses = Losses()
        self._databases = WorkersDatabases(
            self.rig_set, self._losses, self._commanded, self._reloading.locked, self._stop
        )  # fmt: skip
        self.status.elsewhere = self._rigs
        self.status.workers = lambda: [worker.document() for worker in self._all()]
        self._adopt(configs)

    def _adopt(self, configs: Sequence[RigConfig]) -> None:
        """Have every rig made by its worker. Raises what is wrong with the configurations."""
        self._places = spread(configs, self._most, {})
        try:
            made = [
                self._begin(number, self._own(configs, number))
                for number in sorted(set(self._places.values()))
            ]
            for answer in made:
                answer.result(RELOAD_S)
        except BaseException:
            for worker in self._all():
                worker.kill("the agent does not begin")
            raise
        self._databases.make(configs)

    def _all(self) -> list[Worker]:
        return [self._workers[number] for number in sorted(self._workers)]

    def _rigs(self) -> list[dict[str, Any]]:
        """Return the rigs of all workers as status documents, in the order of the files."""
        found = {rig["rig"]: rig for worker in self._all() for rig in worker.rigs()}
        return [found[name] for name in list(self.rig_set.configs) if name in found]

    def _own(self, configs: Sequence[RigConfig], number: int) -> list[RigConfig]:
        return [config for config in configs if self._places[config.rig.name] == number]

    # --- beginning and ending -------------------------------------------------------------------------------

    def _begin(self, number: int, configs: Sequence[RigConfig]) -> "Future[Any]":
        """Start the process of a worker, which makes its rigs and waits."""
        acts: dict[str, Callable[[Any], Any]] = {
            RECORDS: self._databases.publish, BEGIN: self._databases.begin_runs,
            LEFT: self._databases.end_runs,
        }  # fmt: skip
        worker = self._workers.setdefault(number, Worker(number, acts, self._wake.set))
        watchdog_s = self._watch.manager.watchdog_s
        return worker.start(Order(tuple(configs), self.rig_set.db, self.rig_set.kind, levels(), watchdog_s))

    def _start(self, ended: Callable[[], bool] = lambda: False) -> None:
        super()._start(ended)
        for worker in self._all():
            worker.run()

    def threads(self) -> list[Thread]:
        """Return the threads as they are now, those of workers as they were at their last beat."""
        return super().threads() + [thread for worker in self._all() for thread in worker.threads()]

    def documents(self, seconds: float) -> list[dict[str, Any]]:
        """Return what each rig's run found, after it took so long."""
        found = {s.config.rig.name: s for worker in self._all() for s in worker.summaries or ()}
        return [
            self._document(config, found.get(name), seconds) for name, config in self.rig_set.configs.items()
        ]

    def _document(self, config: RigConfig, summary: RunSummary | None, seconds: float) -> dict[str, Any]:
        """Return the document of one rig; of one whose worker failed at the end it holds nothing."""
        path = path_of(config, self.rig_set.db)
        return (summary or RunSummary(config, db=str(path))).document(seconds)

    def _finish(self) -> None:
        self._databases.ending = True
        until = monotonic_ns() + round(END_S * 1e9)
        for worker in self._all():
            worker.stop()
        waiting = [worker for worker in self._all() if not worker.ended]
        while waiting and monotonic_ns() < until:
            self._wake.wait(min(0.05, max(0.0, (until - monotonic_ns()) / 1e9)))
            self._wake.clear()
            waiting = [worker for worker in waiting if not worker.ended]
        for worker in waiting:
            log.warning("worker %d: does not end in time; what it was at is not stored", worker.number)
            worker.kill("it did not end in time")
        super()._finish()

    # --- what is said to workers ----------------------------------------------------------------------------

    def _commanded(self, step: AlarmTransition) -> None:
        number = self._places.get(step.rig)
        if number is not None:
            self._workers[number].tell(COMMANDED, step)

    def _pass_baselines(self) -> None:
        for path, writer in self.rig_set.stores.items():
            for rig, known in list(writer.baselines.items()):
                if self._databases.baselines.get(rig, ()) != known and rig in self._places:
                    self._databases.baselines[rig] = known
                    self._workers[self._places[rig]].tell(BASELINES, (path, {rig: known}))

    # --- watching workers -----------------------------------------------------------------------------------

    def process(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Look after the workers, once."""
        super().process(ended)
        if self._reloading.acquire(blocking=False):
            try:
                self._pass_baselines()
                for number in list(self._workers):
                    self._look_after(number)
            finally:
                self._reloading.release()

    def _look_after(self, number: int) -> None:
        worker = self._workers[number]
        if not worker.ended:
            self._end_stalled(worker)
        elif number not in self._due_ns:
            self._note_end(worker)
        elif monotonic_ns() >= self._due_ns[number]:
            del self._due_ns[number]
            worker.restarts += 1
            made = self._begin(number, list(worker.configs.values()))
            made.add_done_callback(partial(self._made, worker))

    def _end_stalled(self, worker: Worker) -> None:
        beats = {} if self.status.heartbeats is None else self.status.heartbeats.beats
        stalled = [name for name in worker.is_among(beats) if beats[name].stalled]
        is_late = monotonic_ns() - worker.began_ns > SILENCE_S * 1e9
        if worker.silent_since_start and is_late:
            stalled.append("its start")
        if stalled and not worker.why:
            worker.kill(f"{', '.join(stalled)} made no progress")

    def _note_end(self, worker: Worker) -> None:
        """Say what became of a worker, and when another takes its place."""
        words = worker.ending()
        log.error("%s; %s begin anew", words, ", ".join(worker.configs))
        for name in worker.configs:
            self.rig_set.writer_of(name).publish(self._losses.ended(name, wall_ns(), words))
        lived_ns = monotonic_ns() - worker.began_ns
        before = self._pause_ns.get(worker.number, 0)
        pause_ns = 0 if lived_ns > PAUSE_NS[1] or not worker.restarts else max(PAUSE_NS[0], 2 * before)
        self._pause_ns[worker.number] = min(pause_ns, PAUSE_NS[1])
        self._due_ns[worker.number] = monotonic_ns() + self._pause_ns[worker.number]

    def _made(self, worker: Worker, made: "Future[Any]") -> None:
        if made.exception() is None:
            worker.run()
        else:
            worker.kill(f"its rigs cannot be made ({made.exception()})")

    # --- reloading ------------------------------------------------------------------------------------------

    def _reloaded(self, configs: Sequence[RigConfig]) -> dict[str, Any]:
        before = dict(self.rig_set.configs)
        self._databases.coming = tuple(configs)
        places = spread(configs, self._most, self._places)
        try:
            entered = self._exchange_over(configs, places, {name: self._places[name] for name in before})
        finally:
            self._databases.coming = ()
            self._databases.close_without_rigs()
        names = [config.rig.name for config in configs]
        return {
            "restarted": [name for name in before if name in entered],
            "added": sorted(entered - set(before)),
            "removed": [name for name in before if name not in names],
            "untouched": [name for name in names if name not in entered],
        }

    def _exchange_over(self, configs: Sequence[RigConfig], places: Places, before: Places) -> set[str]:
        """Exchange rigs over all workers; return those that begin. Nothing changes if anything is refused."""
        staying = {number: [c for c in configs if places[c.rig.name] == number
                            and before.get(c.rig.name, number) == number]
                   for number in sorted({*before.values(), *places.values()})}  # fmt: skip
        entered = self._first_step(staying)
        self._places = places
        self.rig_set.configs = {config.rig.name: config for config in configs}
        for number, stay in staying.items():
            whole = self._own(configs, number)
            if len(whole) > len(stay):  # rigs that left another worker a moment ago
                entered |= self._taken_up(number, whole)
            if not whole:
                self._workers.pop(number).stop()
        self.rig_set.begin([])
        self._exporters.exchange(configs)
        return entered

    def _first_step(self, wanted: dict[int, list[RigConfig]]) -> set[str]:
        """Let all workers exchange their rigs but for those that move; they do so together or not at all."""
        running = [number for number in wanted if number in self._workers
                   and list(self._workers[number].configs.values()) != wanted[number]]  # fmt: skip
        fresh = [number for number in wanted if number not in self._workers and wanted[number]]
        try:
            answers = [self._workers[number].ask(PREPARE, wanted[number]) for number in running]
            answers += [self._begin(number, wanted[number]) for number in fresh]
            for answer in answers:
                answer.result(RELOAD_S)
        except BaseException:
            for number in running:
                self._workers[number].tell(FORGET)
            for number in fresh:
                self._workers.pop(number).kill("what it was to run is refused")
            raise
        return {name for number in running for name in self._given(number, wanted[number])} | {
            name for number in fresh for name in self._run_new(number)
        }

    def _run_new(self, number: int) -> list[str]:
        worker = self._workers[number]
        worker.run()
        for name in worker.configs:
            words = f"the configuration was reloaded: {name} begins"
            log.warning("%s", words)
        return list(worker.configs)

    def _taken_up(self, number: int, configs: list[RigConfig]) -> set[str]:
        """Have one worker run these configurations; returns the rigs that begin."""
        if number not in self._workers:
            self._begin(number, configs).result(RELOAD_S)
            return set(self._run_new(number))
        self._workers[number].ask(PREPARE, configs).result(RELOAD_S)
        return self._given(number, configs)

    def _given(self, number: int, configs: list[RigConfig]) -> set[str]:
        """Have a worker take up what it prepared; returns the rigs that begin."""
        found = self._workers[number].ask(TAKE_UP).result(RELOAD_S)
        self._workers[number].configs = {config.rig.name: config for config in configs}
        began = {*found["restarted"], *found["added"]}
        for name in began:
            self._losses.forget(name)
        return began
