"""python -m agent: the same as the command deltak."""

from agent.runtime.cli import main

if __name__ == "__main__":
    main()
