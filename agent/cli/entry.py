"""The command line's entry: little is imported before it can be ended well."""

import sys
from typing import NoReturn

from agent.cli.terminal.signals import done_when_terminated, hold_reload_signal, interrupted
from agent.cli.terminal.start import fast_import


def main() -> NoReturn:
    """Run the command line; signals end it well from here on, while the imports are still under way."""
    hold_reload_signal()
    with done_when_terminated():
        try:
            with fast_import():
                from agent.cli.app import main as command_line
        except KeyboardInterrupt:
            sys.exit(interrupted())

        command_line()
