"""Strong unknown forces are found from none: likelihood falls between weak ones and them."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.inference.noise.intensities import first_nodes, strongest
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.inference.spectral.sources import Source
from agent.types import FloatArray
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, linearised

SIGMA = np.array([1e-4, 2e-4])
RIG = ChainRig()
SAMPLES = 400


def fit_of(size: float, seed: int) -> tuple[NoiseFit, FloatArray, tuple[Source, ...]]:
    """The fit of a window in which a white force of that size pushes mass 2, with all forces absent."""
    rng = np.random.default_rng(seed)
    learner = learner_of(RIG, SAMPLES)
    force = 2.0 * rng.standard_normal((SAMPLES + 1, 1))
    pushed = force + size * rng.standard_normal((SAMPLES + 1, 1))
    y = RIG.readings(RIG.theta, np.zeros(6), np.zeros(4), pushed[1:], np.diff(pushed, axis=0)).real
    window = window_of(y + SIGMA * rng.standard_normal(y.shape), force[1:], force[0])
    known = knowledge(learner, DenseNoise(SIGMA, np.zeros(2)))
    at = linearised(learner, known, window)
    nodes = first_nodes(at.cells, known.noise.log_sigma)
    noise = replace(known.noise, nodes=nodes, intensity=nodes[:, 0].copy())
    wide = learner.lineariser.ridge(at.regression.layout, window, 1e-12 * np.eye(6), np.zeros(6))
    return NoiseFit(noise, at.cells, at.regression, learner.sources, wide), nodes, learner.sources


@pytest.mark.parametrize("size", [0.5, 5.0, 50.0])
def test_white_force_of_any_size_is_found_where_it_acts(size: float) -> None:
    fit, nodes, sources = fit_of(size, 3)
    forces = np.array([a for a, source in enumerate(sources) if source.kind == "force"])
    found = strongest(fit, forces, nodes)
    acts = next(a for a, s in enumerate(sources) if (s.kind, s.number, s.pole) == ("force", 1, 0.0))
    assert size / 1.7 < found[acts] < 1.7 * size
    others = np.delete(forces, forces.tolist().index(acts))
    assert (found[others] < 0.5 * size).all()


def test_without_forces_hardly_any_is_found() -> None:
    fit, nodes, sources = fit_of(0.0, 4)
    before = fit.restricted_log_likelihood()
    forces = np.array([a for a, source in enumerate(sources) if source.kind == "force"])
    strongest(fit, forces, nodes)
    assert 0.0 <= fit.restricted_log_likelihood() - before < 5.0
