"""An agent that stores instants up to a number, until its two consumers have all: DB, the rest as JSON."""

import json
import sys
import time
from functools import partial
from pathlib import Path

from agent.config.reading.secrets import Secret
from agent.config.sections.north import North
from agent.northbound.forwarder import Forwarder
from tests.northbound.supply import numbers, supplied
from tests.scenario.live import wait_until
from tests.storage.rows import START, batch, select

AT_ONCE = 20


def main(path: Path, given: dict[str, int]) -> None:
    broker, server, total = given["broker"], given["server"], given["total"]
    word = Secret(file=path.parent / "word")
    consumers = [
        North(name="plant", kind="mqtt", url=f"mqtt://127.0.0.1:{broker}", client_id="press-7",
              topics=("estimates",), timeout_s=1.0),
        North(name="history", kind="postgres", url=f"postgresql://127.0.0.1:{server}/postgres", user="deltak",
              password=word, prefix="soaked", topics=("estimates",), timeout_s=2.0),
    ]  # fmt: skip
    with supplied(path, consumers, keep_s=1.0, late_s=0.5, pause_s=(0.05, 0.5)) as (writer, forwarders):
        stored = select(path, "SELECT count(*), max(t_ns) FROM hops WHERE span = 0")[0]
        first = 0 if stored[1] is None else (stored[1] - START) // 50_000_000 + 1
        for number in range(first, total, AT_ONCE):
            writer.publish([batch(min(AT_ONCE, total - number), first=number)])
            time.sleep(given["pause_ms"] / 1000)  # the pace at which rows come
        writer.flush()
        head = numbers(path)[-1]
        reached = [partial(_has, one, head) for one in forwarders]
        wait_until(lambda: all(has() for has in reached), "every row to arrive", 300)


def _has(forwarder: Forwarder, head: int) -> bool:
    return bool(forwarder.document()["acknowledged"].get("estimates", 0) >= head)


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
