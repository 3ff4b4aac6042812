"""The command `deltak upgrade`: its options made into what checks and switches."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agent.cli.terminal.output import print_faults, print_json
from agent.cli.upgrade import check
from agent.cli.upgrade.agents import Agents, Commands, Units
from agent.cli.upgrade.releases import Releases
from agent.cli.upgrade.switch import Switch, print_switch, upgrade
from agent.errors import Fault, UsageError


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says of a switch."""

    home: Path
    version: str
    within_s: float
    stop: str | None
    start: str | None


def checked(named: Sequence[Path], *, asked: bool, as_json: bool) -> int:
    """Print what this version would do; return the exit code. Raises UsageError where nothing is asked."""
    if not asked:
        raise UsageError.at("upgrade", "asks for nothing", "say --check, or --to VERSION")
    document = check.check(named)
    if as_json:
        print_json(document)
    else:
        check.print_check(document)
    print_faults(Fault(**error) for error in document["errors"])
    return check.exit_code(document)


def switched(named: Sequence[Path], options: Options, *, asked: bool, as_json: bool) -> None:
    """Have another version take over and print what runs now. Raises UsageError and TakenBackError."""
    if asked:
        raise UsageError.at("--check", "cannot go with --to", f"ask that version: {options.version}")
    releases = Releases(options.home)
    releases.command(options.version)
    switch = Switch(releases, _agents(options), releases.current, options.version, options.within_s)
    document = upgrade(switch, named)
    if as_json:
        print_json(document)
    else:
        print_switch(document)


def _agents(options: Options) -> Agents:
    if options.stop is None and options.start is None:
        return Units()
    if options.stop is None or options.start is None:
        raise UsageError.at("--stop", "and --start go together", "name both commands")
    return Commands(shlex.split(options.stop), shlex.split(options.start))
