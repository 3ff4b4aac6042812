"""Rows of the streaming bank against the learner's window: two forms of one likelihood."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.estimator.operating_point import operating_point, taps_of
from agent.numerics.estimator.reading import Reading, read
from agent.numerics.estimator.record import Record
from agent.numerics.inference.constants import Constants
from agent.numerics.inference.posterior import Knowledge, Posterior
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.lost import Lost
from agent.numerics.window.stream import Stream
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of
from tests.unit.numerics.window.bank_rigs import due, joined

FloatArray = NDArray[np.float64]
WINDOW, HOP, SAMPLES = 240, 40, 1000


LOST = ((210, 0), (300, 2), (301, 1), (301, 2), (333, 0), (487, 2), (488, 0), (563, 1), (777, 2))


def both(
    rig: ChainRig, noise: DenseNoise, seed: int, lost: tuple[tuple[int, int], ...] = (), believed: str = "",
    loudness: float = 0.0,
) -> tuple[Reading, list[Posterior]]:  # fmt: skip
    """Rows of the bank, and the learner's answers about the same windows at the same point.

    believed: the one hypothesis on the constants, all that stand if empty; loudness: how the force grows.
    """
    rng = np.random.default_rng(seed)
    u = 20 * rng.standard_normal((SAMPLES, 1)) * np.exp(loudness * np.arange(SAMPLES) / SAMPLES)[:, None]
    slope = np.diff(u, axis=0, prepend=u[:1])
    eta = np.zeros(rig.count + len(rig.seen) + 2)
    # beyond the first order the forms differ: the learner's initial state is that of the readings as filled
    # in
    theta = rig.theta * (1.00001 if lost or loudness else 1.001)
    y = rig.readings(theta, eta, 0.01 * rng.standard_normal(2 * rig.count), u, slope).real
    y = y + noise.sigma * rng.standard_normal(y.shape)
    learner = learner_of(rig, WINDOW)
    known: Knowledge = knowledge(learner, noise)
    known = replace(known, constants=only(known.constants, believed)) if believed else known
    samples = Record(0, len(rig.seen), 1)
    missing = np.zeros((SAMPLES, len(rig.seen) + 1), dtype=bool)
    for sample, channel in lost:
        missing[sample, channel] = True
        (y if channel < len(rig.seen) else u)[sample, channel % len(rig.seen)] += (
            1e-3 if channel == 2 else 1e-5
        )
    samples.append(y, u, missing)
    at = learner.lineariser.linearised(samples.window(WINDOW, WINDOW), known, jumps=False, steps=1)
    first = learner._posterior(at, known, known.constants if believed else None)
    known = replace(known, footing=learner.moved_to(at, known, same=False).footing)
    point = operating_point(learner.rig, known, first, learner.sources, WINDOW, first.sd_repeat)
    # what a gain does inside a window is taken from the one learnt from, whatever the excitation
    point = replace(point, slid=np.zeros(learner.rig.q))
    plan = HopPlan(WINDOW, HOP)
    taps = taps_of(learner.rig, len(rig.seen), point.inputs, point.slopes)
    stream = Stream(point.model, point.push, point.noise, plan, (), learner.rig.q, taps)
    stream.start_segment(0)
    taken = samples.samples_with_slopes if point.slopes else samples.samples
    pieces = [samples.lost_between(start, start + HOP, WINDOW) for start in range(0, SAMPLES, HOP)]
    given = reduce(Lost.followed, pieces)
    stream.append(0, taken(0, SAMPLES), given)
    windowed = joined(due(stream)).windows[0]
    assert windowed is not None
    rows = read(windowed, point, WINDOW)
    later = replace(known, constants=known.constants.predicted())
    answers = []
    for newest in rows.index:
        window = samples.window(int(newest), WINDOW)
        # the learner takes the prior of a lost force from both sides of it; here both forms have the same
        window = replace(window, lost_sd=given.between(int(newest) + 1 - WINDOW, int(newest) + 1).sd)
        at = learner.lineariser.linearised(window, later, jumps=False, steps=1)
        answers.append(learner._posterior(at, later, None if believed else later.constants))
    return rows, answers


def only(constants: Constants, name: str) -> Constants:
    """One hypothesis of the sum, believed."""
    first = [h.name for h in constants.hypotheses].index(name)
    one = slice(first, first + 1)
    return Constants(constants.hypotheses[one], np.ones(1), constants.mean[one], constants.covariance[one])


@pytest.mark.parametrize("believed", ["as configured", "within data sheet", "m1", "x1 drifts", "x1 late"])
def test_bank_rows_weigh_the_constants_as_the_learner_does_whatever_the_excitation(believed: str) -> None:
    noise = DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
    rig = ChainRig(lag=0.25 if believed.endswith("late") else 0.0)
    rows, answers = both(rig, noise, 3, believed=believed, loudness=3.0)
    sd = np.array([np.sqrt(a.sd**2 - a.slid**2) for a in answers])
    theta = np.array([a.theta for a in answers])
    assert np.abs(np.log(rows.sd / sd)).max() < 1e-4
    # the learner takes what constants move for factors: beyond the first order of them
    assert np.abs((rows.theta - theta) / sd).max() < 1e-3


@pytest.mark.parametrize("force", [0.0, 0.5])
@pytest.mark.parametrize("seen", [("displacement", "displacement"), ("displacement", "acceleration")])
def test_bank_rows_are_the_learners_windows(seen: tuple[str, ...], force: float) -> None:
    sigma = np.array([1e-4, 2e-4 if seen[1] == "displacement" else 5e-2])
    # constants exact: what both forms share is the likelihood
    rig = ChainRig(seen=seen, sheet=(0.0, 0.0, 0.0, 0.0))
    rows, answers = both(rig, DenseNoise(sigma, np.array([force, 0.5 * force])), 3)
    assert len(answers) >= 15
    sd = np.array([a.sd_repeat for a in answers])
    theta = np.array([a.theta for a in answers])
    assert np.abs((rows.theta - theta) / sd).max() < 1e-6
    assert np.abs(np.log(rows.sd_repeat / sd)).max() < 1e-6


@pytest.mark.parametrize("force", [0.0, 0.5])
def test_bank_rows_of_windows_that_lost_readings_are_the_learners_windows(force: float) -> None:
    rig = ChainRig(sheet=(0.0, 0.0, 0.0, 0.0))
    rows, answers = both(rig, DenseNoise(np.array([1e-4, 2e-4]), np.array([force, 0.5 * force])), 3, LOST)
    assert len(answers) >= 15
    sd = np.array([a.sd_repeat for a in answers])
    theta = np.array([a.theta for a in answers])
    assert np.abs((rows.theta - theta) / sd).max() < 3e-3
    assert np.abs(np.log(rows.sd_repeat / sd)).max() < 5e-3
    held = [sum(n - WINDOW < s <= n and c < 2 for s, c in LOST) for n in rows.index.tolist()]
    assert np.array_equal(rows.dof.max() - rows.dof, held)
