"""First passages: as sure as they say, blind to what comes later, and silent where nothing can be said."""

import tracemalloc

import numpy as np
import pytest
from scipy.stats import kstest

from agent.prognosis.family import way_left
from agent.prognosis.forecast import Forecast, forecast, learn_from, plain_prior, readings_of
from agent.prognosis.history import History
from agent.prognosis.posterior import BRIEF, FULL, Effort
from tests.figures import figure
from tests.unit.prognosis.calibration import pit
from tests.unit.prognosis.histories import LIMIT, bent, hardly_moved, straight
from tests.unit.prognosis.laws import cracking, of_the_family


def transforms(rng: np.random.Generator, count: int) -> np.ndarray:
    found = []
    for _ in range(count):
        history, remains = straight(rng)
        made = forecast(history, LIMIT)
        if len(made.passages):
            found.append(pit(made.passages, remains))
    return np.array(found)


def test_forecast_band_holds_what_comes(rng: np.random.Generator) -> None:
    share = np.mean(np.abs(transforms(rng, 25) - 0.5) <= 0.4)
    assert share >= 0.68  # four in five of 25 are 20; fewer than 17 come in 5 % of seeds


def of_poor_rows(rng: np.random.Generator, count: int, effort: Effort) -> tuple[float, float]:
    """Shares held of histories whose newest rows are poor: as stated, and with the stated sd removed."""
    inside: list[tuple[bool, bool]] = []
    for _ in range(count):
        history, remains = hardly_moved(rng)
        unstated = History(history.t, history.value, np.zeros(len(history)))
        made = [forecast(one, LIMIT, effort=effort).passages for one in (history, unstated)]
        one, other = (len(found) > 0 and abs(pit(found, remains) - 0.5) <= 0.4 for found in made)
        inside.append((one, other))
    stated, removed = np.mean(inside, axis=0)
    return float(stated), float(removed)


def test_forecast_without_the_estimates_sd_no_longer_holds_what_comes(rng: np.random.Generator) -> None:
    stated, removed = of_poor_rows(rng, 20, BRIEF)
    assert stated >= 0.75
    assert removed <= 0.65


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_forecasts_of_many_histories_need_the_estimates_sd(rng: np.random.Generator) -> None:
    stated, removed = of_poor_rows(rng, 500, FULL)
    figure(f"newest rows ten times as uncertain: P10-P90 holds {stated:.2f}, without their sd {removed:.2f}")
    assert stated >= 0.75
    assert removed < 0.65


def test_forecast_of_a_steady_fall_is_that_of_a_steady_rate(rng: np.random.Generator) -> None:
    """Laws that bend too little to be seen would make it twice as wide."""
    made = [forecast(straight(rng)[0], LIMIT).passages for _ in range(10)]
    ratios = [float(found[int(0.9 * len(found))] / found[int(0.1 * len(found))]) for found in made]
    assert np.median(ratios) < 2.5


@pytest.mark.parametrize(("gone", "steady"), [(0.6, True), (0.1, False)])
def test_a_rate_that_stayed_over_little_of_the_way_may_still_change(
    rng: np.random.Generator, gone: float, steady: bool
) -> None:
    t = np.linspace(0.0, 100.0 * gone, 60)
    value = 25.0 - 0.05 * t + 0.02 * rng.standard_normal(60)
    weight = forecast(History(t, value, np.full(60, 0.02)), LIMIT).family["constant"]
    assert weight > 0.9 if steady else weight < 0.1


