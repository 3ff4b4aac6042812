"""The command `sim`; heavy imports wait until it runs."""

import json
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from sim_bus.player import Player

LINGER_S = 1.0
"""With --duration the devices stay readable this long after the last sample."""


def _list_faults(wanted: bool) -> None:
    if not wanted:
        return
    from sim_bus.fault_names import KNOWN

    for driver, faults in KNOWN.items():
        for name, kind in faults.items():
            seen = f"; the agent tells: {kind.cause}" if kind.cause else ""
            lasts = f" ({kind.lasts_s:g} s)" if kind.lasts_s else ""
            sys.stdout.write(f"{driver}.{name}: {kind.words}{lasts}{seen}\n")
    raise typer.Exit


def sim(
    config: Annotated[Path, typer.Argument(help="Configuration whose sources are played.", metavar="CONFIG")],
    scenario: Annotated[
        str, typer.Option(help="Scenario file, or the name of one that comes along: steady, default, step ...")
    ] = "steady",
    fault: Annotated[
        list[str] | None, typer.Option(help="Fault to cause, NAME@SECONDS, e.g. serial.garbage@10s.", metavar="F@T")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(min=0.0, help="Seconds to play, from the first reader on, then end.", metavar="S"),
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Play as fast as the readers read.")] = False,
    truth: Annotated[Path | None, typer.Option(help="Write what was played to this NPZ file at the end.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the ledger as JSON at the end.")] = False,
    _list: Annotated[
        bool,
        typer.Option("--list-faults", is_eager=True, callback=_list_faults, help="Name every fault, then end."),
    ] = False,
) -> None:
    """Play the devices of CONFIG's sources; prints `ready` when they can be read, ends with SIGTERM."""
    from sim_bus.errors import SimError

    signals: list[int] = []
    try:
        player = _make(config, scenario, fault or [], duration, truth, fast=fast)
        ledger = _play(player, duration, signals)
    except SimError as error:
        for line in error.lines:
            sys.stderr.write(f"deltak: error: {line}\n")
        raise typer.Exit(error.exit_code) from error
    if as_json:
        sys.stdout.write(json.dumps(ledger) + "\n")
    if signal.SIGINT in signals:
        raise typer.Exit(128 + signal.SIGINT)


def _make(
    config: Path, scenario: str, faults: list[str], duration: float | None, truth: Path | None, *, fast: bool
) -> "Player":
    from sim_bus.player import Player
    from sim_bus.reach import fitting, must_fit
    from sim_bus.rigfile import read_rig
    from sim_bus.scenario import load_scenario

    rig = read_rig(config)
    played = load_scenario(scenario, known=lambda: fitting(rig)).with_faults(faults)
    must_fit(rig, played, duration)
    return Player(rig, played, duration_s=duration, fast=fast, truth=truth)


def _play(player: "Player", duration: float | None, signals: list[int]) -> dict[str, Any]:
    with _stopped_by_signals(signals) as stop:
        player.start()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        player.wait(stop, LINGER_S if duration else None)
        return player.finish()


@contextmanager
def _stopped_by_signals(signals: list[int]) -> Iterator[threading.Event]:
    """Yield an event that SIGTERM and SIGINT set; those that came are appended to `signals`."""
    stop = threading.Event()

    def note(number: int, _frame: object) -> None:
        signals.append(number)
        stop.set()

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
