"""Which worker runs which rig, what passes between processes, and what the end of one cost."""

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.config import RigConfig, load, load_many
from agent.errors import AgentError, ConfigError, Fault
from agent.records import HealthEvent
from agent.runtime.process.databases import density_of
from agent.runtime.service import Service
from agent.runtime.workers.link import Link, Tell
from agent.runtime.workers.losses import Losses
from agent.runtime.workers.piped import RECORDS, PipedWriter
from agent.runtime.workers.spread import spread, wanted_workers
from agent.types import EstimateBatch
from tests.scenario.live import example
from tests.storage.rows import batch

SECOND = 1_000_000_000


@pytest.fixture
def rig(tmp_path: Path) -> Callable[..., RigConfig]:
    """Makes the configuration of a rig at a port, beside others in a folder."""
    text = example("modbus", tmp_path).read_text()

    def made(name: str, port: int, extra: str = "", rate_hz: float = 1000.0) -> RigConfig:
        named = text.replace('"two-mass-rig"', f'"{name}"').replace('"two-mass-rig.db"', f'"{name}.db"')
        lines = [f"port = {port}" if line.startswith("port = ") else line for line in named.splitlines()]
        file = tmp_path / f"{name}.toml"
        file.write_text("\n".join(lines).replace("1000.0", str(rate_hz)) + f"\n{extra}\n", encoding="utf-8")
        return load(file)

    return made


def test_rigs_that_share_a_source_share_a_worker_and_the_load_is_even(rig: Callable[..., RigConfig]) -> None:
    configs = [rig("a", 1), rig("b", 2), rig("c", 1), rig("d", 3)]
    places = spread(configs, 2, {})
    assert places["a"] == places["c"] != places["b"] == places["d"]


def test_rigs_stay_where_they_are_and_one_that_joins_a_source_moves(rig: Callable[..., RigConfig]) -> None:
    before = {"a": 2, "b": 1, "gone": 1}
    assert spread([rig("a", 1), rig("b", 2), rig("new", 3)], 2, before) == {"a": 2, "b": 1, "new": 1}
    assert spread([rig("a", 1), rig("b", 1), rig("c", 1)], 2, before | {"c": 2}) == {"a": 2, "b": 2, "c": 2}


@pytest.mark.parametrize(("asked", "most"), [("workers = 0", 0), ("workers = 1", 1), ("workers = 9", 2)])
def test_as_many_workers_as_asked_for_and_no_more_than_can_be_used(
    rig: Callable[..., RigConfig], asked: str, most: int
) -> None:
    configs = [rig("a", 1, f"[agent]\n{asked}"), rig("b", 2), rig("c", 2)]
    assert wanted_workers(configs) == most


def test_one_worker_a_core_where_nothing_is_asked_for(
    rig: Callable[..., RigConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2})
    assert wanted_workers([rig(name, port) for port, name in enumerate("abcd", 1)]) == 3
    assert wanted_workers([rig("a", 1)]) == 1


def test_files_that_disagree_on_the_agent_are_refused(rig: Callable[..., RigConfig]) -> None:
    files = [rig("a", 1, "[agent]\nworkers = 2").file, rig("b", 2, "[agent]\nworkers = 3").file]
    with pytest.raises(
        ConfigError, match=r"b.toml: agent.workers: is 3, but 2 in .*a.toml; make them the same"
    ):
        load_many(files)


def linked(
    hears: dict[str, Callable[[Any], object]], answers: dict[str, Callable[[Any], Any]]
) -> tuple[Link, Link, threading.Event]:
    """Return two ends of a link; the second hears and answers, and the event says that it is alone."""
    here, there = Pipe()
    alone = threading.Event()
    ends = Link(here, "here", {}, {}, lambda: None), Link(there, "there", hears, answers, alone.set)
    for end in ends:
        end.start()
    return *ends, alone