def test_poor_rows_beyond_the_limit_have_not_crossed_it() -> None:
    """Six newest rows scatter past the limit by less than they may be off; sixty before stay far from it."""
    t = np.arange(66.0)
    value = 25.0 - 0.05 * t
    value[-6:] = LIMIT - 0.3
    sd = np.where(t < 60.0, 0.05, 2.0)
    found = forecast(History(t, value, sd), LIMIT)
    assert found.status == "ok"
    assert found.p50 == pytest.approx(34.0, rel=0.3)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_forecast_transforms_of_many_histories_are_uniform(rng: np.random.Generator) -> None:
    found = transforms(rng, 500)
    share, p = float(np.mean(np.abs(found - 0.5) <= 0.4)), float(kstest(found, "uniform").pvalue)
    figure(
        f"forecasts of a steady fall: P10-P90 holds {100 * share:.0f} % of {len(found)}, Kolmogorov p {p:.3f}"
    )
    assert 0.75 <= share <= 0.85
    assert p > 0.01


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_forecast_transforms_of_parts_that_follow_the_family_are_uniform(rng: np.random.Generator) -> None:
    found = np.array([transform for _ in range(500) if (transform := of_one_part(rng)) is not None])
    share, p = float(np.mean(np.abs(found - 0.5) <= 0.4)), float(kstest(found, "uniform").pvalue)
    figure(
        f"forecasts of parts of the family: P10-P90 holds {100 * share:.0f} % of {len(found)}, "
        f"Kolmogorov p {p:.2f}"
    )
    assert 0.75 <= share <= 0.85
    assert p > 0.01


def of_one_part(rng: np.random.Generator) -> float | None:
    """Where the true passage lies among the draws, from 0 to 1; drawn evenly among those of no passage at
    all."""
    _, history, limit, remains = of_the_family(rng)
    found = forecast(history, limit).passages
    if not len(found):
        return None
    return (
        pit(found, remains) if np.isfinite(remains) else 1.0 - float(np.mean(np.isinf(found))) * rng.uniform()
    )


def test_like_machines_that_fail_faster_than_they_wore_teach_so_of_the_end_alone(
    rng: np.random.Generator,
) -> None:
    early, *_, late = learn_from([cracking(rng) for _ in range(6)], None).later
    assert abs(early[1]) < 0.5
    assert late[1] > 1.5
    assert early[2] < 0.5 * late[2]


@pytest.mark.parametrize("gone", [0.0, 0.9])
def test_rate_at_the_limit_is_as_uncertain_however_near_it_is(gone: float) -> None:
    """The law's κ counts over the whole way, so what may change over the rest of it is more by as much."""
    readings, scale = readings_of(History(np.arange(9.0), 25.0 - np.arange(9.0), np.full(9, 0.1)), LIMIT)
    level = np.expm1(gone * np.log1p(scale.limit))
    later = plain_prior(readings, way_left(float(level), scale)).later
    assert later.loc * (1.0 - gone) == pytest.approx(0.9)
    assert later.scale * (1.0 - gone) == pytest.approx(1.6)


def test_forecast_knows_nothing_of_later_rows(rng: np.random.Generator) -> None:
    history = bent(rng, 200)
    now = 119.0
    short = History(history.t[:120].copy(), history.value[:120].copy(), history.sd[:120].copy())
    one, other = forecast(history.until(now), 18.0), forecast(short, 18.0)
    assert (one.p10, one.p50, one.p90, one.chance) == (other.p10, other.p50, other.p90, other.chance)
    assert np.array_equal(one.passages, other.passages)


def test_forecast_of_an_accelerating_fall_is_sooner_than_its_line(rng: np.random.Generator) -> None:
    history = bent(rng)
    found = forecast(history, 15.0)
    truth = (-0.01 + np.sqrt(1e-4 + 4 * 1.5e-4 * 10.0)) / (2 * 1.5e-4) - 119.0
    line = (history.value[-1] - 15.0) / ((25.0 - history.value[-1]) / 119.0)
    assert found.status == "ok"
    assert found.p10 is not None
    assert found.p90 is not None
    assert found.p10 < truth < found.p90 < line


def test_forecast_more_noise_in_the_estimates_widens_the_band(rng: np.random.Generator) -> None:
    quiet, loud = (forecast(bent(rng, noise=noise), 18.0) for noise in (0.02, 0.4))
    assert width(loud) > 1.5 * width(quiet)


def width(found: Forecast) -> float:
    """P90 - P10 of the draws, whether they are shown or not."""
    return float(
        found.passages[int(0.9 * len(found.passages))] - found.passages[int(0.1 * len(found.passages))]
    )


