"""Kinds of peers by name; what a kind imports is imported when the first of it is made."""

from collections.abc import Callable
from typing import Final

from agent.config.sections.north import North
from agent.northbound.interface.peer import Peer, Place


def make_peer(consumer: North, place: Place) -> Peer:
    """Return a connection to a consumer that is yet to be opened."""
    return _KINDS[consumer.kind](consumer, place)


def _mqtt(consumer: North, place: Place) -> Peer:
    from agent.northbound.mqtt.json_peer import JsonPeer

    return JsonPeer(consumer, place)


def _postgres(consumer: North, place: Place) -> Peer:
    from agent.northbound.postgres.peer import PostgresPeer

    return PostgresPeer(consumer, place)


def _sparkplug(consumer: North, place: Place) -> Peer:
    from agent.northbound.sparkplug.peer import SparkplugPeer

    return SparkplugPeer(consumer, place)


def _parquet(consumer: North, place: Place) -> Peer:
    from agent.northbound.parquet.peer import ParquetPeer

    return ParquetPeer(consumer, place)


_KINDS: Final[dict[str, Callable[[North, Place], Peer]]] = {
    "mqtt": _mqtt, "parquet": _parquet, "postgres": _postgres, "sparkplug": _sparkplug,
}  # fmt: skip