def test_what_is_said_arrives_in_order_and_what_is_asked_for_is_answered_beside_it() -> None:
    heard: list[int] = []
    here, there, alone = linked({"number": heard.append}, {"sum": lambda _: sum(heard)})
    for number in range(100):
        here.tell("number", number)
    assert here.ask("sum").result(5.0) == sum(range(100))
    assert heard == list(range(100))
    here.close()
    assert alone.wait(5.0)
    assert there.ended


def test_refusal_passes_with_all_its_faults_and_one_that_cannot_in_words() -> None:
    faults = [Fault("a", "is wrong", "mend it"), Fault("b", "too")]

    def refuse(_: Any) -> None:
        raise ConfigError(faults)

    def fail(_: Any) -> None:
        raise ValueError("planted", threading.Lock())

    here, _, _ = linked({}, {"refuse": refuse, "fail": fail})
    with pytest.raises(ConfigError) as refusal:
        here.ask("refuse").result(5.0)
    assert refusal.value.faults == tuple(faults)
    with pytest.raises(RuntimeError, match=r"ValueError: .*planted"):
        here.ask("fail").result(5.0)


def test_what_was_asked_of_one_who_is_gone_fails() -> None:
    never = threading.Event()
    here, there, _ = linked({}, {"wait": lambda _: never.wait(5.0)})
    answer = here.ask("wait")
    there.close()
    with pytest.raises(AgentError, match="the process ended"):
        answer.result(5.0)
    with pytest.raises(AgentError, match="the process ended"):
        here.ask("wait").result(5.0)
    never.set()


class Busy:
    """A link to an agent that takes nothing for now."""

    ended = False

    def __init__(self) -> None:
        self.makers: list[Callable[[], Tell]] = []

    def post(self, make: Callable[[], Tell]) -> None:
        self.makers.append(make)


def test_rows_for_an_agent_that_takes_none_are_bounded_and_counted(tmp_path: Path) -> None:
    link = Busy()
    writer = PipedWriter(link, tmp_path / "x.db", ())  # type: ignore[arg-type] - of a link it needs `post` alone
    rows = batch(1000)
    cells = 1000 * len(rows.parameters)
    for _ in range(300_000 // cells):
        writer.publish([rows])
    (make,) = link.makers
    taken = make()
    assert taken.what == RECORDS
    kept = sum(len(one) * len(one.parameters) for one in taken.given.records)
    assert kept <= 200_000
    assert kept + taken.given.dropped["agent busy"] == 300_000 // cells * cells


def rows_from(config: RigConfig, first_ns: int, count: int) -> EstimateBatch:
    hop_ns = round(config.estimator.hop_s * 1e9)
    found = batch(count, rig=config.rig.name)
    return replace(found, t_ns=first_ns + hop_ns * np.arange(1, count + 1))


def test_samples_between_the_last_row_and_the_first_sample_after_it_are_lost(
    rig: Callable[..., RigConfig],
) -> None:
    config, losses = rig("a", 1), Losses()
    see = partial(losses.see, config)
    assert see(rows_from(config, 0, 20)) == []
    event, alarm = losses.ended("a", 2 * SECOND, "worker 1 was ended by signal 9")
    assert isinstance(event, HealthEvent)
    assert (event.source, event.cause) == ("worker", "ended")
    assert not isinstance(alarm, HealthEvent)
    last_ns = 20 * round(config.estimator.hop_s * 1e9)
    (lost,) = see(rows_from(config, last_ns + 3 * SECOND, 20))
    assert isinstance(lost, HealthEvent)
    assert "a: 3000 samples, 3.000 s, were lost" in lost.message
    assert see(rows_from(config, last_ns + 9 * SECOND, 20)) == []


def test_how_soon_rows_are_stored_is_as_the_file_says(rig: Callable[..., RigConfig], tmp_path: Path) -> None:
    prompt = rig("a", 1, "commit_s = 0.02\n[agent]\nround_s = 0.01")
    service = Service([prompt], tmp_path / "x.db", "live")
    (writer,) = service.rig_set.stores.values()
    assert (writer._period, service._round_s) == (0.02, 0.01)
    assert density_of([prompt, rig("b", 2)]).commit_s == 0.02
