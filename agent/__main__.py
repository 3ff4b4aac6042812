"""python -m agent: the same as the command deltak."""

from typing import NoReturn

from agent.cli.signals import done_when_terminated


def main() -> NoReturn:
    """Run the command line; SIGTERM ends it well from here on, while the imports are still under way."""
    with done_when_terminated():
        from agent.cli.app import main as command_line

        command_line()


if __name__ == "__main__":
    main()
