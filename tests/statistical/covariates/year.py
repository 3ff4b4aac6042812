"""A year of a machine whose spring follows the temperature of its hall: a row each 10 min, with gaps and
restarts."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.blocks.covariates.compensation import Compensation
from agent.blocks.covariates.means import CovariateMeans
from agent.blocks.level_alarms import LevelAlarms
from agent.config import Alarm
from agent.config.sections.covariates import Covariate
from agent.records import Baseline, CovariateMean
from agent.storage.write.store import Store
from agent.types import AlarmTransition, BoolArray, EstimateBatch, FloatArray, IntArray
from tests.storage.rows import START, batch, run_info

K, PER_KELVIN, LAG_S = 25.0, -0.003, 7200.0
STEP_S, DAY = 600, 144
STEP_NS = STEP_S * 10**9
SPREAD, SLOW, ROW_SD = 0.0015, 36, 0.0025
"""Of k: sd and rows of correlation of what nobody measures; sd of a row."""
HALL = Covariate(name="temperature", unit="degC")
GRAPH = "spring k1 ground-m1"


@dataclass(frozen=True)
class Year:
    """Rows t_ns (n,), k (n,), and readings of the thermometer (m,) at read_ns (m,)."""

    t_ns: IntArray
    k: FloatArray
    read_ns: IntArray
    temperature: FloatArray


def temperatures(rng: np.random.Generator, days: int, phase: float) -> FloatArray:
    """Return what the hall is like each 10 min: seasons, nights, and weather that lasts for days."""
    t = np.arange(days * DAY) / DAY
    weather = first_order(rng.standard_normal(len(t)) * np.sqrt(6.0 * DAY), 3.0 * DAY)
    return 17.0 + 9.0 * np.sin(2 * np.pi * (t / 365.0 + phase)) + 4.0 * np.sin(2 * np.pi * t) + 2.5 * weather


def first_order(x: FloatArray, steps: float) -> FloatArray:
    kept = np.exp(-1.0 / steps)
    out = np.empty(len(x))
    now = x[0]
    for i, value in enumerate(x):
        now = out[i] = kept * now + (1.0 - kept) * value
    return out


def year(
    seed: int, days: int = 365, phase: float = 0.0, lost_from: float | None = None, every: int = 1
) -> Year:
    """Play a machine that loses 5 % of its spring on a day; a tenth of the rows and two stretches are absent.

    every: only each so many of the rows are kept.
    """
    rng = np.random.default_rng([seed, 1717])
    hall = temperatures(rng, days, phase)
    lagged = first_order(np.concatenate([hall[:1], hall[:-1]]), LAG_S / STEP_S)
    slow = first_order(rng.standard_normal(len(hall)) * np.sqrt(2.0 * SLOW), SLOW)
    k = K * (1.0 + PER_KELVIN * (lagged - 20.0) + SPREAD * slow)
    if lost_from is not None:
        k[round(lost_from * DAY) :] *= 0.95
    k += K * ROW_SD * rng.standard_normal(len(k))
    t_ns = START + STEP_NS * np.arange(len(k))
    rows = (rng.random(len(k)) > 0.1) & (np.arange(len(k)) % every == 0)
    rows[round(0.45 * len(k)) : round(0.45 * len(k)) + 5 * DAY] = False
    read = np.ones(len(k), dtype=bool)
    read[round(0.7 * len(k)) : round(0.7 * len(k)) + 3 * DAY] = False  # the thermometer's cable
    return Year(
        t_ns[rows], k[rows], t_ns[read] + 17 * 10**9, hall[read] + 0.1 * rng.standard_normal(read.sum())
    )


def rows_of(played: Year, part: BoolArray | slice = slice(None), first_ns: int = START) -> EstimateBatch:
    """Return rows as the estimation makes them; the number of a sample is a second."""
    t_ns, value = played.t_ns[part], played.k[part, None]
    sd = np.full(value.shape, K * ROW_SD)
    plain = batch(len(t_ns), parameters=("k1",), value=value, sd=sd, reference=np.array([K]))
    index = (t_ns - first_ns) // 10**9
    return replace(plain, t_ns=t_ns, index=index, sd_repeat=sd, lower=value - 2 * sd, upper=value + 2 * sd)


def means_of(played: Year) -> list[CovariateMean]:
    """Return the means that the pipeline makes of the readings."""
    means = CovariateMeans("press-7", [HALL])
    means.take(played.read_ns, {"temperature": played.temperature})
    return means.finish()


def stored(path: Path, played: Year, days: int) -> Path:
    """Write the first days to a database, as the agent does."""
    until = START + days * DAY * STEP_NS
    with Store.open(path) as store:
        run = store.begin_run(replace(run_info(), graph=GRAPH))
        kept = [mean for mean in means_of(played) if mean.t_ns < until]
        store.write(run, [rows_of(played, played.t_ns < until), *kept])
    return path


def alarms(
    played: Year, baseline: Baseline, limit: float, on_delay_s: float, pieces: int = 9
) -> list[AlarmTransition]:
    """Return the steps of an alarm over rows that come piece by piece, the agent started anew between some of
    them."""
    rule = Alarm(parameter="k1", limit=limit * K, on_delay_s=on_delay_s)
    found: list[AlarmTransition] = []
    levels = LevelAlarms("press-7", [rule], 1.0)
    for piece, rows in enumerate(np.array_split(np.arange(len(played.t_ns)), pieces)):
        if piece % 3 == 0:  # a start: of covariates it has what was stored
            means = CovariateMeans("press-7", [HALL])
            known = [mean for mean in means_of(played) if mean.t_ns < played.t_ns[rows[0]]]
            means.adopt(known)
            compensation = Compensation("press-7", means.known)
            compensation.count_from([baseline])
        span = (played.read_ns >= played.t_ns[rows[0]]) & (played.read_ns <= played.t_ns[rows[-1]])
        means.take(played.read_ns[span], {"temperature": played.temperature[span]})
        whole = counted(rows_of(played, rows), baseline)
        parts, _ = compensation.step(whole)
        found += [step for part in parts for step in levels.step(part)]
    return found


def counted(rows: EstimateBatch, baseline: Baseline) -> EstimateBatch:
    """Return rows that count from a baseline where its covariates are at their centres."""
    own = baseline.baseline_id
    return replace(
        rows, reference=np.array([baseline.reference]), baseline_id=(own,), reference_sd=(baseline.sd,)
    )
