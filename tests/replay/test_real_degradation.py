"""Fatigue cracks, adhesive joints and batteries to their end: forecasts at shares of their lives held against
it."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from agent.prognosis.change import change
from agent.prognosis.forecast import Forecast, forecast, learn_from
from agent.prognosis.history import History
from agent.prognosis.posterior import BRIEF, FULL, Effort
from agent.prognosis.scores import crps
from tests.figures import figure
from tests.peers import data
from tests.unit.prognosis.calibration import held

DAY = 86_400.0
SHARES = (0.3, 0.5, 0.7, 0.9)


def table(name: str) -> list[dict[str, str]]:
    path: Path = data(f"degradation/{name}")
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def history(t: Sequence[str], value: Sequence[str]) -> History:
    """A cycle is taken for a second."""
    return History(np.array(t, float) / DAY, np.array(value, float), np.zeros(len(t)))


def cracks() -> list[History]:
    rows = table("virkler_odd.csv")
    return [
        history([row[name] for row in rows], [row["crack_mm"] for row in rows])
        for name in rows[0]
        if name[0] == "s"
    ]


def joints() -> list[History]:
    rows = table("joints_stiffness.csv")
    found = []
    for name in sorted({row["specimen"] for row in rows}):
        mine = [row for row in rows if row["specimen"] == name][
            5:
        ]  # the machine's first cycles are not yet whole
        found.append(history([row["cycle"] for row in mine], [row["k_kN_per_mm"] for row in mine]))
    return found


def batteries() -> list[History]:
    files = [table(f"battery_B000{number}.csv") for number in (5, 6)]
    return [history([row["discharge"] for row in rows], [row["capacity"] for row in rows]) for rows in files]


def life(whole: History, limit: float) -> float:
    reached = whole.value >= limit if limit > whole.value[0] else whole.value <= limit
    return float(whole.t[np.flatnonzero(reached)[0]])


class Score:
    """What forecasts at one share of the lives came to."""

    def __init__(self) -> None:
        self.status: list[str] = []
        self.held: list[bool] = []
        self.crps: list[float] = []
        self.rivals: list[tuple[float, float]] = []

    def take(self, made: Forecast, seen: History, end: float, limit: float, others: np.ndarray) -> None:
        self.status.append(made.status)
        if made.p10 is None or made.p90 is None:
            return
        remains, now = end - float(seen.t[-1]), float(seen.t[-1])
        self.held.append(held(made.p10, made.p90, remains))
        self.crps.append(crps(np.minimum(made.passages, 50.0 * end), remains) / end)
        rate = (seen.value[-1] - seen.value[0]) / (seen.t[-1] - seen.t[0])
        left = others[others > now] if (others > now).any() else np.array([now])
        self.rivals.append(
            (abs((limit - seen.value[-1]) / rate - remains) / end, crps(left - now, remains) / end)
        )

    def words(self) -> str:
        states = ", ".join(f"{self.status.count(state)} {state}" for state in sorted(set(self.status)))
        if not self.held:
            return states
        rate, lives = np.mean(self.rivals, axis=0)
        return (f"{states}; P10-P90 held {np.mean(self.held):.2f}, CRPS {np.mean(self.crps):.3f} of a life "
                f"(constant rate {rate:.3f}, lives of the others {lives:.3f})")  # fmt: skip


def scored(
    name: str,
    sets: list[History],
    limits: Sequence[float],
    folds: int,
    *,
    like: bool,
    shares: Sequence[float] = SHARES,
    effort: Effort = FULL,
) -> dict[float, Score]:
    """Forecast each specimen at shares of its life; with a prior of the other folds' specimens."""
    lives = np.array([life(h, limit) for h, limit in zip(sets, limits, strict=True)])
    found = {share: Score() for share in shares}
    for fold in range(folds):
        rest = [i for i in range(len(sets)) if i % folds != fold]
        prior = learn_from([sets[i].until(lives[i]) for i in rest], None) if like else None
        for i in range(fold, len(sets), folds):
            for share in shares:
                seen = sets[i].until(sets[i].t[0] + share * (lives[i] - sets[i].t[0]))
                made = forecast(seen, limits[i], like=prior, effort=effort)
                found[share].take(made, seen, lives[i], limits[i], lives[rest])
    for share, score in found.items():
        how = f"{', like machines' if like else ''}{', brief' if effort is BRIEF else ''}"
        figure(f"{name}{how}, {100 * share:.0f} % of life: {score.words()}")
    return found


def test_cracks_with_a_prior_from_other_cracks_are_forecast_better_than_by_their_lives() -> None:
    sets = cracks()[::2]
    found = scored("cracks", sets, [49.8] * len(sets), 2, like=True)
    for share, score in found.items():
        rate, lives = np.mean(score.rivals, axis=0)
        assert np.mean(score.crps) < 0.85 * min(rate, lives), share
        assert np.mean(score.held) >= 0.7, share


def test_brief_forecasts_of_cracks_hold_what_comes() -> None:
    sets = cracks()[::2]
    found = scored("cracks", sets, [49.8] * len(sets), 2, like=False, shares=SHARES[1:], effort=BRIEF)
    for share, score in found.items():
        assert np.mean(score.held) >= 0.7, share


def test_joints_and_batteries_are_covered_or_too_short() -> None:
    kinds = {"joints": (joints(), 0.8), "batteries": (batteries(), None)}
    for name, (sets, part) in kinds.items():
        limits = [1.4 if part is None else part * float(h.value[0]) for h in sets]
        for like in (False, True):
            for share, score in scored(name, sets, limits, len(sets), like=like).items():
                if share >= 0.9:
                    assert np.mean(score.held) >= 0.6, (name, like, share)


def test_failing_parts_show_a_trend_by_a_third_of_their_lives() -> None:
    sets = [(h, 49.8) for h in cracks()[::3]] + [(h, 0.8 * float(h.value[0])) for h in joints()]
    seen = [h.until(h.t[0] + 0.33 * (life(h, limit) - h.t[0])) for h, limit in sets]
    found = [change(part) for part in seen]
    early = [f is not None and f.trend for f in found]
    figure(f"a trend is said by a third of life: {sum(early)} of {len(early)} parts that failed")
    assert sum(early) >= len(early) - 1  # one joint's run-in looks like a walk until later


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("limit", [49.8, 20.0])
def test_all_cracks_at_two_limits_with_and_without_a_prior(limit: float) -> None:
    sets = cracks()
    alone = scored(f"all cracks to {limit:g} mm", sets, [limit] * len(sets), 2, like=False)
    together = scored(f"all cracks to {limit:g} mm", sets, [limit] * len(sets), 2, like=True)
    for share in SHARES:
        _, lives = np.mean(together[share].rivals, axis=0)
        assert np.mean(together[share].crps) < 0.85 * lives, share
        assert 0.7 <= np.mean(together[share].held) <= 0.95, share  # of 34: 0.88 is within chance of 0.95
    for share in (0.5, 0.7, 0.9):
        assert np.mean(together[share].crps) <= np.mean(alone[share].crps)