@pytest.mark.parametrize("n", range(6))
def test_forecast_of_few_rows_is_too_short(n: int) -> None:
    found = forecast(History(np.arange(float(n)), np.full(n, 25.0), np.full(n, 0.1)), LIMIT)
    assert (found.status, found.p50, found.chance) == ("too short", None, None)


def test_forecast_of_a_level_that_stays_has_no_trend_and_no_date(rng: np.random.Generator) -> None:
    found = forecast(History(np.arange(90.0), 25.0 + 0.1 * rng.standard_normal(90), np.full(90, 0.1)), 15.0)
    assert (found.status, found.p50) == ("no trend", None)
    assert found.chance is not None
    assert found.chance < 0.05


def test_forecast_of_a_crossed_limit_says_so(rng: np.random.Generator) -> None:
    assert forecast(bent(rng), 24.0).status == "crossed"


def test_forecast_of_a_limit_on_the_other_side_never_comes(rng: np.random.Generator) -> None:
    found = forecast(bent(rng), 30.0)
    assert (found.status, found.p50) == ("beyond", None)


def test_forecast_beyond_the_horizon_still_has_its_quantiles(rng: np.random.Generator) -> None:
    near, far = forecast(bent(rng), 15.0, horizon=500.0), forecast(bent(rng, 60), 5.0, horizon=100.0)
    assert near.status == "ok"
    assert far.status in {"beyond", "too short"}
    assert near.chance is not None
    assert near.chance > 0.9


def test_forecast_family_weights_sum_to_one(rng: np.random.Generator) -> None:
    found = forecast(bent(rng), 18.0)
    assert sum(found.family.values()) == pytest.approx(1.0)
    assert found.family["rate law"] > found.family["constant"]


def test_like_machines_narrow_a_short_history_and_lose_to_a_long_one(rng: np.random.Generator) -> None:
    learnt = learn_from([bent(rng, 220) for _ in range(8)], 17.0)
    assert learnt.n == 8
    early = bent(rng, 50)
    alone, together = forecast(early, 17.0), forecast(early, 17.0, like=learnt)
    assert width(together) < width(alone)
    t = np.arange(180.0)
    other = History(t, 25.0 - 0.02 * t + 0.02 * rng.standard_normal(180), np.full(180, 0.02))
    misled = forecast(
        other, 17.0, like=learnt
    )  # like machines lived 200 days; this one has 221 left, and says so
    assert misled.p10 is not None
    assert misled.p90 is not None
    assert 70.0 < misled.p10 < 221.0 < misled.p90


def test_learn_from_nothing_that_moves_says_so() -> None:
    with pytest.raises(ValueError, match="none of the histories"):
        learn_from([History(np.arange(4.0), np.ones(4), np.ones(4))])


def test_like_machines_that_ended_before_the_limit_have_not_lived(rng: np.random.Generator) -> None:
    """Taken out of service at 85, they say how long 80 takes by their law and not by the day they ended."""
    t = np.arange(76.0)
    fall = [100.0 - 0.2 * t + 0.05 * rng.standard_normal(76) for _ in range(6)]
    learnt = learn_from([History(t, value, np.full(76, 0.05)) for value in fall], 80.0)
    assert np.exp(learnt.of["life"][0]) == pytest.approx(75.0, rel=0.02)
    assert learnt.way == pytest.approx(np.log(0.85), rel=0.02)  # what that life is counted over: not to 80
    with pytest.raises(ValueError, match="half of the way to 60"):
        learn_from([History(t, value, np.full(76, 0.05)) for value in fall], 60.0)


def test_forecast_of_damage_that_grows_by_its_own_size_is_not_late(rng: np.random.Generator) -> None:
    """exp(t/50), seen to 0.6 of its life: laws of the level alone and of time squared all come later."""
    t = np.arange(118.0)
    value = 100.0 - 0.5 * np.expm1(0.02 * t) + 0.1 * rng.standard_normal(118)
    found = forecast(History(t, value, np.full(118, 0.1)), 75.0)
    assert found.family["growth"] > 0.3
    assert pit(found.passages, np.log(51.0) / 0.02 - 117.0) > 0.1


