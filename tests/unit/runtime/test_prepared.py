"""A pipeline that prepares a block while the one before is estimated gives what one that steps gives."""

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.records import Health, LearntRecord, Record
from agent.runtime.ledger import Conservation
from agent.runtime.pipeline import Pipeline, Prepared
from agent.runtime.replay import SOURCE, make_pipeline
from agent.types import FloatArray
from drivers.port import Counts, SampleBlock
from tests.bench.scene import PERIOD
from tests.unit.numerics.rigs import noisy

SCENE = Path(__file__).parents[2] / "bench" / "scene.toml"
BLOCK, BLOCKS = 600, 4


@pytest.fixture
def pipelines(tmp_path: Path) -> tuple[Pipeline, Pipeline]:
    config = tmp_path / "rig.toml"
    config.write_text(SCENE.read_text().replace("@NOISE@", "1e-6").replace("@WINDOW@", "0.25"))
    return make_pipeline(load(config)), make_pipeline(load(config))


def readings() -> FloatArray:
    """Readings (n, 3), force first: some are lost, one is a spike, a channel is stuck for a while."""
    v = noisy(np.random.default_rng(3), BLOCK * BLOCKS, 1e-6).v[:, [2, 0, 1]]
    v[900:903, 1] = np.nan
    v[1300, 2] += 0.5
    v[1700:2100, 1] = v[1700, 1]
    return v


def blocks() -> Iterator[SampleBlock]:
    v = readings()
    for part in np.split(np.arange(len(v)), BLOCKS):
        yield SampleBlock(v[part], 0, None, np.rint(part * PERIOD * 1e9).astype(np.int64))


def shown(records: list[Record]) -> list[tuple[object, ...]]:
    """Return records as text: kind, then every field to its last bit."""
    with np.printoptions(threshold=10**6, floatmode="unique"):
        return [(type(one).__name__, *(str(getattr(one, f.name)) for f in fields(one))) for one in records]


def test_pipeline_that_prepares_blocks_ahead_gives_the_records_of_one_that_steps(
    pipelines: tuple[Pipeline, Pipeline],
) -> None:
    stepped, ahead = pipelines
    expected = [record for block in blocks() for record in stepped.step(SOURCE, block, None, None)]
    found: list[Record] = []
    with ThreadPoolExecutor(1) as other:

        def prepared(block: SampleBlock) -> Prepared:
            ahead.take(SOURCE, block, None, None)
            return ahead.prepare()

        coming = iter(blocks())
        waiting = other.submit(prepared, next(coming))
        for block in [*coming, None]:
            piece = waiting.result()
            waiting = other.submit(prepared, block) if block is not None else waiting
            found += ahead.estimate(piece)
    assert len(expected) > BLOCKS
    assert shown(found + ahead.finish()) == shown(expected + stepped.finish())


def test_ledger_counts_prepared_samples_as_waiting(pipelines: tuple[Pipeline, Pipeline]) -> None:
    stepped, ahead = pipelines
    counts = Counts()
    for block in blocks():
        counts.received += len(block)
        stepped.step(SOURCE, block, None, None)
        ahead.take(SOURCE, block, None, None)
        piece = ahead.prepare()
        found = ledger(ahead, counts, piece.waiting)
        assert found.received == found.used + sum(found.rejected.values())
        assert found == ledger(stepped, counts, 0)
        ahead.estimate(piece)


def learnt(pipeline: Pipeline, samples: int) -> list[int]:
    """When what was learnt from so many samples is given, ns."""
    v = noisy(np.random.default_rng(3), samples, 1e-6).v[:, [2, 0, 1]]
    t_ns = np.rint(np.arange(len(v)) * PERIOD * 1e9).astype(np.int64)
    pieces = [slice(start, start + 500) for start in range(0, len(v), 500)]
    steps = [pipeline.step(SOURCE, SampleBlock(v[p], 0, None, t_ns[p]), None, None) for p in pieces]
    return [one.t_ns for records in steps for one in records if isinstance(one, LearntRecord)]


def test_what_was_learnt_is_given_once_a_minute_of_samples(
    pipelines: tuple[Pipeline, Pipeline], monkeypatch: pytest.MonkeyPatch
) -> None:
    seldom, often = pipelines
    kept = learnt(seldom, 130_000)
    assert len(kept) > 1
    assert kept[0] < 2e9
    assert np.diff(kept).min() >= 60e9
    monkeypatch.setattr("agent.runtime.pipeline.LEARNT_S", 0.0)
    assert len(learnt(often, 130_000)) > 5 * len(kept)


def test_what_was_learnt_is_given_at_the_end_if_it_was_not_before(
    pipelines: tuple[Pipeline, Pipeline],
) -> None:
    pipeline, _ = pipelines
    (kept,) = learnt(pipeline, 30_000)
    (end,) = [one.t_ns for one in pipeline.finish() if isinstance(one, LearntRecord)]
    assert end > kept + 10e9
    assert not any(isinstance(one, LearntRecord) for one in pipeline.finish())


def test_what_was_learnt_is_stored_though_the_clock_went_back(
    pipelines: tuple[Pipeline, Pipeline],
) -> None:
    pipeline, _ = pipelines
    v = noisy(np.random.default_rng(3), 6000, 1e-6).v[:, [2, 0, 1]]
    t_ns = np.rint(np.arange(len(v)) * PERIOD * 1e9).astype(np.int64)
    kept = []
    for start in range(0, len(v), 500):
        hours = 2 if start < 3000 else 1
        stamps = t_ns[start : start + 500] + hours * 3600 * 10**9
        block = SampleBlock(v[start : start + 500], 0, None, stamps)
        kept += [one for one in pipeline.step(SOURCE, block, None, None) if isinstance(one, LearntRecord)]
    assert len(kept) == 2
    assert kept[1].t_ns < kept[0].t_ns


def ledger(pipeline: Pipeline, counts: Counts, prepared: int) -> Health:
    conservation = {SOURCE: Conservation(counts, Counter())}
    return pipeline.ledger.health(conservation, pipeline.newest_ns, None, prepared)[0]
