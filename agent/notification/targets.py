"""The targets of an agent as the configurations of its rigs name them; they follow one that is exchanged."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from agent.config import RigConfig
from agent.config.sections.results import Notify
from agent.notification.routing import route
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition

if TYPE_CHECKING:
    from agent.notification.notifier import Notifier

_Key = tuple[Path, str]


class Targets:
    """A notifier a database and name of a target: of rigs that share a file, targets of one name are one."""

    def __init__(self) -> None:
        self._configs: tuple[RigConfig, ...] = ()
        self._notifiers: dict[_Key, Notifier] = {}
        self._made_for: dict[_Key, tuple[Notify, Path]] = {}

    def route(self, step: AlarmTransition) -> Sequence[str]:
        """Return the names of the targets that a step is for; from any thread."""
        return route(self._configs, step)

    def exchange(
        self, placed: Mapping[Path, Sequence[RigConfig]], writers: Mapping[Path, StoreWriter]
    ) -> None:
        """Have the targets of these configurations, by their database, notified from now on; others no more.

        Targets that stay as they are go on. The writers are open.
        """
        self._configs = tuple(config for configs in placed.values() for config in configs)
        wanted: dict[_Key, tuple[Notify, Path]] = {}
        for path, configs in placed.items():
            for config in configs:
                for target in config.notify:
                    wanted.setdefault((path, target.name), (target, config.folder))
        for key in [key for key, made in self._made_for.items() if wanted.get(key) != made]:
            self._notifiers.pop(key).stop()
            del self._made_for[key]
        for key in [key for key in wanted if key not in self._made_for]:
            self._begin(key, *wanted[key], writers[key[0]])
        self._made_for = wanted
        for path, writer in writers.items():
            writer.on_outbox = partial(self._wake, path)

    def _begin(self, key: _Key, target: Notify, folder: Path, writer: StoreWriter) -> None:
        from agent.notification.notifier import (
            Notifier,
        )  # with it come mail, HTTP and TLS: 2 MB of a small gateway

        self._notifiers[key] = Notifier(target, folder, writer.ask, partial(self._is_for, target.name))
        self._notifiers[key].start()

    def _is_for(self, target: str, step: AlarmTransition) -> bool:
        return target in self.route(step)

    def _wake(self, path: Path) -> None:
        for (place, _), notifier in list(self._notifiers.items()):
            if place == path:
                notifier.wake()

    def stop(self) -> None:
        """Begin no attempt any more; none under way is waited for."""
        for notifier in self._notifiers.values():
            notifier.stop()
