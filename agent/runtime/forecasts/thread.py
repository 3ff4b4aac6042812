"""A thread of its own for forecasts, of low priority: the agent asks, and fetches what was made later.

It reads the databases through connections that can only read, and hands nothing to the store by itself.
Whoever ends the agent need not wait for it: what it is at is thrown away.
"""

import os
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping

from agent.runtime.forecasts.making import Forecaster, Made
from agent.runtime.process.memory import release_free_pages
from agent.runtime.tuning import FORECASTS_WAITING, PRIORITY_STEPS, SETTLE_S


class ForecastThread:
    """Makes what is asked for, one parameter after the other; asking again for what waits changes nothing."""

    def __init__(
        self, forecasters: Mapping[str, Forecaster] | None = None, settle_s: float = SETTLE_S
    ) -> None:
        self._forecasters = dict(forecasters or {})
        self._settle_s = settle_s
        self._condition = threading.Condition()
        self._asked: OrderedDict[tuple[str, str], tuple[str, float]] = OrderedDict()
        self._made: dict[str, list[Made]] = {rig: [] for rig in self._forecasters}
        self._begun = False
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="forecasts", daemon=True)
        self.progress = 0
        """Grows with every forecast; a watchdog may read it."""

    def start(self) -> None:
        """Begin to work, as soon as there is anything to look at."""
        self._begun = True
        if self._forecasters and self._thread.ident is None:
            self._thread.start()

    def admit(self, rig: str, forecaster: Forecaster) -> None:
        """Take up a rig, in the place of one of that name."""
        with self._condition:
            self._forecasters[rig] = forecaster
            self._made[rig] = []
        if self._begun:
            self.start()

    def leave(self, rig: str) -> None:
        """Forget a rig, and what is made of it meanwhile."""
        with self._condition:
            self._forecasters.pop(rig, None)
            self._made.pop(rig, None)
            for asked in [key for key in self._asked if key[0] == rig]:
                del self._asked[asked]

    def ask(self, rig: str, parameter: str, cause: str) -> None:
        """Have a parameter looked at, a moment later; never waits."""
        with self._condition:
            self._asked.setdefault((rig, parameter), (cause, time.monotonic() + self._settle_s))
            self._condition.notify_all()

    def take(self, rig: str) -> list[Made]:
        """Return what was made of a rig since the last call; never waits."""
        if not self._made[rig]:
            return []
        with self._condition:
            made, self._made[rig] = self._made[rig], []
        return made

    def stop(self) -> None:
        """Begin nothing any more; what is being made is not waited for."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()

    def _work(self) -> None:
        _lower_priority()
        while (job := self._next()) is not None:
            rig, parameter, cause = job
            forecaster = self._forecasters.get(rig)
            if forecaster is None:  # the rig left meanwhile
                continue
            made = forecaster.make(cause, (parameter,))
            release_free_pages()
            with self._condition:
                self.progress += 1
                if self._forecasters.get(rig) is forecaster:
                    self._made[rig] = [*self._made[rig], made][-FORECASTS_WAITING:]

    def _next(self) -> tuple[str, str, str] | None:
        """Wait for the next that is due and return its rig, parameter and cause; None at the end."""
        with self._condition:
            while not self._ended:
                wait_s = None
                if self._asked:
                    (rig, parameter), (cause, at) = next(iter(self._asked.items()))
                    wait_s = at - time.monotonic()
                    if wait_s <= 0.0:
                        del self._asked[rig, parameter]
                        return rig, parameter, cause
                self._condition.wait(wait_s)
        return None


def _lower_priority() -> None:
    """Let the other threads go first; on Linux priorities are of threads."""
    try:
        own = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, own, min(19, os.getpriority(os.PRIO_PROCESS, own) + PRIORITY_STEPS))
    except (AttributeError, OSError):
        return  # a system without it: the work is short
