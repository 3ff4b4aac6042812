"""The small parts of the sliding estimator: budget, record of samples, memory of what was learnt."""

import json
from base64 import b64decode
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.numerics.estimator.memory import from_text, to_text
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.schedule import budget_of, samples_an_evaluation
from agent.numerics.estimator.tuning import BURST, EVALUATIONS_A_WINDOW, FIRST, SPARE
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.posterior import Knowledge
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

PERIOD_S = 1e-3


@pytest.mark.parametrize("solve", [3, 150])
def test_budget_gives_a_burst_then_so_many_evaluations_a_window_whatever_a_solve_takes(solve: int) -> None:
    budget, window, many = budget_of(8000, PERIOD_S), 8000, 1000
    spent = 0
    for index in range(0, many * window, 100):
        if budget.allows(index):
            budget.spend(solve * samples_an_evaluation(window, PERIOD_S))
            spent += solve
    # what is there once beyond the capital does not grow meanwhile
    assert BURST + EVALUATIONS_A_WINDOW * many <= spent <= BURST + FIRST + EVALUATIONS_A_WINDOW * many + solve


def test_budget_is_the_same_however_often_it_is_asked() -> None:
    rare, often = budget_of(8000, PERIOD_S), budget_of(8000, PERIOD_S)
    for budget in (rare, often):
        budget.spend((2 * BURST + FIRST) * samples_an_evaluation(8000, PERIOD_S))
    paid = BURST * 1000
    for index in range(0, paid + 2, 100):
        assert not often.allows(index)
    assert rare.allows(paid + 1)
    assert often.allows(paid + 1)


def test_record_keeps_what_is_asked_for_and_counts_what_was_lost() -> None:
    rng = np.random.default_rng(1)
    v = rng.standard_normal((30_000, 3))
    lost = np.zeros(v.shape, dtype=bool)
    lost[[5, 25_000], 1] = True
    kept = Record(7, 2, 1)
    for start in range(0, len(v), 1000):
        part = slice(start, start + 1000)
        kept.append(v[part, :2], v[part, 2:], lost[part])
        kept.trim(2000)
    assert kept.stop == 7 + len(v)
    assert kept.stop - kept.first <= 2 * (2000 + SPARE)
    assert kept.outputs(29_000, 29_100) == pytest.approx(v[28_993:29_093, :2])
    assert kept.lost_in(np.array([25_006, 25_007, 27_006, 27_007]), 2000).tolist() == [0, 1, 1, 0]
    window = kept.window(25_500, 1000)
    assert window.lost.tolist() == [[25_007 - 24_501, 1]]
    assert window.slope[0] == pytest.approx(v[24_494, 2:] - v[24_493, 2:])
    beside = kept.samples_with_slopes(29_000, 29_002)
    assert beside[:, :3] == pytest.approx(v[28_993:28_995])
    assert beside[:, 3] == pytest.approx(np.diff(v[28_992:28_995, 2]))


def test_sample_of_a_record_is_lost_until_its_last_lost_reading_is_restored() -> None:
    kept = Record(3, 2, 1)
    lost = np.zeros((10, 3), dtype=bool)
    lost[4, 1:] = lost[6, 0] = True
    kept.append(np.zeros((10, 2)), np.zeros((10, 1)), lost)
    ends = np.arange(5, 13)
    for channel, counts in ((2, [0, 0, 1, 1, 2, 1, 1, 0]), (1, [0, 0, 0, 0, 1, 1, 1, 0])):
        kept.restore(7, [(0, channel, 1.0)], channel, 0.5)
        assert kept.lost_in(ends, 3).tolist() == counts
    assert not kept.loses(3, 9)
    assert kept.loses(9, 10)
    assert kept.samples(7, 8).tolist() == [[0.0, 0.5, 0.5]]


