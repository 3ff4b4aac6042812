"""A rig that stays as it is under lists of windows: what each window says from its first whole one on."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.window.rows import Rows
from agent.types import FloatArray
from tests.statistical.machine import each
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import noisy, settings

TRUTH = np.array([27.0, 95.0, 5.4, 4.7])
HOP, LIMIT = 50, 0.1
LISTS = {
    "a quarter and 5 s": (250, 5000),
    "auto": (850, 1700, 3400, 6800, 13_600),
    "auto of a faster rig": (250, 500, 1000, 2000, 4000),
    "half and 5 s, noise to be learnt": (500, 5000),
}


@dataclass(frozen=True)
class Told:
    """What one window of a list says at its rows from the first whole one on.

    Attributes:
        valid: (N, 4) rows that are to be believed, parameter by parameter.
        covers: (N, 4) and whose interval holds the truth.
    """

    valid: np.ndarray
    covers: np.ndarray


def estimator(windows: tuple[int, ...], sigma: float, *, learnt: bool = False) -> WindowML:
    """The paper's rig under a list of windows, samples; learnt: the noise is not stated."""
    plain = settings(windows[0], HOP, np.nan if learnt else sigma, LIMIT)
    return WindowML(rig(), replace(plain, longer=windows[1:], wanted_sd=0.1 * LIMIT * NOMINAL))


def record(rng: np.random.Generator, samples: int, sigma: float, force: float = 60.0) -> tuple[FloatArray, FloatArray]:
    """Displacements and force of the rig at TRUTH, a twelfth of the force's noise beside 60 N for 5 N."""
    made = noisy(rng, samples, sigma * 5.0 / force, TRUTH)
    return made.y * force / 5.0, made.u * force / 5.0


def played(name: str, seed: int, seconds: float, sigma: float) -> Rows:
    """Rows of one run."""
    y, u = record(np.random.default_rng([seed, 78]), round(seconds * 1000), sigma)
    return estimator(LISTS[name], sigma, learnt="learnt" in name).step(0, y, u)


def reported(name: str, seed: int, seconds: float, sigma: float) -> list[Told]:
    """What each window of a list says in one run, and last what was chosen."""
    rows, windows = played(name, seed, seconds, sigma), LISTS[name]
    enough, found = 0.33 * LIMIT * NOMINAL, []
    short = rows.full & ~rows.changing & ~rows.mismatch
    for number, window in enumerate(windows):
        whole = rows.index >= window - 1
        fits = (rows.each_fits[:, number] & short)[whole, None]
        found.append(_reported(rows.each_theta[whole, number], rows.each_sd[whole, number], fits, enough))
    found.append(_reported(rows.theta[rows.full], rows.sd[rows.full], short[rows.full, None], enough))
    return found


def _reported(theta: FloatArray, sd: FloatArray, fits: np.ndarray, enough: FloatArray) -> Told:
    with np.errstate(invalid="ignore"):
        valid = fits & (sd < enough)
        return Told(valid, valid & (np.abs(theta - TRUTH) < 1.96 * sd))


def shares(name: str, runs: int, seconds: float = 40.0, sigma: float = 70e-6) -> tuple[FloatArray, FloatArray]:
    """Shares (windows + 1, 4) over runs of rows that are valid, and of valid ones whose interval holds the truth."""
    found = each(partial(_one, name, seconds, sigma), range(runs))
    valid = np.array([[t.valid.mean(axis=0) for t in run] for run in found]).mean(axis=0)
    counts = [[(t.valid.sum(axis=0), t.covers.sum(axis=0)) for t in run] for run in found]
    total = np.array(counts).sum(axis=0)
    return valid, np.where(total[:, 0] > 0, total[:, 1] / np.maximum(total[:, 0], 1), np.nan)


def _one(name: str, seconds: float, sigma: float, seed: int) -> list[Told]:
    return reported(name, seed, seconds, sigma)
