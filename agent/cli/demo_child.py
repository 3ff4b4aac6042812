"""A command of deltak as a child of the demo: it ends when its parent does, even where that is killed.

`python -m agent.cli.demo_child PARENT ARGUMENT...`
"""

import sys
from typing import NoReturn

from agent.cli.entry import main
from agent.runtime.process.parent import end_with_parent


def run() -> NoReturn:
    """Run the command line that follows the parent's number."""
    end_with_parent(int(sys.argv[1]))
    del sys.argv[1]
    main()


if __name__ == "__main__":
    run()
