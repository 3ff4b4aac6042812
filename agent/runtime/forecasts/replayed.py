"""Forecasts of a replay: made in the time of its samples, of the rows up to then and none that come later."""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from agent.config import RigConfig
from agent.records import Record
from agent.runtime.forecasts.schedule import ALARM, DUE, Schedule
from agent.types import EstimateBatch

if TYPE_CHECKING:
    from agent.runtime.forecasts.making import Forecaster, Made


class ReplayedForecasts:
    """Follows the records of a replay and makes the forecasts that are due.

    config: the rig's. db: the database of the replay, which is only read. stored: waits until all records so
    far are in it.
    """

    def __init__(self, config: RigConfig, db: Path, stored: Callable[[], object]) -> None:
        self._config, self._db, self._stored = config, db, stored
        self._schedule = Schedule(config.forecast.every)

    @cached_property
    def _forecaster(self) -> "Forecaster":
        from agent.runtime.forecasts.making import Forecaster  # 20 ms, and a short replay makes none

        return Forecaster(self._config, self._db)

    def step(self, records: Sequence[Record]) -> Iterator["Made"]:
        """Yield what is made after records were handed to the store, in order of time."""
        for t_ns, cause, parameters in self._instants(records):
            self._stored()
            yield self._forecaster.make(cause, parameters, t_ns)

    def _instants(self, records: Sequence[Record]) -> list[tuple[int, str, tuple[str, ...]]]:
        found: list[tuple[int, str, tuple[str, ...]]] = []
        found += [(at, ALARM, (parameter,)) for at, parameter in self._schedule.at_alarms(records)]
        for batch in records:
            if isinstance(batch, EstimateBatch) and len(batch):
                passed = [at for end in (0, -1) for at in self._schedule.due(int(batch.t_ns[end]))]
                found += [(at, DUE, tuple(self._config.parameters)) for at in passed]
        return sorted(found)
