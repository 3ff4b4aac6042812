"""The consumers of an agent as the configurations of its rigs name them; they follow one that is replaced."""

import logging
import sqlite3
import threading
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from agent.clock import wall_ns
from agent.config import RigConfig
from agent.config.sections.north import North
from agent.errors import AgentError
from agent.northbound.forwarder import Forwarder
from agent.northbound.interface.peer import Place
from agent.northbound.kinds import make_peer
from agent.records import HealthEvent
from agent.storage.read.forward import all_reached
from agent.storage.write.consumers.cursors import forget_others
from agent.storage.write.writer import StoreWriter

_Key = tuple[Path, str]
log = logging.getLogger(__name__)


class _Wanted(NamedTuple):
    """A consumer, where its configuration's paths start, and the rigs that name it."""

    consumer: North
    folder: Path
    rigs: tuple[str, ...]


class Forwarding:
    """A forwarder a database and consumer name: of rigs that share a file, consumers of one name are one."""

    def __init__(self) -> None:
        self._forwarders: dict[_Key, Forwarder] = {}
        self._made_for: dict[_Key, _Wanted] = {}

    @property
    def forwarders(self) -> list[Forwarder]:
        """Those that there are now; from any thread."""
        return list(self._forwarders.values())

    def documents(self) -> list[dict[str, Any]]:
        """Return what `deltak status` shows of each; from any thread."""
        forwarders = self.forwarders
        known = {path: _reached(path) for path in {forwarder.db for forwarder in forwarders}}
        return [forwarder.document(known[forwarder.db]) for forwarder in forwarders]

    def exchange(
        self, placed: Mapping[Path, Sequence[RigConfig]], writers: Mapping[Path, StoreWriter]
    ) -> None:
        """Have the consumers of these configurations, by database, supplied from now on; others no more.

        Consumers that stay as they are go on. The writers are open.
        """
        wanted = _wanted(placed)
        leaving = [key for key, made in self._made_for.items() if wanted.get(key) != made]
        ended = {key: self._end(key, forget=key not in wanted) for key in leaving}
        for path, writer in writers.items():
            names = [name for place, name in wanted if place == path]
            rigs = [config.rig.name for config in placed.get(path, ())]
            threading.Thread(
                target=_forget, args=(writer, rigs, names), name="north cursors", daemon=True
            ).start()
            writer.on_stored = partial(self._wake, path)
        for key, one in wanted.items():
            if key not in self._made_for:
                self._begin(key, one, writers[key[0]], ended.get(key))
        self._made_for = wanted

    def _begin(self, key: _Key, wanted: _Wanted, writer: StoreWriter, before: Forwarder | None) -> None:
        place = Place(key[0], wanted.folder, wanted.rigs)
        self._forwarders[key] = Forwarder(wanted.consumer, place, make_peer, writer.ask, writer.publish)
        self._forwarders[key].start(before)

    def _end(self, key: _Key, *, forget: bool) -> Forwarder:
        forwarder = self._forwarders.pop(key)
        del self._made_for[key]
        forwarder.stop(forget=forget)
        return forwarder

    def _wake(self, path: Path) -> None:
        for (place, _), forwarder in list(self._forwarders.items()):
            if place == path:
                forwarder.wake()

    def stop(self) -> None:
        """Begin no attempt any more; none under way is waited for."""
        for forwarder in self.forwarders:
            forwarder.stop()


def _reached(path: Path) -> dict[str, int] | None:
    """Return how far a database's topics are; None while that cannot be read."""
    try:
        return all_reached(path)
    except (AgentError, OSError):
        return None


def _wanted(placed: Mapping[Path, Sequence[RigConfig]]) -> dict[_Key, _Wanted]:
    found: dict[_Key, _Wanted] = {}
    for path, configs in placed.items():
        for config in configs:
            for consumer in config.north:
                before = found.get((path, consumer.name), _Wanted(consumer, config.folder, ()))
                found[path, consumer.name] = before._replace(rigs=(*before.rigs, config.rig.name))
    return found


def _forget(writer: StoreWriter, rigs: Collection[str], names: Collection[str]) -> None:
    """Drop the cursors of consumers that no configuration names: rows would be kept for them for ever."""
    try:
        gone = writer.ask(partial(forget_others, names=names))
    except (AgentError, sqlite3.Error, OSError) as error:
        log.info("cursors of former consumers cannot be dropped now: %s", error)
        return
    for name in gone:
        words = f"{name}: no configuration names it any more; rows that it lacks are not kept for it"
        log.warning("%s", words)
        writer.publish([HealthEvent(rig, name, wall_ns(), "consumer removed", words) for rig in rigs])
