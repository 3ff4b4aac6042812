"""An agent that is killed when its consumer has some rows and no cursor says so: DB, and a file of their
numbers."""

import os
import signal
import sys
import threading
from pathlib import Path

from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch
from tests.northbound.supply import Archive, supplied
from tests.storage.rows import batch


def main(path: Path, taken: Path) -> None:
    def note(found: Batch) -> None:
        with taken.open("a", encoding="utf-8") as file:
            file.writelines(f"{row['seq']}\n" for row in found.rows)
        if len(taken.read_text(encoding="utf-8").split()) > 100:
            os.kill(os.getpid(), signal.SIGKILL)

    consumer = North(name="plant", kind="mqtt", topics=("estimates",), batch=10)
    with supplied(path, [consumer], Archive(before=note).make) as (writer, _):
        writer.publish([batch(200)])
        threading.Event().wait()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
