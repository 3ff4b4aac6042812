"""How sharp rows can be beside forces and colours that hide a parameter, and how sharp they are."""

from functools import partial

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from tests.statistical.machine import each, say
from tests.statistical.nearly_right import SETTLE_WINDOWS, Found, least, play, together
from tests.statistical.oracle import (
    SPECTRA,
    Bound,
    Noise,
    bound,
    bound_of,
    derivatives,
    free_responses,
    known,
    motion,
    recording,
)  # fmt: skip

WINDOWS, RECORDINGS, FIRST_SEED = 100, 3, 5000
BEHIND = 0.06
"""Share of rows by which the product, which has to learn the spectrum, may stay behind what is given it."""


@pytest.mark.parametrize(
    "name", ["AR(0.95) sensors", pytest.param("AR(0.99) 0.05 N", marks=pytest.mark.soak)]
)
def test_oracle_bound_is_what_least_squares_with_the_true_noise_scatter_by(name: str) -> None:
    windows = 60
    made = recording(name, 3, windows)
    q, W = len(made.chain.theta), made.chain.window
    read = made.readings()[:, 1:] - motion(made, unknown=False)
    noise, free, columns = Noise(SPECTRA[name], made), free_responses(made), derivatives(made)
    sds = bound_of(made, SPECTRA[name], windows).exact
    z = []
    for w in range(windows):
        here = slice((SETTLE_WINDOWS + w) * W, (SETTLE_WINDOWS + w + 1) * W)
        X = np.concatenate([free, columns[here, :, :q], read[here, :, None]], axis=2)
        whitened = solve_triangular(noise.factor(read[here]), X.reshape(-1, X.shape[2]), lower=True)
        error = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0][-q:]
        z.append(error / sds[w])
    assert np.sqrt(np.mean(np.square(z), axis=0)) == pytest.approx(np.ones(q), abs=0.3)


def test_oracle_knows_more_the_more_it_is_given() -> None:
    found = bound("AR(0.95) sensors", 1, 10)
    assert np.all(found.exact <= found.carried * (1 + 1e-9))
    assert np.all(found.carried <= found.sheet * (1 + 1e-9))
    assert found.carried[0] == pytest.approx(found.sheet[0])
    assert known(found.exact) >= known(found.carried) >= known(found.sheet)


def test_rows_beside_coloured_noise_are_as_many_as_it_allows(request: pytest.FixtureRequest) -> None:
    _compared(
        "AR(0.95) sensors", [play("AR(0.95) sensors", 1, 40)], [bound("AR(0.95) sensors", 1, 40)], request
    )


@pytest.mark.soak
@pytest.mark.parametrize("name", SPECTRA)
def test_rows_are_as_many_as_the_noise_allows(name: str, request: pytest.FixtureRequest) -> None:
    seeds = range(FIRST_SEED, FIRST_SEED + RECORDINGS)
    _compared(name, each(partial(_played, name), seeds), each(partial(_bound, name), seeds), request)


def _compared(name: str, played: list[Found], bounds: list[Bound], request: pytest.FixtureRequest) -> None:
    found = together(played)
    shares = [
        known(np.vstack([getattr(one, given) for one in bounds])) for given in ("exact", "sheet", "carried")
    ]
    given = ", ".join(f"{100 * share:.1f}" for share in shares)
    say(request, f"{name}: rows could be valid {given} % (exact, sheet, carried), {found}")
    assert found.rows >= shares[-1] - BEHIND
    assert found.cover >= least(0.93, found.valid.sum())


def _played(name: str, seed: int) -> Found:
    return play(name, seed, WINDOWS)


def _bound(name: str, seed: int) -> Bound:
    return bound(name, seed, WINDOWS)
