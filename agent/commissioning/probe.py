"""`deltak check --probe`: a rig's sources are opened and listened to for some seconds; nothing is stored."""

import threading
from collections.abc import Sequence
from itertools import product

from agent.clock import monotonic_ns
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Gathering
from agent.commissioning.tuning import ABSENT_S, LISTEN_S, PATIENCE_S, TURN_S
from agent.config import RigConfig
from agent.errors import BusError, ConfigError, Fault, UsageError
from agent.runtime.assembly.source_faults import source_faults
from agent.runtime.sources import Connection, Use, connect, part
from drivers.reconnect import LinkEvent

OPEN_ADVICE = "see that it is connected, powered and up, and that no other program holds it"


def listen(config: RigConfig, progress: Progress, listen_s: float = LISTEN_S) -> Gathering:
    """Return what the sources delivered.

    Raises UsageError without sources, ConfigError, BusError with every source that cannot be opened.
    """
    require_sources(config)
    maps = {source.name: source.map for source in config.source}
    gathering = Gathering(config, maps, covariates=config.covariate)
    wake = threading.Event()
    connections = connect([config], wake)
    try:
        for connection in connections:
            connection.start()
        _listen(gathering, connections, wake, progress, listen_s)
    finally:
        for connection in connections:
            connection.stop()
        progress("")
    gathering.finish()
    return gathering


def require_sources(config: RigConfig) -> None:
    """Refuse a rig without sources (UsageError), and keys that drivers cannot work with (ConfigError)."""
    if not config.source:
        raise UsageError.at("source", "there is none to listen to", "name the bus to listen to")
    if faults := source_faults(config):
        raise ConfigError(faults)


def _listen(
    gathering: Gathering,
    connections: Sequence[Connection],
    wake: threading.Event,
    progress: Progress,
    listen_s: float,
) -> None:
    """Hand on what arrives until every source has been heard for listen_s, or one stays away."""
    started = monotonic_ns()
    received = set[str]()
    lost = dict[str, Fault]()
    until = started + round((PATIENCE_S + listen_s) * 1e9)
    complete = False
    while (now := monotonic_ns()) < until:
        progress(f"listening: {(now - started) / 1e9:.0f} s of about {listen_s:.0f} s")
        wake.wait(TURN_S)
        wake.clear()
        _turn(gathering, connections, received, lost)
        # a device may come up while its probe does
        if lost and monotonic_ns() - started > ABSENT_S * 1e9:
            raise BusError(list(lost.values()))
        if not complete and len(received) == len(gathering.counts):
            complete = True
            until = monotonic_ns() + round(listen_s * 1e9)


def _turn(
    gathering: Gathering, connections: Sequence[Connection], received: set[str], lost: dict[str, Fault]
) -> None:
    """Hand on what has arrived, in order; note which sources were heard, and which cannot be opened."""
    taken = [(connection, *connection.take()) for connection in connections]
    for connection in connections:
        gathering.counts |= {use.source: connection.counts for use in connection.uses if use.columns}
    arrived = [(arrival, connection) for connection, arrivals, _ in taken for arrival in arrivals]
    for arrival, connection in sorted(arrived, key=lambda pair: pair[0].block.arrival_ns):
        for use in connection.uses:
            gathering.take_covariates(arrival.block, use.covariates)
            if use.columns:
                received.add(use.source)
                gathering.take(use.source, part(arrival.block, use.columns), arrival.modulus)
    for connection, _, events in taken:
        _note(events, connection.uses, lost)
    for source in received:
        lost.pop(source, None)


def _note(events: Sequence[LinkEvent], uses: Sequence[Use], lost: dict[str, Fault]) -> None:
    """Note which sources cannot be opened; a covariate that cannot be read spoils no channel."""
    for event, use in product(events, uses):
        if event.cause == "lost" and use.columns:
            lost[use.source] = Fault(use.source, event.message, OPEN_ADVICE)
        elif event.cause == "recovered":
            lost.pop(use.source, None)
