"""From exceptions to lines and exit codes: 2 usage, 3 database, 4 bus by type, 1 unforeseen, 130 SIGINT."""

import sys
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import typer

from agent.cli.terminal.logs import set_up_logging
from agent.cli.terminal.output import fault_document, fault_of, print_faults, print_json
from agent.cli.terminal.signals import INTERRUPTED, Terminated, interrupted
from agent.cli.terminal.streams import ReaderGoneError, guarded_streams
from agent.errors import Fault, UsageError

USAGE = 2  # fixed by the command line: exit code of a wrong call


@dataclass(frozen=True, slots=True)
class Flags:
    """What a command line says about itself, wherever in it."""

    verbose: int
    debug: bool
    json: bool


def guarded(app: typer.Typer, argv: Sequence[str]) -> int:
    """Run a command line; return its exit code, with every fault said on stderr."""
    args, flags = take_flags(argv)
    with guarded_streams():
        set_up_logging(flags.verbose, debug=flags.debug)
        code = _code(app, args, flags)
        sys.stderr.flush()
    return code


def _code(app: typer.Typer, args: Sequence[str], flags: Flags) -> int:
    try:
        code = app(args, prog_name="deltak", standalone_mode=False)
        sys.stdout.flush()
    except ReaderGoneError:
        return 0
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted(flags)
    except Terminated:
        _say_ended(flags, "SIGTERM")
        raise
    except Exception as error:  # noqa: BLE001 the one place where all that is unforeseen ends
        return report(error, flags)
    return _interrupted(flags) if code == INTERRUPTED else int(code or 0)


def _interrupted(flags: Flags) -> int:
    _say_ended(flags, "SIGINT")
    return interrupted()


def _say_ended(flags: Flags, signal: str) -> None:
    """Give whoever waits for a JSON document one; not where another was begun."""
    if flags.json and not getattr(sys.stdout, "is_used", True):
        fault = Fault("deltak", f"ended by {signal} before it was done", "run it again for its document")
        with suppress(UsageError, ReaderGoneError):
            print_json({"errors": [fault_document(fault)]})
            sys.stdout.flush()


def take_flags(argv: Sequence[str]) -> tuple[list[str], Flags]:
    """Take -v and --debug out of a command line, anywhere before `--`, and see whether it asks for JSON."""
    end = argv.index("--") if "--" in argv else len(argv)
    head, tail = argv[:end], argv[end:]
    verbose = sum(len(arg) - 1 for arg in head if arg in {"-v", "-vv", "-vvv"}) + head.count("--verbose")
    flags = Flags(verbose, "--debug" in head, "--json" in head)
    kept = [arg for arg in head if arg not in {"-v", "-vv", "-vvv", "--verbose", "--debug"}]
    return [*kept, *tail], flags


def report(error: Exception, flags: Flags) -> int:
    """Print what an exception says and return the exit code that its type carries."""
    if flags.debug:
        traceback.print_exception(error)
    faults, code = faults_of(error)
    with suppress(UsageError, ReaderGoneError):  # stdout is gone; stderr says what was wrong before
        print_faults(faults, as_json=flags.json, causes=getattr(error, "causes", ()))
        sys.stdout.flush()
    return code


def faults_of(error: Exception) -> tuple[Sequence[Fault], int]:
    """Return an exception's faults and exit code; any exception with both attributes may bring its own."""
    if hasattr(error, "faults") and hasattr(error, "exit_code"):
        return error.faults, int(error.exit_code)
    if hasattr(error, "format_message"):
        return [_usage_fault(error)], USAGE
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return [Fault("unforeseen", what, "run it again with --debug and report the traceback")], 1


def report_errors(document: Mapping[str, Any]) -> int:
    """Print the errors of a command's document on stderr and return the exit code."""
    print_faults(fault_of(error) for error in document.get("errors") or [])
    return USAGE


def _usage_fault(error: Any) -> Fault:
    """Return what the option parser found, with the option or the command as its place."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "deltak"
    place = command.removeprefix("deltak").strip() or "command line"
    message = str(error.format_message()).strip().rstrip(".").replace(": Value error, ", ": ")
    if context is not None and message.startswith(f"Usage: {command} "):  # a group alone gives its help
        names = ", ".join(context.command.list_commands(context))
        return Fault(place, "missing command", f"give one of {names}; see {command} --help")
    return Fault(place, message[:1].lower() + message[1:], f"see {command} --help")