@pytest.mark.parametrize("rows", [100, 4000])
def test_forecast_counts_from_the_newest_row_however_many_there_are(
    rng: np.random.Generator, rows: int
) -> None:
    t = np.linspace(0.0, 100.0, rows)
    found = forecast(
        History(t, 25.0 - 0.05 * t + 1e-3 * rng.standard_normal(rows), np.full(rows, 1e-3)), 19.0
    )
    assert found.p50 == pytest.approx(20.0, abs=0.15)


def test_brief_forecast_says_what_the_whole_one_says(rng: np.random.Generator) -> None:
    for _ in range(2):
        history = bent(rng, 400, noise=0.05)
        whole, brief = (forecast(history, -20.0, effort=effort) for effort in (FULL, BRIEF))
        assert brief.status == whole.status == "ok"
        assert brief.p50 == pytest.approx(whole.p50, rel=0.05)
        assert 0.6 < width(brief) / width(whole) < 3.0  # of half as many means


def test_forecast_without_a_horizon_is_not_beyond_it(rng: np.random.Generator) -> None:
    t = np.linspace(0.0, 100.0, 1000)  # thinned to means, whose span is less
    found = forecast(
        History(t, 25.0 - 0.05 * t + 0.02 * rng.standard_normal(1000), np.full(1000, 0.02)), 14.9
    )
    assert found.p50 is not None
    assert found.p50 > 100.0
    assert found.status == "ok"


def test_forecast_takes_little_memory_beside_what_an_agent_has(rng: np.random.Generator) -> None:
    history, _ = straight(rng, 200)
    forecast(history[:40], LIMIT)  # what a first call imports
    tracemalloc.start()
    try:
        made = forecast(history, LIMIT)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
    figure(f"most memory while a forecast is made: {peak:.1f} MB")
    assert len(made.passages)
    assert peak < 5.0


@pytest.mark.parametrize("repaired", [False, True])
def test_lives_of_like_machines_end_where_their_level_passes_the_limit(
    rng: np.random.Generator, repaired: bool
) -> None:
    """The first row beyond it is early by the rows' scatter, here by a fifteenth."""
    t = np.arange(0.0, 130.0, 0.25)
    level = 100.0 - 30.0 * (1.0 - np.exp(-t / 100.0))  # 80 at 110, where it falls by 0.1 a day
    rows = [level + 0.5 * rng.standard_normal(len(t)) for _ in range(8)]
    after = np.full(20, 100.0) if repaired else np.empty(0)
    instants = np.r_[t, 130.0 + np.arange(len(after))]
    histories = [History(instants, np.r_[value, after], np.zeros(len(instants))) for value in rows]
    assert np.mean([t[np.flatnonzero(value <= 80.0)[0]] for value in rows]) < 104.0
    life, *_ = learn_from(histories, 80.0).of["life"]
    assert np.exp(life) == pytest.approx(110.0, rel=0.02)


def test_late_in_life_a_machines_own_rows_count_beside_like_machines(rng: np.random.Generator) -> None:
    """Noisy falls that level off: when others passed a limit says less than the machine's own law."""
    ratios = []
    for _ in range(5):
        learnt = learn_from([levelling_off(rng, 1.05) for _ in range(3)], 80.0)
        own = levelling_off(rng, 0.93)
        ratios.append(width(forecast(own, 80.0, like=learnt)) / width(forecast(own, 80.0)))
    assert np.mean(ratios) < 1.0


def levelling_off(rng: np.random.Generator, share: float) -> History:
    """Rows up to a share of the time in which a level reaches 80."""
    constant = 100.0 * float(np.exp(0.25 * rng.standard_normal()))
    t = np.arange(0.0, share * constant * np.log(3.0))
    value = 100.0 - 30.0 * (1.0 - np.exp(-t / constant)) + 0.4 * rng.standard_normal(len(t))
    return History(t, value, np.full(len(t), 0.4))
