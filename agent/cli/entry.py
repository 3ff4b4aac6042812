"""The command line's entry: little is imported before it can be ended well."""

from typing import NoReturn

from agent.cli.terminal.signals import done_when_terminated
from agent.cli.terminal.start import fast_import


def main() -> NoReturn:
    """Run the command line; SIGTERM ends it well from here on, while the imports are still under way."""
    with done_when_terminated():
        with fast_import():
            from agent.cli.app import main as command_line

        command_line()