@pytest.mark.parametrize("seed", range(20))
def test_record_finds_windows_that_are_quiet_and_inputs_that_rest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    window, span, count = int(rng.integers(20, 200)), int(rng.integers(2, 50)), 2000
    y = rng.standard_normal((count, 2)) * np.repeat(10.0 ** rng.uniform(-3, 0, count // 100), 100)[:, None]
    u = np.column_stack([np.repeat(rng.standard_normal(count // 40), 40), np.ones(count)])
    kept = Record(5, 2, 2)
    kept.append(y, u, None)
    index = np.arange(5 + window - 1, 5 + count, 7)
    least = 10.0 ** rng.uniform(-3, 0.3, 2)
    spread = np.array([y[i - 5 - window + 1 : i - 5 + 1].std(axis=0) for i in index])
    assert kept.quiet_in(index, window, least).tolist() == (spread < least).all(axis=1).tolist()
    one_value = [i - 5 >= span - 1 and np.ptp(u[i - 5 - span + 1 : i - 5 + 1, 0]) == 0 for i in index]
    rests = kept.resting_in(index, span, np.array([True, False]))
    assert rests[:, 0].tolist() == one_value
    assert not rests[:, 1].any()  # no channel reads the constant input


def taught() -> tuple[ChainRig, np.random.Generator, DenseNoise, Learner]:
    """A rig, where its windows and their noise come from, and who learns from them."""
    rig = ChainRig()
    noise = DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
    return rig, np.random.default_rng(2), noise, learner_of(rig)


def known_after(
    windows: int, rig: ChainRig, rng: np.random.Generator, noise: DenseNoise, learner: Learner
) -> tuple[Knowledge, Knowledge]:
    """What is known before any window, and after so many."""
    fresh = known = learner.prior(noise.sigma, np.full(2, 0.3))
    for _ in range(windows):
        known = learner.learn(record(rig, rng, noise)[0], known)[1]
    return fresh, known


def test_memory_round_trip_gives_the_same_answers() -> None:
    rig, rng, noise, learner = taught()
    fresh, known = known_after(5, rig, rng, noise, learner)
    again = from_text(to_text(known), fresh, learner.wire)
    assert again is not None
    window = record(rig, rng, noise)[0]
    one, other = (learner.solve(window, k)[0] for k in (known, again))
    assert np.abs((one.theta - other.theta) / one.sd).max() < 0.1
    # levels of single bins are kept where they stand out only
    assert other.sd == pytest.approx(one.sd, rel=0.05)
    assert to_text(again) == to_text(from_text(to_text(again), fresh, learner.wire))  # type: ignore[arg-type]


def test_memory_keeps_where_lines_stand() -> None:
    rig, rng, noise, learner = taught()
    known = learner.prior(noise.sigma, np.full(2, 0.3))
    fresh = known
    for k in range(5):
        window = record(rig, rng, noise)[0]
        hum = 3e-3 * np.sin(2 * np.pi * 40.3 * np.arange(window.length) / window.length + k)
        known = learner.learn(replace(window, y=window.y + hum[:, None]), known)[1]
    again = from_text(to_text(known), fresh, learner.wire)
    assert again is not None
    at = np.argmax(known.noise.levels[:, 0])
    assert at + again.noise.places.off[at] == pytest.approx(40.3, abs=0.01)
    assert again.noise.places.off[at] == pytest.approx(known.noise.places.off[at], abs=0)
    assert np.count_nonzero(again.noise.places.off) < np.count_nonzero(known.noise.places.off)


def test_memory_of_other_constants_or_an_earlier_program_is_not_taken() -> None:
    rig, noise = ChainRig(), DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
    learner, other = learner_of(rig), learner_of(ChainRig(sheet=(0.0, 0.01, 0.01, 0.25)))
    known = learner.prior(noise.sigma, np.full(2, 0.3))
    fresh = known
    known = learner.learn(record(rig, np.random.default_rng(2), noise)[0], known)[1]
    text = to_text(known)
    assert from_text(text, fresh, learner.wire) is not None
    assert from_text(text, other.prior(noise.sigma, np.full(2, 0.3)), learner.wire) is None
    three = Noise.prior(np.ones(3), np.ones(3), len(fresh.noise.power), len(fresh.noise.intensity), 4)
    assert from_text(text, replace(fresh, noise=three), learner.wire) is None
    assert from_text(text.replace('"version": 2', '"version": 0'), fresh, learner.wire) is None
    assert from_text(to_text(replace(known, footing=None)), fresh, learner.wire) is None


def test_hypotheses_that_an_earlier_program_did_not_have_begin_with_their_priors() -> None:
    rig, rng, noise, learner = taught()
    fresh, known = known_after(3, rig, rng, noise, learner)
    count = len(fresh.constants.weight) - 3
    kept = json.loads(to_text(known))
    fewer = replace(
        known.constants, hypotheses=known.constants.hypotheses[:count], weight=known.constants.weight[:count],
        mean=known.constants.mean[:count], covariance=known.constants.covariance[:count],
    )  # fmt: skip
    kept["constants"] = json.loads(to_text(replace(known, constants=fewer)))["constants"]
    again = from_text(json.dumps(kept), fresh, learner.wire)
    assert again is not None
    np.testing.assert_array_equal(again.constants.mean[:count], known.constants.mean[:count])
    np.testing.assert_array_equal(again.constants.covariance[count:], fresh.constants.covariance[count:])
    np.testing.assert_array_equal(again.constants.weight[count:], fresh.constants.weight[count:])
    np.testing.assert_allclose(
        again.constants.weight[:count],
        (1 - fresh.constants.weight[count:].sum()) * known.constants.weight[:count],
    )


def in_decimals(content: Any) -> Any:
    """Return packed arrays as the form before had them."""
    if not isinstance(content, dict):
        return content
    if content.keys() == {"shape", "base64"}:
        return np.frombuffer(b64decode(content["base64"])).reshape(content["shape"]).tolist()
    return {key: in_decimals(value) for key, value in content.items()}


def test_memory_of_the_form_before_is_read_and_what_is_not_finite_is_not_written() -> None:
    rig, noise = ChainRig(), DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
    learner = learner_of(rig)
    fresh = learner.prior(noise.sigma, np.full(2, 0.3))
    known = learner.learn(record(rig, np.random.default_rng(2), noise)[0], fresh)[1]
    text = to_text(known)
    before = json.dumps(in_decimals(json.loads(text)) | {"version": 1})
    again = from_text(before, fresh, learner.wire)
    assert again is not None
    assert to_text(again) == to_text(from_text(text, fresh, learner.wire))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="finite"):
        to_text(replace(known, theta=np.full(4, np.nan)))


@pytest.mark.parametrize(
    ("first", "last", "rests"),
    [(0, 100, False), (0, 37, True), (63, 100, True), (20, 60, False), (90, 95, True), (45, 55, False)],
    ids=["all of it", "the oldest", "the newest", "the middle", "a little, late", "a little, in the middle"],
)
def test_record_tells_windows_in_which_nothing_moves_for_half_of_the_time(
    first: int, last: int, rests: bool
) -> None:
    """first, last: between which samples of a window of 100 the machine moves."""
    y = np.zeros((1100, 2))
    y[1000 + first : 1000 + last, 1] = 1e-6 * (1 + np.arange(last - first))
    y[1000 + last :, 1] = y[1000 + last - 1, 1]
    kept = Record(50, 2, 1)
    kept.append(y, np.ones((1100, 1)), None)
    np.testing.assert_array_equal(kept.rests_in(np.array([949, 1149]), 100), [True, rests])
