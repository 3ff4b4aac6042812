"""The command `sim`; heavy imports wait until it runs."""

import json
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim_bus.tuning import ALONE_S, LINGER_S, LOOK_S

if TYPE_CHECKING:
    from sim_bus.player import Player


def _list_faults(*, as_json: bool) -> None:
    from sim_bus.rig.fault_names import KNOWN

    kinds = {f"{driver}.{name}": kind for driver, faults in KNOWN.items() for name, kind in faults.items()}
    if as_json:
        rows = [
            {"name": n, "words": k.words, "lasts_s": k.lasts_s, "cause": k.cause} for n, k in kinds.items()
        ]
        sys.stdout.write(json.dumps({"faults": rows}) + "\n")
        return
    for name, kind in kinds.items():
        seen = f"; the agent tells: {kind.cause}" if kind.cause else ""
        lasts = f" ({kind.lasts_s:g} s)" if kind.lasts_s else ""
        sys.stdout.write(f"{name}: {kind.words}{lasts}{seen}\n")


def sim(
    config: Annotated[
        Path | None, typer.Argument(help="Configuration whose sources are played.", metavar="CONFIG")
    ] = None,
    scenario: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help="Scenario file, or the name of one that comes along: steady, default, step ...",
        ),
    ] = "steady",
    fault: Annotated[
        list[str] | None,
        typer.Option(help="Fault to cause, NAME@SECONDS, e.g. serial.garbage@10s.", metavar="F@T"),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=1e9, help="Seconds to play, from the first reader on, then end.", metavar="S"
        ),
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Play as fast as the readers read.")] = False,
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write what was played to this NPZ file at the end.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="After `ready`, at the end: the ledger as a line of JSON.")
    ] = False,
    list_faults: Annotated[bool, typer.Option("--list-faults", help="Name every fault, then end.")] = False,
) -> None:
    """Play the devices of CONFIG's sources; prints `ready` when they can be read, ends with SIGTERM."""
    from sim_bus.errors import SimError, SimUsageError

    if list_faults:
        _list_faults(as_json=as_json)
        return
    signals: list[int] = []
    try:
        if config is None:
            raise SimUsageError("sim: missing argument 'CONFIG'; see deltak sim --help")
        player = _make(config, scenario, fault or [], duration, truth, fast=fast)
        ledger = _play(player, duration, signals)
    except SimError as error:
        _report(error.lines, as_json=as_json)
        raise typer.Exit(error.exit_code) from error
    if as_json:
        sys.stdout.write(json.dumps(ledger) + "\n")
    if signal.SIGINT in signals:
        raise typer.Exit(128 + signal.SIGINT)


def _report(lines: Sequence[str], *, as_json: bool) -> None:
    """Say what is wrong on stderr, a line each, and where JSON is asked for there as well."""
    for line in lines:
        sys.stderr.write(f"deltak: error: {line}\n")
    if as_json:
        parted = [(path, *rest.partition("; ")) for path, _, rest in (line.partition(": ") for line in lines)]
        errors = [{"path": path, "message": message, "advice": advice} for path, message, _, advice in parted]
        sys.stdout.write(json.dumps({"errors": errors}) + "\n")


def _make(
    config: Path, scenario: str, faults: list[str], duration: float | None, truth: Path | None, *, fast: bool
) -> "Player":
    from sim_bus.player import Player
    from sim_bus.reach import fitting, must_fit
    from sim_bus.rig.rigfile import read_rig
    from sim_bus.rig.scenario import load_scenario

    rig = read_rig(config)
    if any(source.driver == "can" and source.keys.get("interface") == "virtual" for source in rig.source):
        sys.stderr.write(
            "deltak: note: a virtual bus does not leave its process, and no agent hears it; "
            "take socketcand or a vcan interface to play to one\n"
        )
    played = load_scenario(scenario, known=lambda: fitting(rig)).with_faults(faults, duration)
    must_fit(rig, played, duration)
    return Player(rig, played, duration_s=duration, fast=fast, truth=truth)


def _play(player: "Player", duration: float | None, signals: list[int]) -> dict[str, Any]:
    with _stopped_by_signals(signals) as stop:
        player.start()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        _wait_for_readers(player, stop)
        player.wait(stop, LINGER_S if duration else None)
        return player.finish()


def _wait_for_readers(player: "Player", stop: threading.Event) -> None:
    """Say, where nobody reads, that this is what the clock waits for."""
    begun = time.monotonic()
    while not player.clock.started.is_set() and time.monotonic() < begun + ALONE_S:
        if stop.wait(LOOK_S):
            return
    waiting = player.clock.unmet()
    if waiting:
        sys.stderr.write(
            f"deltak: note: the clock starts when {', '.join(waiting)} is read; nobody reads it yet\n"
        )


@contextmanager
def _stopped_by_signals(signals: list[int]) -> Iterator[threading.Event]:
    """Yield an event that SIGTERM and SIGINT set; those that came are appended to `signals`."""
    stop = threading.Event()

    def note(number: int, _frame: object) -> None:
        signals.append(number)
        # this interrupts the thread that may hold the very lock that setting takes
        threading.Thread(target=stop.set, name="stop", daemon=True).start()

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
