"""An agent that is killed when its target has the message and nothing says so yet: DB, and a file for the
keys."""

import os
import signal
import sys
import threading
from pathlib import Path

from agent.config.sections.results import Notify
from agent.notification.message import Message
from tests.notification.targets import agent
from tests.storage.rows import step


def main(path: Path, keys: Path) -> None:
    def deliver(_target: Notify, message: Message, _folder: Path) -> None:
        with keys.open("a", encoding="utf-8") as file:
            file.write(f"{message.key}\n")
        os.kill(os.getpid(), signal.SIGKILL)

    target = Notify(name="shift", kind="command", command=("true",))
    with agent(path, [target], deliver=deliver) as (writer, _):
        writer.publish([step("NORM", "UNACK")])
        threading.Event().wait()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
