"""Spikes in the measured force are refused and counted where the motion knows nothing of them; true blows are
not."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest

from agent.blocks.estimation import Estimation
from agent.runtime.ledger import Conservation
from agent.runtime.pipeline import Pipeline
from agent.runtime.replay import SOURCE, make_pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status
from drivers.port import Counts, SampleBlock
from tests.statistical.machine import NOMINAL, Machine, configuration, each, fresh, on_second, say
from tests.statistical.operation import NOISE_M, drive
from tests.statistical.sensor_faults import healthy

SAMPLES, WARM = 9000, 2000
SPIKE_N = 40.0
"""Twenty times the rms of the force."""


def places(rng: np.random.Generator) -> list[tuple[int, int]]:
    """(first sample, length) of a spike about every 0.9 s."""
    starts = np.arange(3000, SAMPLES - 500, 900)
    return [(int(start + rng.integers(0, 300)), int(rng.integers(1, 4))) for start in starts]


def spiked(seed: int) -> tuple[FloatArray, int]:
    """Readings with spikes of either sign, one to three samples long, and how many samples they spoil."""
    rng = np.random.default_rng([seed, 77])
    v, spoilt = healthy(rng, SAMPLES), places(rng)
    for start, length in spoilt:
        v[start : start + length, 0] += SPIKE_N * rng.choice([-1.0, 1.0])
    return v, sum(length for _, length in spoilt)


def struck(seed: int) -> FloatArray:
    """Readings of a rig that a hammer strikes as often and as hard; the force is what the sensor says."""
    rng = np.random.default_rng([seed, 78])
    force = drive(rng, SAMPLES + 1)
    for start, length in places(rng):
        force[start : start + length] += SPIKE_N * rng.choice([-1.0, 1.0])
    y = Machine.at_rest().play(on_second(force))[:, :2]
    return np.column_stack([force[:-1], y + NOISE_M * rng.standard_normal(y.shape)])


def run(
    v: FloatArray, cuts: Sequence[int] = ()
) -> tuple[Pipeline, list[EstimateBatch], list[AlarmTransition]]:
    pipe = fresh("force spikes", lambda: make_pipeline(configuration(NOISE_M)))
    index = np.arange(len(v), dtype=np.int64)
    found = []
    for part in np.split(index, cuts):
        found += pipe.step(SOURCE, SampleBlock(v[part], 0, None, part * 1_000_000), None, None)
    found += pipe.finish()
    batches = [record for record in found if isinstance(record, EstimateBatch)]
    return pipe, batches, [record for record in found if isinstance(record, AlarmTransition)]


def joined(batches: list[EstimateBatch], part: str) -> FloatArray:
    return np.concatenate([getattr(batch, part) for batch in batches])


def assessed(seed: int) -> tuple[int, int, float, float, int]:
    """Samples spoilt and refused, shares of valid and covering estimates, alarms."""
    v, spoilt = spiked(seed)
    pipe, batches, alarms = run(v)
    counts = Counts()
    counts.received = len(v)
    (ledger,) = pipe.ledger.health({SOURCE: Conservation(counts, counts.rejected.copy())}, 0, None)
    assert ledger.received == ledger.used + sum(ledger.rejected.values())
    late = joined(batches, "index") >= WARM
    valid = joined(batches, "status")[late] == Status.VALID
    inside = (joined(batches, "lower")[late] <= NOMINAL) & (joined(batches, "upper")[late] >= NOMINAL)
    return (
        spoilt,
        ledger.rejected.get("spike", 0),
        float(valid.mean()),
        float(inside[valid].mean()),
        len(alarms),
    )


def measured(runs: range, request: pytest.FixtureRequest) -> None:
    spoilt, refused, valid, inside, alarms = np.array(each(assessed, runs)).T
    say(
        request,
        f"spikes of {SPIKE_N:g} N in the force, {len(runs)} runs: "
        f"{refused.sum():.0f} of {spoilt.sum():.0f} refused, {100 * valid.mean():.1f} % valid, "
        f"of which {100 * inside.mean():.1f} % cover, {alarms.sum():.0f} alarms",
    )
    # one that did not matter to the estimates is none of the estimator's business
    assert 0.8 * spoilt.sum() <= refused.sum() <= spoilt.sum()
    assert valid.mean() >= 0.97
    assert inside.mean() >= 0.90
    assert not alarms.any()


def test_spikes_in_the_force_are_refused_and_counted(request: pytest.FixtureRequest) -> None:
    measured(range(2), request)


@pytest.mark.soak
def test_spikes_in_the_force_are_refused_and_counted_in_200_runs(request: pytest.FixtureRequest) -> None:
    measured(range(10_000, 10_200), request)


def test_blows_that_moved_the_rig_are_no_spikes() -> None:
    pipe, batches, alarms = run(struck(1))
    block: Estimation = pipe.stages.estimation
    assert block.estimator.spikes == 0
    late = joined(batches, "index") >= WARM
    assert (joined(batches, "status")[late] == Status.VALID).mean() >= 0.97
    assert not alarms


def test_spikes_in_the_force_give_the_same_rows_however_the_stream_is_cut() -> None:
    v, _ = spiked(0)
    whole, parts = run(v), run(v, sorted(np.random.default_rng(1).integers(0, SAMPLES, 40).tolist()))
    assert whole[0].stages.estimation.estimator.spikes == parts[0].stages.estimation.estimator.spikes > 0
    for part in ("index", "status", "reason"):
        np.testing.assert_array_equal(joined(whole[1], part), joined(parts[1], part))
    for part in ("value", "sd"):
        np.testing.assert_allclose(joined(whole[1], part), joined(parts[1], part), rtol=1e-12)


@pytest.mark.parametrize(("size", "length"), [(2e6, 1), (1e12, 1), (9e29, 3)])
def test_one_wild_reading_of_the_force_is_refused_as_a_spike_and_costs_no_estimate(
    size: float, length: int
) -> None:
    v = healthy(np.random.default_rng([3, 77]), 4000)
    v[2500 : 2500 + length, 0] = size
    pipe, batches, alarms = run(v)
    (ledger,) = pipe.ledger.health({SOURCE: Conservation(Counts(received=len(v)), Counter())}, 0, None)
    assert ledger.rejected == {"spike": length}
    assert ledger.received == ledger.used + length
    late = joined(batches, "index") >= 2500
    status = joined(batches, "status")[late]
    assert not (status == Status.INVALID).any()
    # a sharpness that is near what is asked for may be missed by chance, spike or none
    assert (status == Status.VALID).mean() >= 0.95
    assert not alarms


def test_a_run_of_wild_readings_of_the_force_ends_nothing_and_is_in_no_valid_row() -> None:
    v = healthy(np.random.default_rng([3, 77]), 6500)
    v[5000:5006, 0] = 9e29
    _, batches, alarms = run(v)
    index, status = joined(batches, "index"), joined(batches, "status")
    assert not (status[(index >= 5000) & (index < 5250)] == Status.VALID).any()
    assert not alarms
