"""python -m agent: the same as the command deltak."""

from agent.cli.entry import main

__all__ = ["main"]

if __name__ == "__main__":
    main()
