"""Archives on a Dask cluster: a worker that is killed leaves what replays give (make soak)."""

import os
import signal
import socket
from pathlib import Path

import pytest
from distributed import LocalCluster

from agent.errors import UsageError
from agent.runtime.reestimation.pools import pool_of
from agent.runtime.reestimation.reestimate import Wanted, reestimate
from agent.runtime.replay import replay
from tests.figures import figure
from tests.replay.archives import SECOND, archive, configuration, said


@pytest.mark.soak
def test_two_workers_one_killed_give_what_replays_give_to_the_last_bit(tmp_path: Path) -> None:
    configs = [configuration(tmp_path, f"press-{number}") for number in range(2)]
    for seed, config in enumerate(configs):
        files = archive(tmp_path / "archive" / config.stem, config.stem, 1.0, seed)
        replay(config=config, recordings=files, db=tmp_path / "replayed.db")
    killed: list[int] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:

        def kill_one(_words: str) -> None:
            if not killed:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        address = cluster.scheduler_address.replace("tcp://", "dask://")
        place = str(tmp_path / "again.db")
        wanted = Wanted([tmp_path / "archive"], configs, place, address, hour_ns=SECOND // 4)
        document = reestimate(wanted, kill_one)
    assert killed
    assert document["errors"] == []
    assert document["parts"] >= 8
    assert said(tmp_path / "again.db") == said(tmp_path / "replayed.db")
    figure(f"dask: 1 of 2 workers killed, {document['parts']} parts: all rows equal those of replays")


@pytest.mark.soak
def test_scheduler_that_is_not_there_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.runtime.reestimation.pools.SCHEDULER_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(UsageError, match=f"tcp://127.0.0.1:{port}: no scheduler answers"):
        pool_of(f"dask://127.0.0.1:{port}", None)
