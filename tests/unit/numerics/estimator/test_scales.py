"""Scales that no reading shows: no column of the bank's, and their prior in every row."""

import numpy as np
import pytest

from agent.numerics.estimator.operating_point import OperatingPoint, operating_point
from agent.numerics.model.scales import scales_of
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

NOISE = DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
HEAVIER, LOUDER = np.array([1.0, 1, 0, 0, 1, 0]), np.array([0.0, 0, 1, 1, -1, 0])
"""Masses and the force, or outputs and 1 / force, times c: m1, m2, x1, x2, force, delay."""


def point_of(rig: ChainRig) -> OperatingPoint:
    learner = learner_of(rig)
    window = record(rig, np.random.default_rng(4), NOISE)[0]
    posterior, known = learner.learn(window, learner.prior(NOISE.sigma, np.full(2, 0.3)))
    return operating_point(
        learner.rig, known, posterior, learner.sources, learner.window, posterior.sd_repeat
    )


@pytest.mark.parametrize("seen", [("displacement", "displacement"), ("displacement", "acceleration")])
@pytest.mark.parametrize(("scale", "stiffer"), [(HEAVIER, 1.1), (LOUDER, 1.0)])
def test_scale_changes_no_reading(seen: tuple[str, ...], scale: np.ndarray, stiffer: float) -> None:
    rig, rng = ChainRig(seen=seen), np.random.default_rng(1)
    u = rng.standard_normal((50, 1))
    slope = np.diff(u, axis=0, prepend=0.0)
    both = [
        rig.readings(factor * rig.theta, share * np.log(1.1) * scale, np.zeros(4), u, slope).real
        for factor, share in ((1.0, 0.0), (stiffer, 1.0))
    ]
    np.testing.assert_allclose(both[1], both[0], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("seen", [("displacement", "displacement"), ("displacement", "acceleration")])
@pytest.mark.parametrize(
    ("sheet", "columns", "scales"),
    [
        ((0.02, 0.01, 0.01, 0.25), 4, [HEAVIER, LOUDER]),
        ((0.02, 0.0, 0.01, 0.25), 3, [HEAVIER]),
        ((0.0, 0.01, 0.01, 0.25), 3, [LOUDER]),
        ((0.02, 0.01, 0.0, 0.25), 5, []),
        ((0.0, 0.0, 0.0, 0.0), 0, []),
    ],
)
def test_scale_has_no_column_and_its_prior_in_every_row(
    seen: tuple[str, ...], sheet: tuple[float, ...], columns: int, scales: list[np.ndarray]
) -> None:
    rig = ChainRig(seen=seen, sheet=sheet)  # type: ignore[arg-type]
    point = point_of(rig)
    assert point.model.q == len(rig.theta) + columns
    if not scales:
        assert not point.unseen.any()
        return
    # of the constants' covariance, what is left of the scales with all else given
    known = learnt(rig)
    is_open = np.array([c.sheet > 0 for c in rig.constants])
    N = np.array(scales).T[is_open]
    left = np.linalg.inv(N.T @ np.linalg.solve(known[np.ix_(is_open, is_open)], N))
    wanted = left[0, 0] if scales[0] is HEAVIER else 0.0
    np.testing.assert_allclose(point.unseen, wanted, rtol=1e-6, atol=1e-18)


def learnt(rig: ChainRig) -> np.ndarray:
    """The constants' covariance that the point of a rig was made of."""
    learner = learner_of(rig)
    window = record(rig, np.random.default_rng(4), NOISE)[0]
    known = learner.learn(window, learner.prior(NOISE.sigma, np.full(2, 0.3)))[1]
    return known.constants.predicted().standing[1]


def test_parameter_that_stays_takes_its_scale_along() -> None:
    """A spring that is known sets the scale that masses and the force have with all that is estimated."""
    rng = np.random.default_rng(2)
    shapes = ((3, 3), (3, 1), (2, 3), (2, 1))
    base = tuple(rng.standard_normal(shape) for shape in shapes)
    parameters = [tuple(rng.standard_normal(shape) for shape in shapes) for _ in range(3)]
    heavier = tuple(-sum(parts) for parts in zip(*parameters, strict=True))
    found = scales_of(base, parameters, [heavier], ["mass"])
    assert found.constants.tolist() == [[1.0]]
    np.testing.assert_allclose(found.parameters, np.ones((3, 1)), rtol=1e-9)
    assert not scales_of(base, parameters[:2], [heavier], ["mass"]).constants.size
